"""Motions are read from CSVs and from episodes, and errors of a CSV name the line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.real.recordings.making import same_motion, swinging, write_csv
from tests.unrendered import write_dataset
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.dataset.reader import open_episode
from yamsim_cli.core.errors import DatasetError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.real.recordings.csv_file import csv_columns, read_csv
from yamsim_cli.real.recordings.motion_faults import find_faults
from yamsim_cli.real.recordings.motion_reading import read_motions


@pytest.fixture(scope="module", params=["single", "russet"])
def rig(request: pytest.FixtureRequest, locations: Locations) -> RigConfig:
    return load_config(RigConfig, "rigs", request.param, locations)


def test_the_header_is_the_documented_one(single: RigConfig) -> None:
    kinds = [[f"{kind}_joint{k}" for k in range(1, 7)] + [f"{kind}_gripper"] for kind in ("command", "position")]
    assert csv_columns(single) == ["t", *kinds[0], *kinds[1]]


def test_a_csv_comes_back_to_the_last_bit(rig: RigConfig, locations: Locations, tmp_path: Path) -> None:
    motion = swinging(rig, 0.5)
    (read,) = read_motions([write_csv(tmp_path / "log.csv", motion, rig)], rig, locations)
    same_motion(read, motion, atol=0.0)


def test_an_arm_may_come_first_in_a_columns_name(locations: Locations, tmp_path: Path) -> None:
    rig = load_config(RigConfig, "rigs", "russet", locations)
    motion = swinging(rig, 0.5)
    path = write_csv(tmp_path / "log.csv", motion, rig)
    text = path.read_text()
    for kind in ("command", "position"):
        for side in ("left", "right"):
            text = text.replace(f"{kind}_{side}", f"{side}_{kind}")
    path.write_text(text)
    np.testing.assert_array_equal(read_csv(path, rig).arms[1].joints, motion.arms[1].joints)


def test_columns_that_were_not_recorded_are_none(single: RigConfig, tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    names = [name for name in csv_columns(single) if name.startswith("position_joint")]
    path.write_text(",".join(["t", "note", *names]) + "\n" + "12.5,7,0,0,0,0,0,0\n12.6,8,0,0,0,0,0,0.5\n")
    motion = read_csv(path, single)
    np.testing.assert_allclose(motion.times, [0.0, 0.1])
    (arm,) = motion.arms
    assert (arm.commands, arm.openings, arm.commanded_openings, arm.velocities) == (None, None, None, None)
    assert arm.joints[1, 5] == 0.5


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda lines: [lines[0].replace("t,", "time,"), *lines[1:]], "line 1: has no column 't'"),
        (lambda lines: [lines[0].replace("position_joint3", "joint3"), *lines[1:]], "no column 'position_joint3'"),
        (lambda lines: [lines[0].replace("joint2", "joint1"), *lines[1:]], "'command_joint1' appears twice"),
        (lambda lines: [*lines[:-1], lines[-1][:40]], "cut off"),
        (
            lambda lines: [*lines[:3], lines[3].replace(",", ",nan,", 1).rsplit(",", 1)[0], *lines[4:]],
            "line 4: command_joint1",
        ),
        (lambda lines: [*lines[:3], lines[2], *lines[3:]], "line 4: t is 0.01, and 0.01 in the line before"),
        (lambda lines: lines[:2], "has 1 samples"),
        (lambda lines: [], "has no column 't'"),
    ],
)
def test_errors_of_a_csv_name_its_line(single: RigConfig, tmp_path: Path, change, message: str) -> None:  # type: ignore[no-untyped-def]
    path = write_csv(tmp_path / "log.csv", swinging(single, 0.2), single)
    path.write_text("\n".join(change(path.read_text().splitlines())))
    with pytest.raises(DatasetError, match=r"log\.csv") as caught:
        read_csv(path, single)
    assert message in str(caught.value)


def test_missing_and_unknown_files_are_refused(single: RigConfig, locations: Locations, tmp_path: Path) -> None:
    (tmp_path / "log.txt").write_text("")
    for path, message in (
        (tmp_path / "log.txt", "is not a known kind of recording"),
        (tmp_path / "no.csv", "does not exist"),
    ):
        with pytest.raises(DatasetError, match=message):
            read_motions([path], single, locations)
    with pytest.raises(UsageError, match="no recording"):
        read_motions([], single, locations)


def test_another_rigs_csv_is_refused_with_the_columns(locations: Locations, single: RigConfig, tmp_path: Path) -> None:
    path = write_csv(tmp_path / "log.csv", swinging(single, 0.1), single)
    with pytest.raises(DatasetError, match="position_left_joint1"):
        read_csv(path, load_config(RigConfig, "rigs", "russet", locations))


@pytest.fixture(scope="module", params=[("single", 2), ("single", 7), ("russet", 2)], ids=str)
def recorded(
    request: pytest.FixtureRequest,
    locations: Locations,
    make_config: Callable[..., RecordConfig],
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[RecordConfig, Path]:
    """Record an episode of `pickplace`, with 2 or 7 control ticks in a frame, and one of `handover`, with 2."""
    rig, every = request.param
    task = {"single": "pickplace", "russet": "handover"}[rig]
    config = make_config({("rig",): rig, ("task",): task, ("task", "timing"): {"ticks_per_frame": every}})
    path = tmp_path_factory.mktemp("recorded") / "dataset"
    write_dataset(path, config, locations, 1)
    return config, path


def test_an_episodes_motion_has_a_command_a_tick_and_joints_at_frames(
    recorded: tuple[RecordConfig, Path], locations: Locations
) -> None:
    config, path = recorded
    (motion,) = read_motions([path], config.rig, locations)
    (again,) = read_motions([path / "ep_000000"], config.rig, locations)
    frames = open_episode(path / "ep_000000").frames()
    np.testing.assert_allclose(np.diff(motion.times), 0.032, atol=1e-9)
    every = config.task.timing.ticks_per_frame
    assert len(motion.times) == sum(len(frame["sim_ctrl"]) for frame in frames)
    for k, (arm, same) in enumerate(zip(motion.arms, again.arms, strict=True)):
        assert arm.commands is not None
        drives = slice(7 * k, 7 * k + 6)
        for number, frame in enumerate(frames):
            np.testing.assert_allclose(arm.joints[every * number], frame["joints"][drives], atol=1e-6)
            np.testing.assert_allclose(arm.commands[every * number], frame["ctrl"][drives], atol=1e-6)
        between = np.arange(len(arm.joints)) % every != 0
        assert np.isnan(arm.joints[between]).all()
        np.testing.assert_array_equal(arm.joints, same.joints)
    assert find_faults(motion, config.rig) == []


def test_an_episode_of_another_rig_is_refused(recorded: tuple[RecordConfig, Path], locations: Locations) -> None:
    config, path = recorded
    other = "russet" if config.rig.name == "single" else "single"
    with pytest.raises(DatasetError, match=f"give --rig {config.rig.name}"):
        read_motions([path], load_config(RigConfig, "rigs", other, locations), locations)
