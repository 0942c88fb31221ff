"""A small rendered dataset with depth."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from tests.unrendered import SIZE, change_record, write_dataset
from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.dataset_paths import depth_path, episode_name, image_path
from yamsim_cli.core.episode.runner import AttemptRunner
from yamsim_cli.core.files.resources import Locations

# Config values for pictures of the dataset's size.
SMALL = {("image", "size_px"): list(SIZE), ("truth",): True}


def write_rendered_dataset(path: Path, config: RecordConfig, locations: Locations, episodes: int) -> None:
    """Write the episodes that `yamsim record` would make, of a config with `SMALL`, rendered with primitives."""
    files: list[dict[str, bytes]] = []
    randomized = []
    with AttemptRunner(Session(config, locations), render=True) as runner:
        for number in range(episodes):
            made = runner.run(AttemptJob(config.seed, number))
            files.append(dict(made.files))
            randomized.append(asdict(made.attempt.variation))

    def depth(camera: str, episode: int, frame: int) -> dict[str, bytes]:
        return {(name := depth_path(camera, frame)): files[episode][name]}

    write_dataset(
        path, config, locations, episodes, lambda camera, k, frame: files[k][image_path(camera, frame)], depth
    )
    for number, variation in enumerate(randomized):
        change_record(path / episode_name(number), randomized=variation, truth=True)
