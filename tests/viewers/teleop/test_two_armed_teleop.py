"""Two teleoperated arms: one at a time by hand, or both by a stream, as two leader arms send it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.cli.run_cli import yamsim
from tests.viewers.teleop.demonstrated import planned_lines, write_stream
from tests.viewers.teleop.tray import CollectingReceiver
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.viewers.teleop.teleop_scene import TeleopScene


@pytest.fixture(scope="module")
def handover(make_config: Callable[..., RecordConfig]) -> RecordConfig:
    return make_config({("rig",): "russet", ("task",): "handover"})


@pytest.fixture
def driven(handover: RecordConfig, locations: Locations) -> TeleopScene:
    return TeleopScene(Session(handover, locations), CollectingReceiver())


def hands(driven: TeleopScene) -> Array:
    """Positions of the left and the right hand (2, 3)."""
    return np.array([driven.data.site(name).xpos for name in ("arm2_pinch_site", "pinch_site")])


def test_one_arm_is_driven_and_then_the_other(driven: TeleopScene) -> None:
    assert (driven.sides, driven.status.arm) == (("left", "right"), "right"), "the one that begins the task"
    start = hands(driven)
    for number in (1, 0):
        wanted = driven.target_pose
        np.testing.assert_allclose(wanted[:3, 3], start[number], atol=0.005)
        wanted[2, 3] += 0.06
        driven.set_target_pose(wanted)
        driven.set_weld(False)
        driven.switch_arm()
        # It continues to its target.
        for _ in range(60):
            driven.advance_tick()
        moved = hands(driven) - start
        np.testing.assert_allclose(moved[number], (0, 0, 0.06), atol=0.008)
        assert np.abs(moved[1 - number]).max() < 0.005 or number == 0
    assert driven.status.arm == "right"
    driven.select_arm("left")
    assert driven.status.arm == "left"


def test_a_gripper_is_that_of_the_driven_arm(driven: TeleopScene) -> None:
    driven.toggle_gripper()
    assert not driven.status.gripper_open
    driven.switch_arm()
    assert driven.status.gripper_open


def test_an_arm_stops_before_the_other_one(driven: TeleopScene) -> None:
    """The left hand's target is the right hand."""
    other = driven.target_pose
    driven.switch_arm()
    driven.set_target_pose(other)
    for _ in range(120):
        driven.advance_tick()
    apart = np.linalg.norm(np.subtract(*hands(driven)))
    assert driven.status.obstacle
    assert 0.02 < apart < 0.2
    assert not driven.status.can_follow


@pytest.mark.render
@pytest.mark.slow
def test_a_stream_of_both_hands_over(handover: RecordConfig, locations: Locations, tmp_path: Path) -> None:
    stream = write_stream(tmp_path / "stream.jsonl", planned_lines(handover, locations, 0))
    out = tmp_path / "d"
    flags = ("--rig", "russet", "--task", "handover", "--size", "64x48", "--quality", "fast", "--wrist")
    done = yamsim("teleop", "--input", stream, "--out", out, "--json", *flags)
    assert done.code == 0, done.err
    assert json.loads(done.out)["episodes"] == 1, done.out
    record = json.loads((out / "ep_000000" / "episode.json").read_text())
    assert (record["source"], record["arms"]) == ("teleop", 2)
    assert set(record["cameras"]) == {"scene_camera", "left_wrist_camera", "right_wrist_camera"}
    summary = yamsim("summarize", out, "--strict", "--json")
    assert (summary.code, summary.json["problems"]) == (0, [])
    verified = yamsim("verify", out, "--json")
    assert (verified.code, verified.json["max_error"]) == (0, 0)
