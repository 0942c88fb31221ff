"""How often a board is found where there is none: other boards, QR codes, checkerboards, text, keyboards, windows."""

from __future__ import annotations

import argparse
import os
import time

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from tests.strangers import KINDS, stranger
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.photos.fiducials.board_localization import locate_boards

CAMERA = CameraModel.from_focal_length(640, 480, 600.0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--photos", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    cv2.setNumThreads(1)
    rig = load_config(RigConfig, "rigs", "russet", Locations.from_environment(os.environ))
    boards = [arm.board.board_in_metres for arm in rig.arms if arm.board]
    T_rig = [rig.T_base_in_world(k) @ arm.T_board_in_base for k, arm in enumerate(rig.arms) if arm.board]
    table = Table(title="Photos without our boards", title_justify="left", show_edge=False)
    for column in ("", "photos", "with a pose", "ms"):
        table.add_column(column, justify="right" if column else "left")
    kinds = list(KINDS)
    totals = [0, 0]
    for n, kind in enumerate(kinds):
        count = len(range(n, options.photos, len(kinds)))
        wrong, times = [], []
        for k in range(count):
            rng = np.random.default_rng([options.seed, n, k])
            photo = stranger(rng, kind, boards[int(rng.integers(len(boards)))])
            began = time.process_time()
            seen, _ = locate_boards(photo, CAMERA, boards, T_rig)
            times.append(time.process_time() - began)
            if any(one.T_board_in_cam is not None for one in seen):
                wrong.append(k)
        totals = [totals[0] + count, totals[1] + len(wrong)]
        table.add_row(kind, str(count), f"{len(wrong)} {wrong[:9] or ''}", f"{1000 * np.median(times):.0f}")
    table.add_row("all", *map(str, totals), "")
    Console(width=100).print(table)


if __name__ == "__main__":
    main()
