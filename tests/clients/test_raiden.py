"""raiden's own code on exports; `YAMSIM_RAIDEN` names a checkout with the submodule `third_party/i2rt`."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.clients.environments import Interpreter, checkout
from tests.rendered import SMALL, write_rendered_dataset
from tests.unrendered import write_dataset
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.robots.models import ArmModel
from yamsim_cli.export.export_source import open_source
from yamsim_cli.export.raiden import export_raiden
from yamsim_cli.export.raiden_schema import RaidenOptions

pytestmark = [pytest.mark.client_heavy, pytest.mark.render]

# Frames at an episode's end that `rd shardify` omits, because they lack future frames.
LEFT_OUT = 12

Read = Callable[..., dict[str, Any]]


@pytest.fixture
def read(client: Callable[[str], Interpreter], tmp_path: Path, locations: Locations) -> Read:
    """Export a dataset, and return raiden's output for it, see `scripts/read_raiden.py`."""

    def run(dataset: Path, arms: str, options: RaidenOptions) -> dict[str, Any]:
        interpreter = client("raiden")
        source = open_source(dataset, None, locations)
        out = export_raiden(source, tmp_path / "out", locations, lambda *_: None, options).path
        (tmp_path / "raiden").mkdir()
        found = interpreter.run(
            "read_raiden.py", checkout("YAMSIM_RAIDEN"), out, tmp_path / "raiden", arms, timeout_s=900
        )
        counts = {path.parent.name: len(list(path.iterdir())) for path in sorted(out.glob("*/lowdim"))}
        return found | {"frames": frames(out / "0000"), "counts": counts}

    return run


def frames(episode: Path) -> list[dict[str, Any]]:
    return [pickle.loads(file.read_bytes()) for file in sorted((episode / "lowdim").iterdir())]


@pytest.fixture(scope="module")
def one_arm(
    tmp_path_factory: pytest.TempPathFactory, make_config: Callable[..., RecordConfig], locations: Locations
) -> Path:
    path = tmp_path_factory.mktemp("one_arm") / "dataset"
    write_rendered_dataset(path, make_config(SMALL | {("wrist",): True}), locations, 3)
    return path


def shares(found: dict[str, Any], locations: Locations) -> list[float]:
    """Return, for each episode, the largest commanded joint speed of `rd replay` as a share of the motor's."""
    return [float((np.array(episode["peak"][0]) / motors(locations)).max()) for episode in found["replay"].values()]


def motors(locations: Locations) -> np.ndarray:
    """Maximum speed of each joint's motor, rad/s."""
    return np.array([joint.motor_rad_s for joint in load_config(ArmModel, "robots", "i2rt_yam", locations).joints])


def test_it_shards_shows_and_plays_one_arm(read: Read, one_arm: Path, locations: Locations) -> None:
    found = read(one_arm, "bimanual", RaidenOptions())
    shards, counts = found["shards"], found["counts"]
    samples = sum(counts.values()) - 3 * LEFT_OUT
    pictures = {f"{name}_t{k}": samples for name in ("scene_camera", "left_wrist_camera") for k in (-1, 0)}
    wanted = {f"{name}.jpg": n for name, n in pictures.items()} | {
        f"{name}.depth.png": n for name, n in pictures.items()
    }
    once = dict.fromkeys(("lowdim.npz", "metadata.json", "language_instructions.json"), samples)
    assert shards["kinds"] == wanted | once
    assert shards["sequences"] == samples
    assert shards["anchors"] == {episode: count - LEFT_OUT for episode, count in counts.items()}
    assert list(counts) == ["0000", "0001", "0002"]
    assert shards["sizes"] == [[384, 384, 3]]
    assert shards["controls"] == ["plan"]
    assert shards["said"] == ["pick up the banana and put it on the plate"]
    assert found["visualized"]["pictures"] == 2 * counts["0000"]
    # The missing right arm stands still.
    assert shards["still"]
    assert all("right" in key for key in shards["still"])
    assert max(shares(found, locations)) < 1


def test_at_the_recorded_rate_it_would_play_nearly_twice_as_fast(
    read: Read, one_arm: Path, locations: Locations
) -> None:
    found = read(one_arm, "bimanual", RaidenOptions(fps=None))
    played = np.array(shares(found, locations))
    asked = [np.array([frame["action_joints"] for frame in frames(one_arm / f"ep_{k:06d}")]) for k in range(3)]
    moved = [(np.abs(np.diff(rows[:, :6], axis=0)).max(axis=0) * 15.625 / motors(locations)).max() for rows in asked]
    np.testing.assert_allclose(played / moved, 30 / 15.625, rtol=0.1)


def test_arrays_of_one_arm_leave_nothing_that_stands_still(read: Read, one_arm: Path) -> None:
    found = read(one_arm, "single", RaidenOptions(pictures="nearest", as_single_arm=True))
    assert found["shards"]["still"] == []
    assert found["shards"]["kinds"]["left_wrist_camera_t0.jpg"] == sum(found["counts"].values()) - 3 * LEFT_OUT
    assert not any("right" in key for key in found["shards"]["widths"])
    same(found["converted"], hand=0.0095)


def same(apart: dict[str, float], *, hand: float) -> None:
    """Its converter gives the same values; hands, and cameras on them, within a tolerance in m."""
    for key, value in apart.items():
        limit = 1e-6
        if key in ("action", "actual_poses") or (key.startswith("extrinsics") and "wrist" in key):
            limit = 2e-5 if key.endswith("rotation") else hand
        assert value <= limit, (key, value)


def test_by_its_own_kinematics_the_hands_are_the_very_same_and_the_joints_come_back(
    read: Read, tmp_path: Path, make_config: Callable[..., RecordConfig], locations: Locations
) -> None:
    config = make_config({("rig",): "russet", ("task",): "handover", ("wrist",): True, ("image", "size_px"): [24, 16]})
    write_dataset(tmp_path / "dataset", config, locations, 1)
    found = read(tmp_path / "dataset", "bimanual", RaidenOptions(pictures="nearest", hand_frame="i2rt"))
    same(found["converted"], hand=0.004)
    for key in ("action", "actual_poses", "T_left_from_right", "joints", "action_joints"):
        assert found["converted"][key] == 0.0
    assert found["shards"]["kinds"]["right_wrist_camera_t0.jpg"] == found["counts"]["0000"] - LEFT_OUT
    assert found["shards"]["still"] == []
    assert found["visualized"]["pictures"] == 3 * found["counts"]["0000"]
    off = np.concatenate([episode["off"] for episode in found["replay"].values()])
    assert off.max() < 0.002
    # Its viewer's right hand in the left base shows that T_left_from_right has the right direction.
    hands = [frame["T_left_from_right"] @ np.append(frame["action"][13:16], 1) for frame in found["frames"]]
    np.testing.assert_allclose(found["visualized"]["right_hand"], np.array(hands)[:, :3], atol=1e-5)
    assert np.array(found["visualized"]["right_hand"])[:, 1].max() < 0
