"""How many boards are found in photos by a physically based renderer: soft shadows, filtered textures, noise, JPEG.

The renderer needs a Vulkan driver, see `filament_pictures`:

    MUJOCO_GL=egl python -m tools.bench.filament --photos 60 --keep out/bench/filament
"""

from __future__ import annotations

import argparse
import math
import os
import time
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console

from tests.truth_photos import Photographer, shot_of, spoilt
from tools.bench.filament_pictures import FilamentRenderer
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array, invert_pose, rotation_vector
from yamsim_cli.photos.fiducials.board_detection import BoardDetection
from yamsim_cli.photos.fiducials.board_localization import locate_boards

# deg and mm; poses with larger errors are wrong
WRONG = (3.0, 15.0)
BLUR, NOISE, JPEG = 0.4, 2.0, 90
SIZES = {"vga": (640, 480, 600.0), "hd": (1280, 720, 900.0)}


def off(seen: BoardDetection, truth: Array) -> tuple[float, float]:
    """Errors of a pose: degrees and mm."""
    T = seen.T_board_in_cam
    assert T is not None
    turn = rotation_vector(T[:3, :3].T @ truth[:3, :3])
    return math.degrees(float(np.linalg.norm(turn))), float(np.linalg.norm(T[:3, 3] - truth[:3, 3])) * 1000


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--photos", type=int, default=60)
    parser.add_argument("--size", choices=SIZES, default="vga")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--tilt", type=float, default=75.0, help="at most, degrees")
    parser.add_argument("--keep", type=Path, help="folder for the photos")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    console = Console()
    camera = CameraModel.from_focal_length(*SIZES[options.size])
    rng = np.random.default_rng(options.seed)
    if options.keep:
        options.keep.mkdir(parents=True, exist_ok=True)
    boards = found = wrong = 0
    errors, times = [], []
    with Photographer("russet", Locations.from_environment(os.environ), camera) as photographer:
        model, data = photographer._model, photographer._data
        model.cam_fovy[model.camera("photo").id] = math.degrees(
            2 * math.atan(camera.height / 2 / camera.mean_focal_length)
        )
        filament = FilamentRenderer(model, "photo", (camera.width, camera.height))
        placed = photographer.boards
        T_rig = [one.T_in_world for one in placed]
        for k in range(options.photos):
            distance = float(rng.uniform(0.55, 1.2))
            T_cam = shot_of(
                photographer, rng, distance, (0.0, math.radians(options.tilt)), int(rng.integers(len(placed)))
            )
            photo = spoilt(filament.render(data), rng, blur=BLUR, noise=NOISE, jpeg=JPEG)
            if options.keep:
                cv2.imwrite(str(options.keep / f"{k:03d}.png"), photo)
            began = time.thread_time()
            seen, _ = locate_boards(photo, camera, [one.board for one in placed], T_rig)
            times.append(time.thread_time() - began)
            for n, (one, sighting) in enumerate(zip(placed, seen, strict=True)):
                truth = invert_pose(T_cam) @ one.T_in_world
                visible = photographer.shows(T_cam, n)
                boards += visible
                if sighting.status != "ok":
                    if visible:
                        console.print(f"{k:03d} {one.board.name} at {distance:.2f} m: {sighting.failure_explanation}")
                    continue
                found += visible
                errors.append(off(sighting, truth))
                if errors[-1][0] > WRONG[0] or errors[-1][1] > WRONG[1]:
                    wrong += 1
                    console.print(f"{k:03d} {one.board.name} at {distance:.2f} m: wrong by {errors[-1]}")
    turn, shift = np.quantile(np.array(errors), (0.5, 0.95, 1.0), axis=0).T
    console.print(f"{options.size}: {found} of {boards} boards that are wholly visible found ({found / boards:.1%})")
    console.print(f"{wrong} wrong; mm {_spread(shift)}, degrees {_spread(turn)} (median / 95 % / maximum)")
    console.print(f"{1000 * np.median(times):.0f} ms of a core a photo")


def _spread(values: np.ndarray) -> str:
    return " / ".join(f"{value:.2f}" for value in values)


if __name__ == "__main__":
    main()
