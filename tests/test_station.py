"""A simulated station for programs of real ones: rows and pictures as in recordings."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
import pytest

from tests.attempts import planned
from yamsim_cli.api import API_SESSION_OPENER
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.attempt_payload import frame_records
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.errors import ConfigError, UsageError
from yamsim_cli.station import Station, StationForm, StationSettings

JOINTS = StationSettings(rig="single_linear", grasp="contact", action="joints", fps=30, size=(64, 48))
DRIVES = StationSettings(size="64x48")
SIX = tuple(f"joint{k}" for k in range(1, 7))


@pytest.fixture(scope="module")
def station() -> Iterator[Station]:
    with Station(JOINTS, pictures=False) as made:
        yield made


def test_its_form_is_known_before_it_is_built() -> None:
    form = StationForm.from_settings(JOINTS)
    assert form.state == form.action == (*SIX, "gripper")
    assert dict(form.cameras) == {"scene_camera": (48, 64, 3), "right_wrist_camera": (48, 64, 3)}
    assert (form.fps, form.most_frames) == (30, 600)
    assert [name for name in form.environment if "axis" not in name] == [
        f"{thing}_{axis}" for thing in ("banana", "plate") for axis in "xyz"
    ]
    drives = StationForm.from_settings(DRIVES)
    assert (drives.action, drives.fps) == ((*SIX, "gripper", "magnet"), 15.625)


def test_two_arms_have_the_left_one_first() -> None:
    form = StationForm.from_settings(StationSettings(task="handover", rig="russet", cameras=("scene_camera",)))
    assert form.state == (*(f"left_{name}" for name in (*SIX, "gripper")), *form.state[7:])
    assert form.action[14:] == ("left_magnet", "right_magnet") and list(form.cameras) == ["scene_camera"]


@pytest.mark.slow
@pytest.mark.parametrize("end", ["actor", "success"])
def test_the_experts_rows_make_the_recorded_episode_again(end: Literal["actor", "success"]) -> None:
    """Frame by frame: states, object poses, and a success at the end, judged as a recording.

    By the rule `success`, the trial ends with it, possibly before the expert's arm is back.
    """
    with Station(JOINTS, pictures=False, end=end) as station:
        made_again(station, end)


def made_again(station: Station, end: Literal["actor", "success"]) -> None:
    rows = station.begin_demonstrated(seed=3, trial=1)
    with Simulator(
        Session(
            API_SESSION_OPENER.load_record_config("default", API_SESSION_OPENER.find_locations(), **JOINTS.given),
            API_SESSION_OPENER.find_locations(),
        )
    ) as one:
        done = planned(one, 3, station.trial)
        recorded = frame_records(one, done.attempt, done.recorded_states)
    assert len(rows) == len(recorded)
    reached = False
    for row, frame in zip(rows, recorded, strict=True):
        if reached and end == "success":
            break
        np.testing.assert_allclose(row, frame["action"], atol=1e-6)
        # Commands are rounded to float32.
        np.testing.assert_allclose(station.state(), frame["state"], atol=2e-4)
        told = dict(zip(station.form.environment, station.environment(), strict=True))
        y_axis = [told[f"plate_y_axis_{axis}"] for axis in "xyz"]
        np.testing.assert_allclose([told[f"plate_{axis}"] for axis in "xyz"], frame["plate_pose"][:3, 3], atol=1e-4)
        np.testing.assert_allclose(y_axis, frame["plate_pose"][:3, 1], atol=1e-3)
        station.command(row)
        reached = station.advance() or reached
    assert reached and station.judge() == ""
    if end == "actor":
        assert station.time == pytest.approx(len(rows) / 30)
    else:
        assert len(rows) / 60 < station.time < len(rows) / 30
        ended = station.state()
        station.advance()
        np.testing.assert_array_equal(station.state(), ended)


def test_arms_stay_until_they_are_told(station: Station) -> None:
    assert station.begin(seed=3, trial=1) == 1
    before = station.state()
    for _ in range(10):
        assert not station.advance()
    np.testing.assert_allclose(station.state(), before, atol=0.01)
    assert "the banana" in station.prompt and station.judge() != ""


@pytest.mark.parametrize("row", [[0.0] * 6, [0.0] * 8, [np.nan] * 7, [[0.0] * 7]])
def test_a_command_that_is_none_is_told_and_changes_nothing(station: Station, row: list[float]) -> None:
    station.begin(seed=3, trial=1)
    with pytest.raises(UsageError, match="a command is 7 finite numbers"):
        station.command(row)
    before = station.state()
    station.advance()
    np.testing.assert_allclose(station.state(), before, atol=0.01)


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        (StationSettings(task="pickplac"), r"^task=: task: unknown task 'pickplac'; did you mean 'pickplace'"),
        (StationSettings(cameras=("top",), spelling="--env.{}"), r"^--env.cameras: rig 'single' has no camera 'top'"),
        (
            StationSettings(action="joints", spelling="--env.{}"),
            r"^--env.action: action 'joints' cannot command a weld",
        ),
    ],
)
def test_settings_that_are_not_valid_are_told_as_they_were_given(settings: StationSettings, told: str) -> None:
    with pytest.raises((ConfigError, UsageError), match=told):
        StationForm.from_settings(settings)


@pytest.mark.render
def test_pictures_are_of_the_moment_that_is_asked_for() -> None:
    with Station(DRIVES) as station:
        rows = station.begin_demonstrated()
        start, first = station.positions(), station.pictures()
        assert {camera: image.shape for camera, image in first.items()} == station.form.cameras
        for row in rows[:20]:
            station.command(row)
            station.advance()
        assert np.abs(station.pictures()["scene_camera"].astype(int) - first["scene_camera"]).max() > 50
        np.testing.assert_array_equal(station.pictures(["scene_camera"], start)["scene_camera"], first["scene_camera"])
