"""The maker's GUI collecting two arms and three cameras from `serve-robot`: lost rows, jitter, times within a row.

    MUJOCO_GL=egl YAMSIM_MAKER=CHECKOUT python -m tools.bench.collection [--size 640x480] [--camera-fps 30]

The leaders perform a motion of `--seconds`. The GUI runs in its own environment, as `make test-clients` makes it. It
keeps images in memory, 2.8 MB a row at 640x480. Leave the machine alone meanwhile.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.clients.environments import UnavailableError
from tests.clients.maker_station import RIG, let_motors_wait, maker_gui
from tests.clients.rows import ROWS
from tests.clients.served_robot import served_robot
from tests.export.station_datasets import FPS, motion_at
from tests.real.recordings.making import write_csv
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.session_opener import parse_size

_ROLES = ("top", "left", "right")
_MAX_LAG_S = 0.5  # s, largest lag that is tried between commands and states


def main() -> None:
    """Measure, and print JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=60.0, help="of the performance")
    parser.add_argument("--size", default="640x480", help="of the images, px")
    parser.add_argument("--camera-fps", type=float, default=30.0, help="most images a second of each camera")
    arguments = parser.parse_args()
    before = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        try:
            report = collect(Path(folder), arguments.seconds, arguments.size, arguments.camera_fps)
        except (UnavailableError, pytest.skip.Exception) as reason:
            raise SystemExit(str(reason)) from reason
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    load = {"before": before, "after": os.getloadavg()[0], "cores": os.cpu_count()}
    print(json.dumps(report | {"load": load, "cpu_s_of_all": used.ru_utime + used.ru_stime}, indent=2))


def collect(folder: Path, seconds: float, size: str, camera_fps: float) -> dict[str, Any]:
    """Let the GUI collect one episode, and return its figures."""
    rig = load_config(RigConfig, "rigs", RIG, Locations.from_environment(os.environ))
    performed = write_csv(folder / "performed.csv", motion_at(rig, round(seconds * FPS) + 1), rig)
    flags = ("--rig", RIG, "--cameras", "--size", size, "--quality", "fast", "--camera-fps", str(camera_fps))
    program = ROWS["maker-station"].environment.make()
    with served_robot(folder / "buses", *flags, "--leader", str(performed)) as served:
        let_motors_wait(served, program)
        with maker_gui(program, served, folder, parse_size(size), folder / "times.npz") as gui:
            gui.start("collect/start-teleop")
            status = gui.status_when(lambda status: status["episodes_done"] == 1)
    (episode,) = (path.parent for path in folder.glob("data/episodes/*/*/write_complete.flag"))
    noted = np.load(folder / "times.npz")
    return {
        "size": size,
        "camera_fps": camera_fps,
        "last_error": status["last_error"],
        "rows": row_figures(noted["rows"]),
        "within_a_row_ms": {
            "first state to last command": spread(1000 * (noted["told"].max(axis=1) - noted["read"].min(axis=1))),
            "states of both arms": spread(1000 * np.ptp(noted["read"], axis=1)),
        },
        "follower_behind_command_ms": {side: 1000 * lag_s(episode, side, noted["rows"]) for side in ("left", "right")},
        "cameras": {role: camera_figures(episode, role, noted["rows"]) for role in _ROLES},
        "saving_s": float(noted["saving"]),
        "server": served.report,
    }


def row_figures(times: Array) -> dict[str, Any]:
    """Return number, loss and intervals of rows that were recorded at `times`, s."""
    total = times[-1] - times[0]
    due = round(total * FPS) + 1
    return {"recorded": len(times), "lost": due - len(times), "seconds": total, "interval_ms": spread_of_gaps(times)}


def camera_figures(episode: Path, role: str, rows: Array) -> dict[str, Any]:
    """Return how many images of a camera an episode has, and how old they are in its rows."""
    times = np.load(episode / f"{role}-timestamp.npy").ravel() / 1000
    different = np.unique(times)
    return {
        "images": len(different),
        "rows_that_repeat_an_image": len(times) - len(different),
        "interval_ms": spread_of_gaps(different),
        "age_in_its_row_ms": spread(1000 * (rows - times)),
    }


def lag_s(episode: Path, side: str, rows: Array) -> float:
    """Return by how much an arm's joints follow their commands, by the least squares of all joints."""
    joints, commands = (np.load(episode / f"{name}.npy") for name in (f"{side}-joint_pos", f"action-{side}-joint"))
    if len(rows) != len(joints):
        raise SystemExit(f"{len(rows)} rows were seen, {len(joints)} are in the episode")
    is_later = rows > rows[0] + _MAX_LAG_S
    later = rows[is_later]
    lags = np.arange(0, _MAX_LAG_S, 0.001)
    errors = []
    for lag in lags:
        commanded = np.column_stack([np.interp(later - lag, rows, column) for column in commands.T])
        errors.append(float(np.square(commanded - joints[is_later]).sum()))
    return float(lags[int(np.argmin(errors))])


def spread_of_gaps(times: Array) -> dict[str, float]:
    """Return the spread of the intervals between times, ms."""
    return spread(1000 * np.diff(times))


def spread(values: Array) -> dict[str, float]:
    """Return median, 95 % and maximum."""
    median, most, largest = np.percentile(values, (50, 95, 100))
    return {"median": round(float(median), 2), "95 %": round(float(most), 2), "maximum": round(float(largest), 2)}


if __name__ == "__main__":
    main()
