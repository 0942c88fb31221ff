"""Frames at other times than the recorded ones, against the simulation and its plan."""

from __future__ import annotations

import io
import itertools
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import mujoco
import numpy as np
import pytest

from tests.attempts import all_actions, planned
from tests.export.conftest import jpeg
from tests.rendered import SMALL, write_rendered_dataset
from tests.unrendered import change_frame, frame_count, write_dataset
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.lowdim import SIMULATION_KEYS, recorded_actions
from yamsim_cli.core.dataset.reader import open_episode, read_recording_config
from yamsim_cli.core.episode.episode_rules import EXPERT_RULES
from yamsim_cli.core.episode.execution import simulate_actions
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.export.export_source import open_source
from yamsim_cli.export.raiden import export_raiden
from yamsim_cli.export.raiden_schema import RaidenOptions
from yamsim_cli.export.resample import StateSampler, frame_times, nearest_frames, resample_episode

TICK, PERIOD = 0.032, 0.064


@pytest.fixture(scope="module")
def simulator(dataset: Path, locations: Locations) -> Iterator[Simulator]:
    with Simulator(Session(read_recording_config(dataset, locations), locations)) as made:
        yield made


def test_times_begin_with_the_first_frame_and_do_not_go_beyond_the_last() -> None:
    times = frame_times(57, PERIOD, 30)
    assert (len(times), times[0], times[-1]) == (108, 0.0, 107 / 30)
    # A rate that includes the last frame's time keeps it, despite rounding.
    np.testing.assert_allclose(frame_times(57, PERIOD, 1 / PERIOD), np.arange(57) * PERIOD, atol=1e-12)
    assert nearest_frames(np.array([0.0, 0.03, 0.04, 9.0]), 57, PERIOD) == [0, 0, 1, 56]


@pytest.mark.parametrize("number", [0, 2])
def test_between_frames_the_states_are_the_simulations_and_the_commands_the_plans(
    dataset: Path, simulator: Simulator, number: int
) -> None:
    """The plan's reference, made again from the seed, is known at every control tick."""
    episode = open_episode(dataset / f"ep_{number:06d}")
    ticks = 2 * episode.record.frames - 1
    seen = StateSampler(simulator.scene.model, np.arange(ticks) * TICK)
    done = planned(simulator, episode.record.seed, episode.record.attempt)
    plan = all_actions(done.recorded_states).joints[:, 0]
    found = resample_episode(simulator, episode, 1 / TICK)
    recorded = recorded_actions(episode.frames(), simulator.scene.model.nq, simulator.scene.model.nu)
    assert recorded
    simulate_actions(simulator, done.attempt, recorded[1], EXPERT_RULES, on_step=seen)
    assert len(found.times) == ticks
    np.testing.assert_array_equal(found.qpos, seen.qpos)
    np.testing.assert_array_equal(found.qpos[::2], [state.qpos for state in done.recorded_states])
    found_commands = np.array([frame["action_joints"] for frame in found.frames])
    np.testing.assert_array_equal(found_commands[::2], plan[0:ticks:2].astype(np.float32))
    off = np.abs(found_commands - plan[:ticks])
    # Straight lines between recorded commands would be up to 22 mrad off, in the second case.
    assert off[:, :6].max() < 0.004
    assert off[:, 6].max() < 0.0007


def test_between_two_steps_a_state_lies_on_the_way(dataset: Path, simulator: Simulator) -> None:
    episode = open_episode(dataset / "ep_000001")
    steps = resample_episode(simulator, episode, 500.0)
    halves = resample_episode(simulator, episode, 1000.0)
    np.testing.assert_array_equal(halves.qpos[::2], steps.qpos)
    middle = (steps.qpos[:-1] + steps.qpos[1:]) / 2
    # Quaternions are interpolated on the sphere, the rest linearly.
    np.testing.assert_allclose(halves.qpos[1::2], middle[: len(halves.qpos[1::2])], atol=1e-4)
    for adr in _quaternions(simulator.scene.model):
        np.testing.assert_allclose(np.linalg.norm(halves.qpos[:, adr : adr + 4], axis=1), 1.0, atol=1e-9)


def _quaternions(model: mujoco.MjModel) -> Iterator[int]:
    for joint in range(model.njnt):
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            yield int(model.jnt_qposadr[joint]) + 3


def test_physics_that_deviates_is_refused(dataset: Path, locations: Locations, tmp_path: Path) -> None:
    copy = shutil.copytree(dataset, tmp_path / "copy")
    ctrl = open_episode(copy / "ep_000000").frames()[20]["sim_ctrl"]
    change_frame(copy / "ep_000000", 20, rehash=True, sim_ctrl=ctrl + 0.01)
    options = RaidenOptions(pictures="nearest")
    with pytest.raises(DatasetError, match=r"again gives a state of frame 21 that is .* away .* --fps source"):
        export_raiden(open_source(copy, "0", locations), tmp_path / "out", locations, lambda *_: None, options)
    for key in SIMULATION_KEYS:
        for k in range(frame_count(copy / "ep_000000")):
            change_frame(copy / "ep_000000", k, rehash=True, **{key: None})
    with pytest.raises(DatasetError, match=r"holds no sim_qpos, sim_ctrl and sim_magnet, .* --fps source"):
        export_raiden(open_source(copy, "0", locations), tmp_path / "out", locations, lambda *_: None, options)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["copy"]
    recorded = RaidenOptions(fps=None)
    done = export_raiden(open_source(copy, "0", locations), tmp_path / "out", locations, lambda *_: None, recorded)
    assert done.frames == frame_count(copy / "ep_000000")


@pytest.fixture(scope="module")
def drawn_dataset(
    tmp_path_factory: pytest.TempPathFactory, make_config: Callable[..., RecordConfig], locations: Locations
) -> Path:
    """One episode, with its own noise."""
    path = tmp_path_factory.mktemp("drawn") / "dataset"
    config = make_config(SMALL | {("wrist",): True, ("randomization",): "default"})
    write_rendered_dataset(path, config, locations, 1)
    return path


@pytest.mark.slow
@pytest.mark.render
def test_pictures_drawn_anew_are_the_recorded_ones_at_recorded_times(
    drawn_dataset: Path, locations: Locations, tmp_path: Path
) -> None:
    source = open_source(drawn_dataset, None, locations)
    done = export_raiden(source, tmp_path / "out", locations, lambda *_: None, RaidenOptions(), workers=1)
    episode = done.path / "0000"
    assert json.loads((episode / "metadata.json").read_text())["pictures"] == {"source": "drawn"}
    quality = [cv2.IMWRITE_JPEG_QUALITY, source.config.image.jpeg_quality]
    for camera, name in (("scene_camera", "scene_camera"), ("right_wrist_camera", "left_wrist_camera")):
        pictures = [cv2.imread(str(episode / "rgb" / name / f"{k:010d}.png")) for k in range(done.frames)]
        recorded = (drawn_dataset / "ep_000000" / "rgb" / camera / "000000.jpg").read_bytes()
        assert cv2.imencode(".jpg", pictures[0], quality)[1].tobytes() == recorded
        # No image is repeated: each has its own noise and motion.
        assert all((one != other).any() for one, other in itertools.pairwise(pictures))
        for k, frame in ((0, 0), (48, 25)):
            with np.load(episode / "depth" / name / f"{k:010d}.npz") as found:
                was = np.load(io.BytesIO((drawn_dataset / f"ep_000000/depth/{camera}/{frame:06d}.npz").read_bytes()))
                np.testing.assert_array_equal(found["depth"], was["depth"])


@pytest.mark.slow
@pytest.mark.render
def test_pictures_that_would_differ_are_not_drawn(
    tmp_path: Path, make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    write_dataset(tmp_path / "dataset", make_config({("wrist",): True}), locations, 1, jpeg)
    source = open_source(tmp_path / "dataset", None, locations)
    with pytest.raises(DatasetError, match=r"rendered again is not what was recorded .* --pictures nearest"):
        export_raiden(source, tmp_path / "out", locations, lambda *_: None, RaidenOptions(), workers=1)
    assert not (tmp_path / "out").exists()
