"""Whatever format a recording is in, what is wrong with it is told in one line, or it is refused with one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.core.export.real_datasets import NAMES, some
from tests.core.recordings.foreign import write_lerobot_v2, write_lerobot_v3, write_lowdim, write_raiden_raw
from tests.core.recordings.foreign_mcap import write_mcap
from tests.core.recordings.making import swinging, write_csv
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.import_recording.importing import ImportReport, ImportRequest, import_recordings
from yamsim_cli.core.motion import Motion
from yamsim_cli.core.recordings.faults import find_faults
from yamsim_cli.core.recordings.reading import format_of, reader_of
from yamsim_cli.core.resources import Locations

Writer = Callable[[Path, Motion, RigConfig], Path]
Spoiler = Callable[[Motion, float], Motion]

# Format -> what writes one, and the file of it that is cut off; itself where it is one.
WRITERS: Mapping[str, tuple[Writer, str]] = {
    "csv": (lambda path, motion, rig: write_csv(path.with_suffix(".csv"), motion, rig), ""),
    "lowdim": (write_lowdim, "lowdim/000070.pkl"),
    "raiden_raw": (write_raiden_raw, "robot_data.npz"),
    "lerobot_v2": (
        lambda path, motion, rig: write_lerobot_v2(path, motion, rig, NAMES),
        "data/chunk-000/episode_000000.parquet",
    ),
    "lerobot_v3": (
        lambda path, motion, rig: write_lerobot_v3(path, motion, rig, NAMES),
        "data/chunk-000/file-000.parquet",
    ),
    "mcap": (lambda path, motion, rig: write_mcap(path.with_suffix(".mcap"), motion, rig), ""),
}


@pytest.fixture(scope="module")
def station(locations: Locations) -> RigConfig:
    return load_config(RigConfig, "rigs", "yam_station_linear_4310_d405", locations)


def bring_in(path: Path, rig: RigConfig, locations: Locations) -> ImportReport:
    request = ImportRequest([path], rig, out=path.parent / "real")
    return import_recordings(request, locations, lambda done, total: None)


def full_opening(rig: RigConfig) -> float:
    fingers = rig.arms[0].robot.fingers
    assert fingers is not None
    return fingers.full_opening


def with_gap(motion: Motion, full: float) -> Motion:
    kept = np.r_[0:60, 130:200]
    cut = some(motion, kept)
    return replace(cut, times=motion.times[kept])


def swapped(motion: Motion, full: float) -> Motion:
    left, right = motion.arms
    arms = (
        replace(left, joints=right.joints, openings=right.openings),
        replace(right, joints=left.joints, openings=left.openings),
    )
    return replace(motion, arms=arms)


def in_degrees(motion: Motion, full: float) -> Motion:
    arms = [
        replace(arm, joints=np.rad2deg(arm.joints), commands=np.rad2deg(arm.commands))  # type: ignore[arg-type]
        for arm in motion.arms
    ]
    return replace(motion, arms=tuple(arms))


def upside_down(motion: Motion, full: float) -> Motion:
    arms = [replace(arm, openings=full - arm.openings) for arm in motion.arms]  # type: ignore[operator]
    return replace(motion, arms=tuple(arms))


def froze(motion: Motion, full: float) -> Motion:
    left, right = motion.arms
    joints = right.joints.copy()
    joints[50:, 2] = joints[50, 2]
    return replace(motion, arms=(left, replace(right, joints=joints)))


# Fault -> what does it to a motion, a word of the line on it, and whether the recording is refused.
FAULTS: Mapping[str, tuple[Spoiler, str, bool]] = {
    "gap": (with_gap, "nothing was recorded for 0.71 s from 0.59 s on", False),
    "froze": (froze, "right_joint3 was measured at exactly", False),
    "swapped": (swapped, "are the arms swapped? If so, say --swap-arms", True),
    "degrees": (in_degrees, "are these degrees? If so, say --degrees", True),
    "upside_down": (upside_down, "closes while commanded to open", True),
}


@pytest.mark.parametrize("form", list(WRITERS))
@pytest.mark.parametrize("fault", list(FAULTS))
def test_a_fault_is_told(form: str, fault: str, station: RigConfig, locations: Locations, tmp_path: Path) -> None:
    spoil, line, refused = FAULTS[fault]
    motion = spoil(swinging(station, 2.0), full_opening(station))
    path = WRITERS[form][0](tmp_path / "one", motion, station)
    assert form.startswith(format_of(path))
    if refused:
        with pytest.raises(DatasetError) as caught:
            bring_in(path, station, locations)
        assert line in str(caught.value)
        assert "\n" not in str(caught.value)
        assert not (tmp_path / "real").exists()
        return
    (problems,) = bring_in(path, station, locations).problems.values()
    assert len(problems) == 1
    assert line in problems[0]


@pytest.mark.parametrize("form", list(WRITERS))
def test_a_good_recording_has_no_problem(form: str, station: RigConfig, locations: Locations, tmp_path: Path) -> None:
    path = WRITERS[form][0](tmp_path / "one", swinging(station, 2.0), station)
    (recording,) = reader_of(format_of(path))(path, station, None, locations)
    assert recording.problems == ()
    assert find_faults(recording.in_metres(station), station) == []


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
    with pytest.raises(DatasetError) as caught:
        bring_in(path, station, locations)
    assert file.name in str(caught.value)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "real").exists()


@pytest.mark.parametrize("form", ["lerobot_v2", "lerobot_v3"])
def test_a_film_that_was_cut_off_leaves_nothing(
    form: str, station: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    path = WRITERS[form][0](tmp_path / "one", swinging(station, 1.0), station)
    (film,) = path.glob("videos/**/*.mp4")
    film.write_bytes(film.read_bytes()[:-2000])
    with pytest.raises(DatasetError, match=film.name):
        bring_in(path, station, locations)
    assert not list((tmp_path / "real").glob("ep_*"))
