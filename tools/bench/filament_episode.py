"""Render pictures of a recorded episode again with Filament, MuJoCo's physically based renderer.

    python -m tools.bench.filament_episode DATASET/ep_000000 OUT CAMERA 0 7 12 [--readout 0.03]

The pictures are rendered at twice their size, averaged, and written as OUT/000007.png. With `--readout`, the camera
has a rolling shutter: the rows are exposed one after another, and the middle row at the picture's time. On average, the
rows are therefore as late as in a picture without a rolling shutter.
Filament needs a Vulkan driver, see `yamsim doctor`.
"""

from __future__ import annotations

import argparse
import math
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from scipy.interpolate import CubicSpline

from tools.bench.filament_pictures import FilamentRenderer
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.reader import open_episode, read_recording_config
from yamsim_cli.core.dataset.records import attempt_from_record
from yamsim_cli.core.episode.simulator import make_simulator
from yamsim_cli.flags.session_options import session_opener

FINER = 2  # rendered pixels per pixel, along a side
BAND_MOTION = math.radians(0.1)  # rad, of a joint while a band of rows is exposed, which is rendered at one time
MAX_BANDS = 8  # of a picture; more only for the background's pictures of a fast arm, for which time would be lost


def render_pictures(directory: Path, out: Path, camera: str, chosen: list[int], readout: float = 0.0) -> None:
    """Render some pictures of an episode's camera, whose rows are exposed within `readout` seconds."""
    where = session_opener.find_locations()
    config = read_recording_config(directory.parent, where)
    episode = open_episode(directory)
    attempt = attempt_from_record(episode.record)
    simulator = make_simulator(session_opener.with_scene_meshes(Session(config, where)), attempt.job)
    simulator.apply_randomization(attempt)
    width, height = config.image.size_px
    data, frames = simulator.state_replay.data, episode.frames()
    renderer = FilamentRenderer(simulator.scene.model, camera, (FINER * width, FINER * height))
    times = np.array([frame["timestamp"] for frame in frames])
    state_at = CubicSpline(times, [frame["sim_qpos"] for frame in frames])
    speeds = np.abs(CubicSpline(times, [frame["joints"] for frame in frames])(times, 1)).max(axis=1)
    for k in chosen:
        bands = min(MAX_BANDS, max(1, math.ceil(speeds[k] * readout / BAND_MOTION)))
        edges = np.linspace(0, height, bands + 1).astype(int)
        picture = np.zeros((height, width, 3), np.uint8)
        for top, bottom in pairwise(edges.tolist()):
            later = readout * ((top + bottom) / (2 * height) - 0.5)
            state = frames[k]["sim_qpos"] if bands == 1 else state_at(np.clip(times[k] + later, times[0], times[-1]))
            simulator.state_replay.set_state(state)
            whole = cv2.resize(renderer.render(data), (width, height), interpolation=cv2.INTER_AREA)
            picture[top:bottom] = whole[top:bottom]
        cv2.imwrite(str(out / f"{k:06d}.png"), picture[..., ::-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("episode", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("camera")
    parser.add_argument("pictures", type=int, nargs="+")
    parser.add_argument("--readout", type=float, default=0.0, help="s, of a rolling shutter, from first to last row")
    options = parser.parse_args()
    render_pictures(options.episode, options.out, options.camera, options.pictures, options.readout)


if __name__ == "__main__":
    main()
