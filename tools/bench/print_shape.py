"""Located flat and bent prints, and whether the stated covariance contains their true pose.

`python -m tools.bench.print_shape --flat 400 --creased 180 --bent 60`: one board at 640 x 480 pixels, 0.4 to 0.8 m, 5
to 60 degrees, a blur of sigma 0.6 px and noise of sigma 2. yamsim and OpenCV draw the flat prints in turn. The model's
constants were chosen with the seeds below 200; `--first` gives others.
"""

from __future__ import annotations

import argparse
import functools
import math
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from tests.board_photos import picture, with_noise
from tests.damaged_photos import Damage, bowed, creased, enlarged_print, twisted
from yamsim_cli.core.geometry.board import Board
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array, pose, rotation_from_vector, rotation_vector
from yamsim_cli.photos.fiducials.board_localization import locate_boards

CAMERA = CameraModel.from_focal_length(640, 480, 600.0)
BOARD = Board("one", 217, 3, 3, "DICT_6X6_250", 0.02923077, 0.002923077)
# Quantiles of squared distances of three degrees of freedom.
CHI_68, CHI_95, CHI_997 = 3.506, 7.815, 13.931


@dataclass(frozen=True)
class Trial:
    """One board in one photo; errors and sigmas in mm and degrees, `off` the larger squared distance, or NaN."""

    status: str
    ms: float
    mm: float = math.nan
    degrees: float = math.nan
    sigma_mm: float = math.nan
    sigma_degrees: float = math.nan
    off: float = math.nan


def random_pose(seed: int) -> Array:
    """A pose (4, 4) of the board in the camera's frame."""
    rng = np.random.default_rng([7, seed])
    distance, tilt, about = rng.uniform(0.4, 0.8), math.radians(rng.uniform(5, 60)), rng.uniform(0, 2 * math.pi)
    tilted = rotation_from_vector([tilt * math.cos(about), tilt * math.sin(about), 0])
    turned = rotation_from_vector([np.pi, 0, 0]) @ rotation_from_vector([0, 0, rng.uniform(-math.pi, math.pi)])
    x, y = rng.uniform(-0.125, 0.125) * distance, rng.uniform(-0.1, 0.1) * distance
    return pose((x, y, distance), tilted @ turned)


def photo_of(seed: int, damage: Damage | None) -> tuple[np.ndarray, Array]:
    """A photo (480, 640) and the board's pose in it."""
    T = random_pose(seed)
    image = picture(CAMERA, [(BOARD, T)])
    if damage is not None:
        image = damage(np.random.default_rng([8, seed]), image, CAMERA, BOARD, T)
    return with_noise(image, 2.0, seed), T


def trial(seed: int, damage: Damage | None) -> Trial:
    """Locate the board in the photo of a seed."""
    photo, T = photo_of(seed, damage)
    began = time.process_time()
    (seen,), _ = locate_boards(photo, CAMERA, [BOARD])
    ms = 1000 * (time.process_time() - began)
    if seen.T_board_in_cam is None:
        return Trial(str(seen.status), ms)
    assert seen.covariance is not None and seen.position_sigma is not None and seen.rotation_sigma is not None
    turn = rotation_vector(seen.T_board_in_cam[:3, :3] @ T[:3, :3].T)
    shift = seen.T_board_in_cam[:3, 3] - T[:3, 3]
    off = max(
        float(error @ np.linalg.solve(part, error))
        for error, part in ((turn, seen.covariance[:3, :3]), (shift, seen.covariance[3:, 3:]))
    )
    return Trial(
        str(seen.status),
        ms,
        1000 * float(np.linalg.norm(shift)),
        math.degrees(float(np.linalg.norm(turn))),
        1000 * seen.position_sigma,
        math.degrees(seen.rotation_sigma),
        off,
    )


def report(name: str, trials: Sequence[Trial]) -> str:
    """Return counts, errors and coverage of the photos of one kind."""
    given = [one for one in trials if math.isfinite(one.off)]
    lines = [
        f"{name}: {dict(Counter(one.status for one in trials))}, {np.median([t.ms for t in trials]):.0f} ms (median)"
    ]
    for field in ("mm", "degrees", "sigma_mm", "sigma_degrees"):
        values = [getattr(one, field) for one in given]
        low, middle, high, most = np.quantile(values, [0, 0.5, 0.95, 1])
        lines.append(f"  {field}: {low:.3f} least, {middle:.3f} median, {high:.3f} at 95 %, {most:.3f} most")
    inside = [sum(one.off <= limit for one in given) for limit in (CHI_68, CHI_95, CHI_997)]
    lines.append(f"  of {len(given)} poses inside 68, 95 and 99.7 %: {inside[0]}, {inside[1]} and {inside[2]}")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--flat", type=int, default=400)
    parser.add_argument("--creased", type=int, default=180, help="by 4 degrees")
    parser.add_argument("--bent", type=int, default=60, help="of each other fold, bowed and twisted")
    parser.add_argument("--first", type=int, default=0, help="seed of the first photo of each kind")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    for name, damage, count in (
        ("flat, drawn by yamsim", None, options.flat - options.flat // 2),
        ("flat, drawn by OpenCV", enlarged_print, options.flat // 2),
        ("creased by 4 degrees", creased, options.creased),
        *(
            (f"creased by {degrees} degrees", functools.partial(creased, degrees=degrees), options.bent)
            for degrees in (1, 2, 8)
        ),
        ("bowed by 1 to 3 mm", bowed, options.bent),
        ("twisted by 1 to 3 mm", twisted, options.bent),
    ):
        if count:
            seeds = range(options.first, options.first + count)
            print(report(name, [trial(seed, damage) for seed in seeds]), flush=True)


if __name__ == "__main__":
    main()
