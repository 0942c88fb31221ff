"""Errors, time and memory of `yamsim calibrate` for an arm and several fixed cameras.

    python -m tools.bench.calibration_cost [--cameras 3] [--frames 50] [--size 640x480] [--seed 6001] [--keep out/cost]

Four episodes of `pickplace` with full meshes and shadows, without noise, joint offsets and delays. The cameras' files
have errors of 0.3 % (standard deviation) of the focal length. The errors of the poses are printed too, because a fit to
a wrong pose could be faster.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rich.console import Console

from tools.bench.board_poses import pose_difference
from tools.bench.calibration_stations import ONE_ARM, QUALITY, camera_with_focal_error, run_yamsim, scene_of
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import FixedCamera
from yamsim_cli.core.dataset.lowdim import load_frame
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.files.writing import scratch_directory
from yamsim_cli.core.geometry.camera import opencv_from_mujoco
from yamsim_cli.core.geometry.se3 import quat_from_rotation
from yamsim_cli.core.scene.cameras import fixed_camera

EPISODES = 4


def write_rig(rng: np.random.Generator, count: int, file: Path) -> None:
    """Write a rig with one arm and `count` fixed cameras at random places around it."""
    rig = load_config(RigConfig, "rigs", ONE_ARM, Locations.from_environment({}))
    arm = rig.arms[0]
    cameras = []
    for number in range(count):
        view = scene_of(rng, 1)["scene_camera"]
        T = fixed_camera("", FixedCamera.model_validate(view)).T_in_body
        place = {"position": view["position"], "quat": quat_from_rotation(opencv_from_mujoco(T[:3, :3])).tolist()}
        cameras.append({"name": f"camera{number + 1}", "arm": arm.name, **place, "fovy_deg": view["fovy_deg"]})
    named = {"name": arm.name, "side": arm.side, "prefix": arm.prefix}
    robot = {"model": arm.model.name, "gripper": arm.gripper.name}
    file.write_text(yaml.safe_dump({"arms": [{**named, **robot}], "cameras": cameras}))


def record(seed: int, folder: Path, cameras: int, size: str) -> None:
    """Record a station's episodes and write the cameras' files."""
    rng = np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    for name, content in {"scene": scene_of(rng, 1), "quality": QUALITY}.items():
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(content))
    config = {"scene": str((folder / "scene.yaml").absolute()), "render": str((folder / "quality.yaml").absolute())}
    (folder / "record.yaml").write_text(yaml.safe_dump({**config, "task": "pickplace", "wrist": False}))
    write_rig(rng, cameras, folder / "rig.yaml")
    run_yamsim(
        *("record", "--config", folder / "record.yaml", "--rig", folder / "rig.yaml", "--n", EPISODES, "--seed", seed),
        *("--workers", 1, "--size", size, "--jpeg-quality", 95, "--out", folder / "episodes", "--overwrite"),
    )
    first = load_frame(next((folder / "episodes").glob("ep_*/lowdim/*.pkl")).read_bytes())
    width, height = map(int, size.split("x"))
    for name in (f"camera{number + 1}" for number in range(cameras)):
        K = np.array(first["intrinsics"][name], dtype=np.float64)
        camera = {**camera_with_focal_error(K, (width, height), rng), "distortion": [0.0] * 4}
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(camera))


def measure(folder: Path, frames: int) -> dict[str, Any]:
    """Calibrate the station; return errors, times and memory."""
    names = sorted(file.stem for file in folder.glob("camera*.yaml"))
    cameras = [part for name in names for part in ("--camera", f"{name}={folder / f'{name}.yaml'}")]
    command = [
        *(sys.executable, "-m", "yamsim_cli", "calibrate", folder / "episodes", "--rig", folder / "rig.yaml", *cameras),
        *("--frames", frames, "--max-shift", 200, "--max-turn", 20, "--out", folder / "calibration", "--overwrite"),
    ]
    start = time.perf_counter()
    process = subprocess.Popen([str(part) for part in command], stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    wall = time.perf_counter() - start
    if status:
        raise RuntimeError(f"calibrate ended with {os.waitstatus_to_exitcode(status)}")
    report = json.loads((folder / "calibration" / "calibration.json").read_text())
    first = load_frame(next((folder / "episodes").glob("ep_*/lowdim/*.pkl")).read_bytes())
    errors = {}
    for camera in report["calibration"]["cameras"]:
        shift, turn = pose_difference(camera, np.array(first["extrinsics"][camera["name"]], dtype=np.float64))
        errors[camera["name"]] = float(np.linalg.norm(shift)), float(np.linalg.norm(turn))
    return {
        "errors": errors,
        "wall_s": wall,
        "cpu_s": usage.ru_utime + usage.ru_stime,
        "max_rss_mb": usage.ru_maxrss / 1024,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cameras", type=int, default=3)
    parser.add_argument("--frames", type=int, default=50)
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--seed", type=int, default=6001)
    parser.add_argument("--keep", type=Path, help="folder for the station")
    given = parser.parse_args()
    console = Console(width=160)
    with scratch_directory("yamsim-calibrate-") as scratch:
        folder = given.keep or scratch
        record(given.seed, folder, given.cameras, given.size)
        row = measure(folder, given.frames)
    for name, (shift, turn) in row["errors"].items():
        console.print(f"{name}: wrong by {shift:.1f} mm and {turn:.2f} degrees", highlight=False)
    figures = f"{row['cpu_s']:.0f} s of a core, {row['wall_s']:.0f} s, {row['max_rss_mb']:.0f} MB"
    console.print(f"{given.cameras} cameras, {given.frames} pictures of each: {figures}", highlight=False)


if __name__ == "__main__":
    main()
