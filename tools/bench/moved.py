"""Smallest move of a camera or base that `yamsim overlay` detects, in photos with moving arms.

MUJOCO_GL=egl python -m tools.bench.moved
"""

from __future__ import annotations

import argparse
import math
import os
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from tests.rig_photos import JOINTS, RigPhotographer, looking
from tests.truth_photos import CAMERA
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import pose, rotation_from_vector
from yamsim_cli.core.images.image_files import to_grey
from yamsim_cli.photos.overlay.move_detection import MovedBody, MoveReport, find_moves
from yamsim_cli.photos.overlay.photo_arm_poses import RigInPhoto, find_arms
from yamsim_cli.photos.overlay.photo_cameras import PhotoCamera
from yamsim_cli.photos.overlay.photos import Photo

PHOTOS = 16


@dataclass(frozen=True)
class MoveCase:
    """What moves half-way through a series: the second arm's base, or the camera, m and rad."""

    name: str
    base: float = 0.0
    camera: float = 0.0
    turn: float = 0.0

    @property
    def what(self) -> MovedBody | None:
        if self.base:
            return MovedBody.BASE
        return MovedBody.CAMERA if self.camera or self.turn else None


ROWS = [
    MoveCase("nothing"),
    *(MoveCase(f"base by {mm:g} mm", base=mm / 1000) for mm in (0.5, 1, 2, 3)),
    *(MoveCase(f"camera by {mm:g} mm", camera=mm / 1000) for mm in (0.5, 1, 3)),
    *(MoveCase(f"camera by {deg:g} degrees", turn=math.radians(deg)) for deg in (0.1, 0.2, 0.5)),
]


def series(row: MoveCase, studios: tuple[RigPhotographer, RigPhotographer], seed: int) -> MoveReport:
    """Return what is reported on a series of photos with a move in its middle."""
    rng = np.random.default_rng(seed)
    place = np.array((0.75, 0.0, 0.55)) + rng.uniform(-0.1, 0.1, 3)
    T_cam = looking((place[0], place[1], place[2]), (0.05, 0.0, 0.05))
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction)
    moved = T_cam @ pose(row.camera * direction, rotation_from_vector(row.turn * direction))
    results: list[RigInPhoto] = []
    for number in range(PHOTOS):
        after = number >= PHOTOS // 2
        T = moved if after else T_cam
        if row.base and after:
            # The rig grows to both sides: seen from the first arm, the second one moves by the whole change.
            T = pose((0, -row.base / 2, 0)) @ T
        joints = JOINTS + 0.2 * np.sin(0.7 * number + np.arange(7)) * [1, 1, 1, 1, 1, 1, 0]
        shot = studios[bool(row.base and after)].shoot(T, joints, seed=1000 * seed + number)
        photo = Photo(Path(f"{number:03d}.png"))
        before = results[-1] if results else None
        results.append(
            find_arms(
                studios[0].rig, photo, to_grey(shot.image), PhotoCamera.from_calibration(CAMERA, "file"), False, before
            )
        )
    return find_moves(results)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--series", type=int, default=10, help="Of each row; twice as many in which nothing moves.")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    locations = Locations.from_environment(os.environ)
    rig = load_config(RigConfig, "rigs", "russet", locations)
    table = Table(title=f"Moves in series of {PHOTOS} photos", title_justify="left", show_edge=False)
    for column in ("moved", "series", "told as such, at its photo", "told otherwise", "off by, mm", "off by, degrees"):
        table.add_column(column, justify="right" if table.columns else "left")
    with RigPhotographer(rig, locations, CAMERA) as still:
        for row in ROWS:
            wide = rig.model_copy(update={"margin": rig.margin + row.base})
            with RigPhotographer(wide, locations, CAMERA) as grown:
                _add(table, row, (still, grown), options.series * (1 if row.what else 2))
    Console(width=110).print(table)


def _add(table: Table, row: MoveCase, studios: tuple[RigPhotographer, RigPhotographer], count: int) -> None:
    right, otherwise, shifts, turns = 0, 0, [], []
    for seed in range(count):
        moves = series(row, studios, seed).moves
        as_such = [move for move in moves if move.what is row.what and move.photo == PHOTOS // 2]
        right += len(as_such) == 1
        otherwise += len(moves) > len(as_such)
        shifts += [abs(move.shift - (row.base or row.camera)) * 1000 for move in as_such]
        turns += [abs(math.degrees(move.turn - row.turn)) for move in as_such]
    off = [f"{np.median(values):.2f}, at most {max(values):.2f}" if values else "" for values in (shifts, turns)]
    table.add_row(row.name, str(count), str(right) if row.what else "", str(otherwise), *off)


if __name__ == "__main__":
    main()
