"""Faults of recordings are found in every format, and a good recording has none."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.real.recordings.foreign import write_lerobot_v2, write_lerobot_v3, write_lowdim, write_mcap, write_raiden_raw
from tests.real.recordings.making import (
    froze,
    frozen,
    full_opening,
    in_degrees,
    some,
    swapped,
    swinging,
    upside_down,
    with_gap,
    write_csv,
)
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.dataset.reader import open_recorded_episode
from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.recorded_motion import RecordedMotion
from yamsim_cli.real.import_recording.importing import ImportReport, ImportRequest, import_recordings
from yamsim_cli.real.recordings.motion_faults import MotionFault, MotionProblem, find_faults
from yamsim_cli.real.recordings.motion_reading import detect_format, format_reader

Writer = Callable[[Path, RecordedMotion, RigConfig], Path]

# Format -> its writer, and the truncated file; empty for the recording itself.
WRITERS: Mapping[str, tuple[Writer, str]] = {
    "csv": (lambda path, motion, rig: write_csv(path.with_suffix(".csv"), motion, rig), ""),
    "lowdim": (write_lowdim, "lowdim/000070.pkl"),
    "raiden_raw": (write_raiden_raw, "robot_data.npz"),
    "lerobot_v2": (write_lerobot_v2, "data/chunk-000/episode_000000.parquet"),
    "lerobot_v3": (write_lerobot_v3, "data/chunk-000/file-000.parquet"),
    "mcap": (lambda path, motion, rig: write_mcap(path.with_suffix(".mcap"), motion, rig), ""),
}


@pytest.fixture(scope="module", params=["single", "russet", "yam_station_linear_4310_d405"])
def rig(request: pytest.FixtureRequest, locations: Locations) -> RigConfig:
    return load_config(RigConfig, "rigs", request.param, locations)


def with_first(motion: RecordedMotion, **changes: Array) -> RecordedMotion:
    return replace(motion, arms=(replace(motion.arms[0], **changes), *motion.arms[1:]))


def only(motion: RecordedMotion, rig: RigConfig) -> MotionProblem:
    (problem,) = find_faults(motion, rig)
    return problem


def test_samples_without_measurements_are_no_fault(rig: RigConfig) -> None:
    motion = swinging(rig)
    assert find_faults(motion, rig) == []
    arms = []
    for arm in motion.arms:
        joints = arm.joints.copy()
        joints[1::2] = np.nan
        arms.append(replace(arm, joints=joints, openings=None))
    assert find_faults(replace(motion, arms=tuple(arms)), rig) == []


def _moved(first: int, joint: int, by: float) -> Callable[[Array], Array]:
    def spoil(joints: Array) -> Array:
        joints[first:, joint] += by
        return joints

    return spoil


@pytest.mark.parametrize(
    ("spoil", "fault", "text", "time"),
    [
        (np.rad2deg, MotionFault.DEGREES, "degrees", None),
        (_moved(0, 1, -2.0), MotionFault.BEYOND_STOPS, "joint2 is at", ...),
        (_moved(200, 3, 0.4), MotionFault.TOO_FAST, "joint4 jumps", 1.99),
        (frozen(150, 4), MotionFault.FROZEN, "joint5 was measured", 1.5),
    ],
)
def test_a_fault_of_joints_is_reported_with_its_joint_and_time(
    spoil: Callable[[Array], Array], fault: MotionFault, text: str, time: float | None, rig: RigConfig
) -> None:
    motion = swinging(rig)
    problem = only(with_first(motion, joints=spoil(motion.arms[0].joints.copy())), rig)
    assert problem.fault is fault
    assert text in problem.text
    assert time is ... or problem.time == (None if time is None else pytest.approx(time))


def test_a_gap_is_reported_with_its_time_and_length(rig: RigConfig) -> None:
    kept = np.r_[0:100, 180:400]
    cut = replace(swinging(rig), times=swinging(rig).times[kept], arms=some(swinging(rig), kept).arms)
    problem = next(one for one in find_faults(cut, rig) if one.fault is MotionFault.GAP)
    assert problem.time == pytest.approx(0.99)
    assert "0.81 s" in problem.text


def test_a_gripper_in_shares_is_reported(rig: RigConfig) -> None:
    motion = swinging(rig)
    openings = motion.arms[0].openings
    assert openings is not None
    assert only(with_first(motion, openings=openings / 0.03), rig).fault is MotionFault.GRIPPER_SHARE


@pytest.mark.parametrize(("mirrored", "faults"), [(False, []), (True, [MotionFault.GRIPPER_STALLS_OPENING])])
def test_a_gripper_that_stalls_only_while_opening_is_mirrored(
    mirrored: bool, faults: list[MotionFault], rig: RigConfig
) -> None:
    """Fingers close onto an object of 30 mm. With both openings mirrored, they stall while opening."""
    motion = swinging(rig, 4.0)
    full = full_opening(rig)
    commanded = full * (1 - np.clip((motion.times - 0.5) / 0.3, 0, 1))
    measured = np.maximum(commanded, 0.015)
    if mirrored:
        commanded, measured = full - commanded, full - measured
    found = find_faults(with_first(motion, openings=measured, commanded_openings=commanded), rig)
    assert [problem.fault for problem in found] == faults
    assert all("--mirror-gripper both" in problem.text for problem in found)


# Fault -> function that causes it, a part of its message, and whether the recording is refused.
FAULTS: Mapping[str, tuple[Callable[[RecordedMotion, float], RecordedMotion], str, bool]] = {
    "gap": (with_gap, "nothing was recorded for 0.71 s from 0.59 s on", False),
    "froze": (froze, "right_joint3 was measured at exactly", False),
    "swapped": (swapped, "are the arms swapped? If so, add --swap-arms", True),
    "degrees": (in_degrees, "are these degrees? If so, add --degrees", True),
    "upside_down": (upside_down, "closes while commanded to open", True),
}


def bring_in(path: Path, rig: RigConfig, locations: Locations) -> ImportReport:
    request = ImportRequest([path], rig, out=path.parent / "real")
    return import_recordings(request, locations, lambda done, total: None)


def refused(path: Path, rig: RigConfig, locations: Locations) -> str:
    """Return the one-line error of an import."""
    with pytest.raises(DatasetError) as caught:
        bring_in(path, rig, locations)
    assert "\n" not in str(caught.value)
    assert not list((path.parent / "real").glob("ep_*"))
    return str(caught.value)


@pytest.mark.parametrize("form", list(WRITERS))
@pytest.mark.parametrize("fault", list(FAULTS))
def test_a_fault_is_reported_or_refused(
    form: str, fault: str, station: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    spoil, line, is_refused = FAULTS[fault]
    motion = spoil(swinging(station, 2.0), full_opening(station))
    path = WRITERS[form][0](tmp_path / "one", motion, station)
    assert form.startswith(detect_format(path))
    if is_refused:
        assert line in refused(path, station, locations)
        assert not (tmp_path / "real").exists()
    else:
        ((problem,),) = bring_in(path, station, locations).problems.values()
        assert line in problem
        assert open_recorded_episode(tmp_path / "real/ep_000000").record.problems == (problem,)  # type: ignore[union-attr]


@pytest.mark.parametrize("form", list(WRITERS))
def test_a_good_recording_has_no_problem(form: str, station: RigConfig, locations: Locations, tmp_path: Path) -> None:
    path = WRITERS[form][0](tmp_path / "one", swinging(station, 2.0), station)
    (recording,) = format_reader(detect_format(path))(path, station, None, locations)
    assert recording.problems == ()
    assert find_faults(recording.motion_in_metres(station), station) == []


@pytest.mark.parametrize("share", [0.2, 0.6, 0.98])
@pytest.mark.parametrize("form", list(WRITERS))
def test_a_file_that_was_cut_off_is_refused(
    form: str, share: float, station: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    write, part = WRITERS[form]
    path = write(tmp_path / "one", swinging(station, 1.0), station)
    file = path / part if part else path
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    assert file.name in refused(path, station, locations)
    assert not (tmp_path / "real").exists()


@pytest.mark.parametrize("form", ["lerobot_v2", "lerobot_v3"])
def test_a_film_that_was_cut_off_leaves_nothing(
    form: str, station: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    path = WRITERS[form][0](tmp_path / "one", swinging(station, 1.0), station)
    (film,) = path.glob("videos/**/*.mp4")
    film.write_bytes(film.read_bytes()[:-2000])
    assert film.name in refused(path, station, locations)
