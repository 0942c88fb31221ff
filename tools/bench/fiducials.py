"""How well boards are located in photos whose truth is known: `make bench-fiducials`.

Prints tables, and writes every pose to `fiducials.csv` and the errors over range to `fiducials.svg`. A large run can be
made in parts: `--only "motion" --poses 1000 --seed 1`.
"""

from __future__ import annotations

import argparse
import csv
import math
import multiprocessing
import os
import sys
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from tests.damaged_photos import Damage, creased, glaring, half_covered, unevenly_lit
from tests.truth_photos import CAMERA, Photographer, covered, shot_of, spoilt
from tools.bench.error_plot import plot_errors
from tools.bench.setting import use_gl
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array, invert_pose, rotation_vector
from yamsim_cli.photos.fiducials.board_detection import BoardDetection, BoardStatus
from yamsim_cli.photos.fiducials.board_localization import locate_boards, locate_boards_together
from yamsim_cli.photos.overlay.photo_arm_poses import find_arms
from yamsim_cli.photos.overlay.photo_cameras import PhotoCamera
from yamsim_cli.photos.overlay.photos import Photo

# deg and mm; poses with larger errors are wrong
WRONG_DEG, WRONG_MM = 3.0, 15.0
TILT = (0.0, math.radians(60))
RANGES = (0.3, 0.4, 0.6, 0.8, 1.0, 1.2, 1.5)
TILTS = ((0, 15), (15, 30), (30, 45), (45, 60), (60, 75))


@dataclass(frozen=True)
class PhotoCase:
    """One table row: camera pose and disturbances.

    Attributes:
        distance, tilt: of the camera from the board, m and rad, or ranges of them.
        damage: applied to the clean picture; `spoil` to the photo of it.
        hidden: number of covered markers.
        both: both boards of russet, with a trusted margin.
        second_print: both boards of russet, each by itself, the second printed at this scale.
        times: factor for the number of photos.
    """

    name: str
    distance: float | tuple[float, float]
    tilt: tuple[float, float] = TILT
    spoil: tuple[tuple[str, float], ...] = ()
    hidden: int = 0
    damage: Damage | None = None
    distortion: tuple[float, ...] = ()
    both: bool = False
    second_print: float = 1.0
    times: int = 1


@dataclass(frozen=True)
class Trial:
    """One board in one photo."""

    case: str
    distance_m: float
    status: str
    markers: int
    ms: float
    error_mm: float | None = None
    error_deg: float | None = None
    reprojection_px: float | None = None
    sigma_mm: float | None = None


def cases() -> dict[str, list[PhotoCase]]:
    """Table -> rows."""
    hard = {
        "as above": PhotoCase("as above", 0.8),
        "noise sigma 20": PhotoCase("", 0.8, spoil=(("noise", 20.0),)),
        "JPEG quality 50": PhotoCase("", 0.8, spoil=(("jpeg", 50),)),
        "light x 0.1": PhotoCase("", 0.8, spoil=(("light", 0.1),)),
        "blur sigma 1.5 px": PhotoCase("", 0.8, spoil=(("blur", 1.5),)),
        "blur sigma 2.5 px": PhotoCase("", 0.8, spoil=(("blur", 2.5),)),
        "5 px of motion": PhotoCase("", 0.8, spoil=(("motion", 5.0),)),
        "9 px of motion": PhotoCase("", 0.8, spoil=(("motion", 9.0),)),
        "4 of 9 markers hidden": PhotoCase("", 0.8, hidden=4),
        "8 of 9 markers hidden": PhotoCase("", 0.8, hidden=8),
        "blur sigma 4 px": PhotoCase("", 0.8, spoil=(("blur", 4.0),)),
        "12 px of motion": PhotoCase("", 0.8, spoil=(("motion", 12.0),)),
        "half covered": PhotoCase("", 0.8, damage=half_covered),
        "glare over a third": PhotoCase("", 0.8, damage=glaring),
        "a crease of 4 degrees": PhotoCase("", 0.8, damage=creased),
        "light from 25 to 100 %": PhotoCase("", 0.8, damage=unevenly_lit),
        "one of two prints at 97 %": PhotoCase("", (0.6, 1.2), second_print=0.97),
        "distortion k1 = -0.3, k2 = 0.1": PhotoCase("", 0.8, distortion=(-0.3, 0.1, 0.001, -0.001)),
    }
    return {
        "range, tilt 0-60 deg": [PhotoCase(f"{distance} m", distance) for distance in RANGES],
        "tilt, at 0.8 m": [
            PhotoCase(f"{low}-{high} deg", 0.8, (math.radians(low), math.radians(high))) for low, high in TILTS
        ],
        "both boards of russet, margin trusted": [PhotoCase(f"{d} m, together", d, both=True) for d in (0.8, 1.0, 1.2)],
        "spoilt photos, at 0.8 m": [replace(case, name=name) for name, case in hard.items()],
        "anything up to 1.2 m": [PhotoCase("0.3-1.2 m, tilt 0-75 deg", (0.3, 1.2), (0.0, math.radians(75)), times=10)],
    }


def run(case: PhotoCase, poses: int, seed: int) -> list[Trial]:
    """Take and analyse `poses` photos for one row, in a separate process."""
    cv2.setNumThreads(1)
    camera = CameraModel(CAMERA.width, CAMERA.height, CAMERA.K, case.distortion)
    rng = np.random.default_rng([seed, *case.name.encode()])
    where = Locations.from_environment(os.environ)
    said = load_config(RigConfig, "rigs", "russet" if case.both or case.second_print != 1 else "bimanual", where)
    trials: list[Trial] = []
    with Photographer(_as_printed(said, case.second_print), where, camera) as photographer:
        while len(trials) < poses:
            if case.second_print != 1:
                trials += _each(case, said, photographer, rng)
            else:
                trials += _both(case, photographer, rng) if case.both else _one(case, photographer, rng)
    return trials


def _as_printed(rig: RigConfig, second: float) -> RigConfig:
    """Return a rig whose second board is printed at a scale."""
    if second == 1:
        return rig
    board = rig.arms[1].board
    assert board is not None
    sizes = {"marker_length_mm": board.marker_length_mm * second, "gap_mm": board.gap_mm * second}
    arm = rig.arms[1].model_copy(update={"board": board.model_copy(update=sizes)})
    return rig.model_copy(update={"arms": type(rig.arms)([rig.arms[0], arm])})


def _one(case: PhotoCase, photographer: Photographer, rng: np.random.Generator) -> list[Trial]:
    which, distance = int(rng.integers(len(photographer.boards))), _distance(case, rng)
    T_cam = shot_of(photographer, rng, distance, case.tilt, which)
    placed = photographer.boards[which]
    truth = invert_pose(T_cam) @ placed.T_in_world
    image = photographer.take()
    if case.damage:
        image = case.damage(rng, cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), photographer.camera, placed.board, truth)
    if case.hidden:
        hidden = rng.permutation(len(placed.board.marker_ids))[: case.hidden].tolist()
        image = covered(image, photographer.camera, placed.board, truth, hidden)
    photo = spoilt(image, rng, **dict(case.spoil))  # type: ignore[arg-type]
    began = time.process_time()
    (seen,), _ = locate_boards(photo, photographer.camera, [placed.board])
    return [_trial(case, distance, seen, truth, time.process_time() - began)]


def _each(case: PhotoCase, said: RigConfig, photographer: Photographer, rng: np.random.Generator) -> list[Trial]:
    """Locate both boards as `yamsim overlay` does, with the prints that the rig states."""
    distance = _distance(case, rng)
    T_cam = shot_of(photographer, rng, distance, case.tilt)
    photo = spoilt(photographer.take(), rng)
    began = time.process_time()
    lens = PhotoCamera.from_calibration(photographer.camera, "file")
    arms = find_arms(said, Photo(Path("photo.png")), photo, lens, trust_margin=False).arms
    took = time.process_time() - began
    return [
        _trial(case, distance, arm.detection, invert_pose(T_cam) @ placed.T_in_world, took)
        for arm, placed in zip(arms, photographer.boards, strict=True)
        if arm.detection
    ]


def _distance(case: PhotoCase, rng: np.random.Generator) -> float:
    return case.distance if isinstance(case.distance, float) else float(rng.uniform(*case.distance))


def _both(case: PhotoCase, photographer: Photographer, rng: np.random.Generator) -> list[Trial]:
    distance = _distance(case, rng)
    T_cam = shot_of(photographer, rng, distance, case.tilt)
    photo = spoilt(photographer.take(), rng)
    began = time.process_time()
    seen, _ = locate_boards(photo, photographer.camera, [placed.board for placed in photographer.boards])
    if all(one.status is BoardStatus.OK for one in seen):
        seen = (
            locate_boards_together(photo, photographer.camera, seen, [b.T_in_world for b in photographer.boards])
            or seen
        )
    took = time.process_time() - began
    return [
        _trial(case, distance, one, invert_pose(T_cam) @ placed.T_in_world, took)
        for one, placed in zip(seen, photographer.boards, strict=True)
    ]


def _trial(case: PhotoCase, distance: float, seen: BoardDetection, truth: Array, seconds: float) -> Trial:
    trial = Trial(case.name, distance, str(seen.status), len(seen.markers), seconds * 1000)
    T = seen.T_board_in_cam
    if T is None:
        return trial
    return replace(
        trial,
        error_mm=float(np.linalg.norm(T[:3, 3] - truth[:3, 3])) * 1000,
        error_deg=math.degrees(float(np.linalg.norm(rotation_vector(T[:3, :3].T @ truth[:3, :3])))),
        reprojection_px=seen.reprojection_rms,
        sigma_mm=1000 * (seen.position_sigma or 0.0),
    )


def table(title: str, rows: Iterable[tuple[PhotoCase, list[Trial]]]) -> Table:
    """Return median, 95 % and maximum of every row."""
    result = Table(title=title, title_justify="left", show_edge=False)
    for column in ("", "boards", "found", "wrong", "mm", "deg", "px", "ms"):
        result.add_column(column, justify="left" if not column else "right", no_wrap=True)
    for case, trials in rows:
        good = [trial for trial in trials if trial.status == "ok"]
        wrong = sum((trial.error_deg or 0) > WRONG_DEG or (trial.error_mm or 0) > WRONG_MM for trial in good)
        result.add_row(
            case.name,
            str(len(trials)),
            f"{len(good) / len(trials):.1%}",
            str(wrong),
            _spread([trial.error_mm for trial in good], 3),
            _spread([trial.error_deg for trial in good], 3),
            _spread([trial.reprojection_px for trial in good], 3),
            _spread([trial.ms for trial in trials], 0),
        )
    return result


def _spread(values: list[Any], digits: int) -> str:
    if not values:
        return "-"
    return " / ".join(f"{value:.{digits}f}" for value in (np.median(values), np.quantile(values, 0.95), max(values)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=int, default=100, help="boards a row; ten times as many in the last table")
    parser.add_argument("--out", type=Path, default=Path("out/bench"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", action="append", help="rows whose name holds this")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    # The rendering workers inherit it.
    use_gl()
    wanted = options.only or [""]
    tables = {
        title: kept
        for title, rows in cases().items()
        if (kept := [case for case in rows if any(part in case.name for part in wanted)])
    }
    jobs = [(title, case) for title, rows in tables.items() for case in rows]
    poses = [options.poses * case.times for _, case in jobs]
    workers = options.workers
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        trials = []
        for done in pool.map(run, [case for _, case in jobs], poses, [options.seed] * len(jobs)):
            trials.append(done)
            print(f"{len(trials)} of {len(jobs)} rows", file=sys.stderr, flush=True)
    found = dict(zip([(title, case.name) for title, case in jobs], trials, strict=True))
    console = Console(width=140)
    console.print(
        "640 x 480, fx 600, blur sigma 0.6 px, noise sigma 2, board wholly visible. Wrong: by more than "
        f"{WRONG_DEG:g} deg or {WRONG_MM:g} mm. Errors of the board's centre (mm) and orientation (deg), the "
        "reprojection (px) and a core's time (ms): median / 95 % / maximum."
    )
    for title, rows in tables.items():
        console.print()
        console.print(table(title, [(case, found[title, case.name]) for case in rows]))
    with (options.out / "fiducials.csv").open("w", newline="") as stream:
        writer = csv.DictWriter(stream, [field.name for field in fields(Trial)])
        writer.writeheader()
        writer.writerows(asdict(trial) for group in trials for trial in group)
    first = next(iter(tables))
    if all(isinstance(case.distance, float) for case in tables[first]):
        errors = {
            case.distance: [trial.error_mm for trial in found[first, case.name] if trial.error_mm is not None]
            for case in tables[first]
            if isinstance(case.distance, float)
        }
        plot_errors(errors, options.out / "fiducials.svg")
    console.print(f"\nEvery pose: {options.out / 'fiducials.csv'}; errors over range: {options.out / 'fiducials.svg'}")


if __name__ == "__main__":
    main()
