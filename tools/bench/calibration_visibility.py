"""Errors of `yamsim calibrate` over the share of the arm that the camera sees.

    python -m tools.bench.calibrate --mixed --keep out/bench --size 640x480 --first 4002 --stations 6
    python -m tools.bench.calibration_visibility out/bench/400[2-7]* [--shares 1 0.7 0.5 0.3] [--near]

Each station is a folder of `tools.bench.calibrate --keep`, with one arm and 40 pictures. Its pictures are cut at one
side, until they contain the given share of the pixels that change with the arm. The stations have different sides, as
far as the principal point stays in the picture. The camera file fits the cut pictures, whose pixels per degree are the
same.
With `--near`, the search starts with the calibration by the whole pictures.
"""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import yaml
from rich.console import Console

from tools.bench.calibrate import calibrate_station, station_line, summarize
from tools.bench.calibration_stations import CAMERA, Planted, StationOptions
from yamsim_cli.core.files.writing import scratch_directory
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.images.image_files import read_image

LIMITS = 5.0, 0.5  # mm and degrees, of intervals that count as refused
CHANGE = 25  # grey levels; clean pictures have no noise
LOOKED_AT = 30  # pictures of an episode, from which the arm's pixels are counted
JPEG = 98  # quality of cut pictures
SIDES = ("left", "right", "top", "bottom")


class Cut(NamedTuple):
    """The rows and columns of a picture that remain."""

    rows: slice
    columns: slice


def changed_pixels(station: Path) -> Array:
    """Return how often each pixel (height, width) changes with the arm, in the pictures before noise."""
    counts = []
    for episode in sorted((station / "clean").glob("ep_*")):
        files = sorted((episode / "rgb" / CAMERA).glob("*.jpg"))
        step = max(1, len(files) // LOOKED_AT)
        pictures = np.stack([read_image(file).mean(axis=2) for file in files[::step]])
        counts.append((np.abs(pictures - np.median(pictures, axis=0)) > CHANGE).sum(axis=0))
    return np.sum(counts, axis=0, dtype=np.float64)


def cut_at(changed: Array, share: float, side: str) -> Cut:
    """Return the part of the picture that remains if `side` is cut until `share` of the changed pixels remains."""
    height, width = changed.shape
    is_row = side in ("top", "bottom")
    along = changed.sum(axis=1 if is_row else 0)
    is_start = side in ("left", "top")
    seen = np.cumsum(along[::-1] if is_start else along) / along.sum()
    kept = len(along) if share >= 1 else int(np.searchsorted(seen, share)) + 1
    kept -= kept % 2
    part = slice(len(along) - kept, len(along)) if is_start else slice(0, kept)
    return Cut(part, slice(0, width)) if is_row else Cut(slice(0, height), part)


def choose_cut(changed: Array, share: float, first_side: int) -> Cut | None:
    """Return the cut at the first side, from number `first_side` on, after which the principal point is visible."""
    height, width = changed.shape
    for k in range(len(SIDES)):
        cut = cut_at(changed, share, SIDES[(first_side + k) % len(SIDES)])
        if cut.rows.start < height / 2 < cut.rows.stop and cut.columns.start < width / 2 < cut.columns.stop:
            return cut
    return None


def cut_station(station: Path, out: Path, cut: Cut) -> None:
    """Write a station's episodes and camera file with cut pictures into `out`."""
    for episode in sorted((station / "episodes").iterdir()):
        shutil.copytree(episode / "lowdim", out / "episodes" / episode.name / "lowdim")
        pictures = out / "episodes" / episode.name / "rgb" / CAMERA
        pictures.mkdir(parents=True)
        for file in sorted((episode / "rgb" / CAMERA).glob("*.jpg")):
            image = cv2.imread(str(file))
            if image is None:  # Filament renders only pictures that the fit reads
                shutil.copy(file, pictures / file.name)
                continue
            cv2.imwrite(str(pictures / file.name), image[cut.rows, cut.columns], [cv2.IMWRITE_JPEG_QUALITY, JPEG])
    camera = yaml.safe_load((station / f"{CAMERA}.yaml").read_text())
    camera["height"], camera["width"] = cut.rows.stop - cut.rows.start, cut.columns.stop - cut.columns.start
    camera["K"][0][2] -= cut.columns.start
    camera["K"][1][2] -= cut.rows.start
    (out / f"{CAMERA}.yaml").write_text(yaml.safe_dump(camera))


def measure(stations: Sequence[Path], shares: Sequence[float], is_near: bool, console: Console) -> None:
    """Print the errors of each share; `is_near` tells whether the search gets an earlier calibration."""
    changed = [changed_pixels(station) for station in stations]
    for share in shares:
        rows = []
        for number, station in enumerate(stations):
            planted, seed = Planted.load(station / "truth.json"), int(station.name.split("_")[0])
            cut = choose_cut(changed[number], share, number)
            if cut is None:
                console.print(f"{share:.0%}, {seed}: the principal point would be outside of the picture")
                continue
            with scratch_directory("yamsim-visibility-") as scratch:
                cut_station(station, scratch, cut)
                near = station / "calibration" if is_near else None
                row = calibrate_station(scratch, planted, StationOptions(), True, near) | {"seed": seed}
            rows.append(row)
            size = f"{cut.columns.stop - cut.columns.start} x {cut.rows.stop - cut.rows.start} px"
            console.print(f"{share:.0%}, {size}, {station_line(row)}", highlight=False)
        if rows:
            console.print(f"{share:.0%} visible:")
            summarize(rows, LIMITS, console)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stations", type=Path, nargs="+")
    parser.add_argument("--shares", type=float, nargs="+", default=[1.0, 0.7, 0.5, 0.3])
    parser.add_argument("--near", action="store_true", help="give the calibration by the whole pictures")
    given = parser.parse_args()
    for station in given.stations:
        if Planted.load(station / "truth.json").T_arm_in_base is not None:
            parser.error(f"{station} has two arms; give stations with one")
    measure(given.stations, given.shares, given.near, Console(width=240))


if __name__ == "__main__":
    main()
