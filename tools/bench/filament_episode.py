"""Render pictures of a recorded episode again with Filament, MuJoCo's physically based renderer.

    python -m tools.bench.filament_episode DATASET/ep_000000 OUT CAMERA 0 7 12

The pictures are rendered at twice their size, averaged, and written as OUT/000007.png.
Filament needs a Vulkan driver, see `yamsim doctor`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2

from tools.bench.filament_pictures import FilamentRenderer
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.reader import open_episode, read_recording_config
from yamsim_cli.core.dataset.records import attempt_from_record
from yamsim_cli.core.episode.simulator import make_simulator
from yamsim_cli.flags.session_options import session_opener

FINER = 2  # rendered pixels per pixel, along a side


def render_pictures(directory: Path, out: Path, camera: str, chosen: list[int]) -> None:
    """Render some pictures of an episode's camera."""
    where = session_opener.find_locations()
    config = read_recording_config(directory.parent, where)
    episode = open_episode(directory)
    attempt = attempt_from_record(episode.record)
    simulator = make_simulator(session_opener.with_scene_meshes(Session(config, where)), attempt.job)
    simulator.apply_randomization(attempt)
    width, height = config.image.size_px
    data, frames = simulator.state_replay.data, episode.frames()
    renderer = FilamentRenderer(simulator.scene.model, camera, (FINER * width, FINER * height))
    for k in chosen:
        simulator.state_replay.set_state(frames[k]["sim_qpos"])
        picture = cv2.resize(renderer.render(data), (width, height), interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(out / f"{k:06d}.png"), picture[..., ::-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("episode", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("camera")
    parser.add_argument("pictures", type=int, nargs="+")
    options = parser.parse_args()
    render_pictures(options.episode, options.out, options.camera, options.pictures)


if __name__ == "__main__":
    main()
