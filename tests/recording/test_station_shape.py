"""`--fps 30 --action joints`: the form of real recordings of YAM stations."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.cli.run_cli import yamsim
from yamsim_cli.core.dataset.reader import open_episode

pytestmark = [pytest.mark.render, pytest.mark.slow]

FLAGS = ("--rig", "yam_station_linear_4310_d405", "--grasp", "contact", "--fps", "30", "--action", "joints")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("station") / "dataset"
    flags = (*FLAGS, "--camera", "top", "--n", "1", "--workers", "1", "--quality", "fast", "--size", "64x48")
    done = yamsim("record", *flags, "--out", out)
    assert done.code == 0, done.err
    return out


def test_state_and_action_are_joints_and_shares_the_left_arm_first(dataset: Path) -> None:
    episode = open_episode(dataset / "ep_000000")
    assert episode.record.frame_period_s == pytest.approx(1 / 30)
    frames = episode.frames()
    state, action, joints, told = (
        np.array([frame[key] for frame in frames]) for key in ("state", "action", "joints", "ctrl")
    )
    hands, arms = [6, 13], [k for k in range(14) if k not in (6, 13)]
    assert state.shape == action.shape == (len(frames), 14)
    assert (state[:, arms] == joints[:, arms]).all()
    assert (action[:, arms] == told[:, arms]).all()
    assert state[:, hands] == pytest.approx(joints[:, hands] / 0.0475, abs=1e-6)
    assert action[:, hands].min() >= 0
    # The right hand closes by 12 mm of 47.5 on the banana; the left one stays unchanged.
    assert np.ptp(state[:, 13]) > 0.2
    assert np.ptp(state[:, 6]) < 0.02


def test_a_station_shaped_dataset_is_complete_and_verifies(dataset: Path) -> None:
    assert yamsim("summarize", dataset, "--strict").code == 0
    assert yamsim("verify", dataset, "--json").json["max_error"] == 0


def test_lerobot_has_no_welds_and_whole_frames_a_second(dataset: Path, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="yamsim[lerobot] is not installed")
    pytest.importorskip("av", reason="yamsim[lerobot] is not installed")
    done = yamsim("export", "lerobot", dataset, tmp_path / "out")
    assert done.code == 0, done.err
    info = json.loads((tmp_path / "out" / "meta" / "info.json").read_text())
    assert info["fps"] == 30
    for key in ("observation.state", "action"):
        assert info["features"][key]["shape"] == [14]
        assert info["features"][key]["names"][6::7] == ["left_gripper", "right_gripper"]


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (
            ("--fps", "20"),
            "--fps: at 20 frames a second, a frame is not a whole number of control ticks of 32 ms; valid: 29.2",
        ),
        (("--action", "joints"), "--action: action 'joints' cannot command a weld, but grasp is 'weld'; use grasp"),
    ],
)
def test_impossible_shapes_are_refused(flags: tuple[str, ...], said: str, tmp_path: Path) -> None:
    done = yamsim("record", *flags, "--out", tmp_path / "out")
    assert done.code != 0
    assert done.message.startswith(said)
    assert not (tmp_path / "out").exists()
