"""Simulated episodes: the rig alone follows them exactly until the gripper holds a thing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.core.unrendered import write_dataset
from tests.rig_scenes import rig_scene
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.dataset.reader import open_episode
from yamsim_cli.core.gap.figures import gap_of
from yamsim_cli.core.recordings.reading import read_motions
from yamsim_cli.core.resources import Locations
from yamsim_cli.core.robots.dynamics import Dynamics
from yamsim_cli.core.scene.build import build_rig_scene


@pytest.mark.parametrize(
    ("rig", "task"), [("single", "pickplace"), pytest.param("russet", "handover", marks=pytest.mark.slow)]
)
def test_an_episode_has_no_gap_until_something_is_held(
    rig: str, task: str, locations: Locations, make_config: Callable[..., RecordConfig], tmp_path: Path
) -> None:
    config = make_config({("rig",): rig, ("task",): task})
    write_dataset(tmp_path / "dataset", config, locations, 1)
    (motion,) = read_motions([tmp_path / "dataset"], config.rig, locations)
    frames = open_episode(Path(motion.name)).frames()
    held = next(frame["timestamp"] for frame in frames if np.any(frame["magnet"]))
    scene = rig_scene(rig)
    before, after = (gap_of(scene, motion, *part) for part in ((0.0, held), (held, np.inf)))
    # Frames hold joints as float32.
    assert before.error.max < 1e-6
    assert len(before.joints) == 6 * len(config.rig.arms)
    # The rig alone lacks the weight of the held thing.
    assert after.error.max > 1e-3
    assert frames[before.worst.frame]["timestamp"] == pytest.approx(before.worst.time, abs=1e-6)


def test_an_arm_that_acts_late_begins_as_its_episode_did(
    locations: Locations, config: RecordConfig, tmp_path: Path
) -> None:
    """An episode's drives hold the start until the first command acts."""
    dynamics = Dynamics(revision="late", base="i2rt_yam", command_delay_ms=23.8, sensor_delay_ms=4.0)
    arm = config.rig.arms[0].model_copy(update={"dynamics": dynamics})
    rig = config.rig.model_copy(update={"arms": (arm,)})
    write_dataset(tmp_path / "dataset", config.model_copy(update={"rig": rig}), locations, 1)
    (motion,) = read_motions([tmp_path / "dataset"], rig, locations)

    frames = open_episode(Path(motion.name)).frames()
    held = next(frame["timestamp"] for frame in frames if np.any(frame["magnet"]))
    gap = gap_of(build_rig_scene(rig, config.scene, locations), motion, 0.0, held)

    # Of frames' float32.
    assert gap.error.max < 1e-5
