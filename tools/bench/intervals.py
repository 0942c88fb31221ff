"""Coverage of stated intervals in random photos of boards with known poses: `make bench-fiducials`.

Prints how often 95 % intervals of the focal length, of each board's position and rotation, and of the arms' distance
contain the truth, what was refused and why, and writes every view to `intervals.csv`.
"""

from __future__ import annotations

import argparse
import csv
import math
import multiprocessing
import os
from collections import Counter
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from tests.random_views import LensSpread, RandomView, random_camera, random_view
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array, rotation_vector
from yamsim_cli.photos.overlay.photo_arm_poses import RigInPhoto, find_arms
from yamsim_cli.photos.overlay.photo_cameras import PhotoCamera as PhotoLens
from yamsim_cli.photos.overlay.photo_cameras import estimate_camera
from yamsim_cli.photos.overlay.photos import Photo

TILTS = ((0, 10), (10, 20), (20, 30), (30, 45), (45, 60), (60, 70))
PINHOLE = LensSpread()
# Relative error of a calibrated camera's focal length.
FOCAL_SIGMA = 0.003


@dataclass(frozen=True)
class IntervalCase:
    """One table row.

    Attributes:
        photos: of one camera in one call.
        given: whether the camera is known, to `FOCAL_SIGMA`.
    """

    name: str
    lens: LensSpread = PINHOLE
    photos: int = 1
    given: bool = False


CASES = (
    IntervalCase("no camera given"),
    IntervalCase("a real lens: centre 2 % of the width off, k1 0.1 (sigmas)", LensSpread(0.02, 0.1)),
    IntervalCase("the same, 4 photos together", LensSpread(0.02, 0.1), photos=4),
    IntervalCase("a worse one than is expected: centre 4 %, k1 0.2", LensSpread(0.04, 0.2)),
    IntervalCase("camera given, to 0.3 %", given=True),
)


@dataclass(frozen=True)
class Outcome:
    """One arm's board in one photo; None without a pose.

    Attributes:
        focal_held: whether the interval contains the focal length, also of a refused board.
        focal_off: error of the estimate's logarithm over its sigma.
        position, turn: squared Mahalanobis distance from the truth, of three degrees of freedom.
        position_off, turn_off: error over `position_sigma` and `rotation_sigma`.
        margin_off: error of the arms' distance over its sigma.
    """

    case: str
    view: int
    width: int
    focal: float
    tilt_deg: float
    status: str
    reason: str = ""
    focal_held: bool | None = None
    focal_sigma: float | None = None
    focal_off: float | None = None
    position: float | None = None
    turn: float | None = None
    position_off: float | None = None
    turn_off: float | None = None
    position_sigma_mm: float | None = None
    margin_off: float | None = None


def run(case: IntervalCase, views: int, seed: int) -> list[Outcome]:
    """Take and analyse `views` photos for one row, in a separate process."""
    cv2.setNumThreads(1)
    rig = load_config(RigConfig, "rigs", "russet", Locations.from_environment(os.environ))
    return [outcome for k in range(views // case.photos) for outcome in outcomes(case, rig, seed, k)]


def outcomes(case: IntervalCase, rig: RigConfig, seed: int, k: int) -> list[Outcome]:
    """Return the outcomes of all boards in the photos of the k-th call."""
    rng = np.random.default_rng([seed, k, *case.name.encode()])
    camera = random_camera(rng, case.lens)
    taken = [random_view(rng, rig, camera=camera) for _ in range(case.photos)]
    photos = [view.photo(1000 * k + n) for n, view in enumerate(taken)]
    if case.given:
        focal = camera.mean_focal_length * math.exp(rng.normal() * FOCAL_SIGMA)
        K = ((focal, 0.0, camera.K[0][2]), (0.0, focal, camera.K[1][2]), camera.K[2])
        lens = PhotoLens.from_calibration(replace(camera, K=K, focal_sigma=FOCAL_SIGMA), "file")
    else:
        lens = estimate_camera((np.dstack([grey] * 3) for grey in photos), photos[0].shape[:2], rig)
    found = []
    for view, grey in zip(taken, photos, strict=True):
        result = find_arms(rig, Photo(Path(f"{k}.png")), grey, lens, trust_margin=False)
        found += [_outcome(case, k, rig, view, result, arm) for arm in view.boards]
    return found


def _outcome(case: IntervalCase, k: int, rig: RigConfig, view: RandomView, result: RigInPhoto, arm: int) -> Outcome:
    camera, focal, seen = view.camera, result.lens.focal, result.arms[arm].detection
    assert seen is not None
    outcome = Outcome(
        case.name,
        k,
        camera.width,
        camera.mean_focal_length,
        math.degrees(view.tilt),
        str(seen.status),
        seen.reason,
        (focal.low or 0.0) <= camera.mean_focal_length <= (focal.high or math.inf),
    )
    if seen.T_board_in_cam is None:
        return outcome
    assert seen.covariance is not None and seen.position_sigma is not None and seen.rotation_sigma is not None
    _, truth = view.boards[arm]
    turn = rotation_vector(seen.T_board_in_cam[:3, :3] @ truth[:3, :3].T)
    shift = seen.T_board_in_cam[:3, 3] - truth[:3, 3]
    margin_off = None
    if result.margin is not None and result.margin_sigma is not None:
        margin_off = (result.margin - rig.margin) / result.margin_sigma
    return replace(
        outcome,
        focal_sigma=result.lens.camera.focal_sigma,
        focal_off=math.log(result.lens.camera.mean_focal_length / camera.mean_focal_length)
        / result.lens.camera.focal_sigma,
        position=_squared(shift, seen.covariance[3:, 3:]),
        turn=_squared(turn, seen.covariance[:3, :3]),
        position_off=float(np.linalg.norm(shift)) / seen.position_sigma,
        turn_off=float(np.linalg.norm(turn)) / seen.rotation_sigma,
        position_sigma_mm=1000 * seen.position_sigma,
        margin_off=margin_off,
    )


def _squared(off: Array, covariance: Array) -> float:
    return float(off @ np.linalg.solve(covariance, off))


# 95 % quantiles: squared distance of three degrees of freedom, and distance of one, in standard deviations.
CHI_3, SIGMAS = 7.815, 1.96


def coverage(found: Sequence[Outcome]) -> dict[str, list[float]]:
    """Return, for each interval of boards with a pose, the error over the 95 % limit."""
    good = [one for one in found if one.status == "ok"]
    return {
        "focal": [0.0 if one.focal_held else 2.0 for one in good if one.focal_held is not None],
        "position": [(one.position or 0.0) / CHI_3 for one in good],
        "turn": [(one.turn or 0.0) / CHI_3 for one in good],
        "margin": [abs(one.margin_off) / SIGMAS for one in good if one.margin_off is not None],
    }


def farthest(found: Iterable[Outcome]) -> float:
    """Return the largest error of a board with a pose, in standard deviations."""
    offs = [(one.focal_off, one.position_off, one.turn_off, one.margin_off) for one in found if one.status == "ok"]
    return max((abs(off) for row in offs for off in row if off is not None), default=0.0)


def table(title: str, rows: Iterable[tuple[str, Sequence[Outcome]]]) -> Table:
    """Print how often each interval contains the truth, and the intervals' sizes."""
    result = Table(title=title, title_justify="left", show_edge=False)
    for column in ("", "boards", "ok", "focal", "position", "turn", "margin", "worst", "focal +-", "mm +-"):
        result.add_column(column, justify="right" if column else "left", no_wrap=True)
    for name, found in rows:
        good = [one for one in found if one.status == "ok"]
        held = [f"{np.mean(np.array(offs) <= 1):.1%}" if offs else "-" for offs in coverage(found).values()]
        result.add_row(
            name,
            str(len(found)),
            f"{len(good) / max(1, len(found)):.0%}",
            *held,
            f"{farthest(found):.1f}",
            f"{100 * np.median([one.focal_sigma or 0.0 for one in good]):.1f} %" if good else "-",
            f"{np.median([one.position_sigma_mm or 0.0 for one in good]):.1f}" if good else "-",
        )
    return result


def reasons(found: Iterable[Outcome]) -> Counter[str]:
    """Count the reasons for boards without a pose, without their numbers."""
    texts = ["".join("#" if c.isdigit() else c for c in one.reason) for one in found if one.status != "ok"]
    while any("##" in text for text in texts):
        texts = [text.replace("##", "#") for text in texts]
    return Counter(texts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--views", type=int, default=200, help="photos a row")
    parser.add_argument("--out", type=Path, default=Path("out/bench"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--case", type=int, action="append", help="these rows alone, from 0")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    cases = [CASES[k] for k in options.case] if options.case else list(CASES)
    workers = os.cpu_count() or 1
    with ProcessPoolExecutor(workers, mp_context=multiprocessing.get_context("spawn")) as pool:
        done = list(pool.map(run, cases, [options.views] * len(cases), [options.seed] * len(cases)))
    rows = [(case.name, found) for case, found in zip(cases, done, strict=True)]
    console = Console(width=150)
    console.print("How often 95 % intervals hold the truth; worst: the largest error in standard deviations.")
    console.print(table("All views, tilt 0-70 deg", rows))
    for name, found in rows:
        parts = [(f"{low}-{high} deg", [one for one in found if low <= one.tilt_deg < high]) for low, high in TILTS]
        console.print()
        console.print(table(name, parts))
        for text, count in reasons(found).most_common():
            console.print(f"  refused {count}: {text}", highlight=False)
    with (options.out / "intervals.csv").open("w", newline="") as stream:
        writer = csv.DictWriter(stream, [field.name for field in fields(Outcome)])
        writer.writeheader()
        writer.writerows(asdict(one) for found in done for one in found)
    console.print(f"\nEvery view: {options.out / 'intervals.csv'}")


if __name__ == "__main__":
    main()
