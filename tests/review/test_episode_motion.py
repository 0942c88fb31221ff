"""Jerk, durations and joint ranges, and reports of other commands, in the overview."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from tests.cli.run_cli import yamsim
from tests.core.dataset.making import CAMERA, made, write_dataset
from tests.real.recordings.foreign import write_lerobot_v2, write_lowdim, write_raiden_raw
from tests.real.recordings.making import swinging
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.dataset.dataset_paths import episode_directories
from yamsim_cli.core.dataset.lowdim import make_frame
from yamsim_cli.core.dataset.reader import open_recorded_episode
from yamsim_cli.core.errors import ConfigError, DatasetError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.recorded_motion import RecordedMotion
from yamsim_cli.real.import_recording.importing import ImportRequest, import_recordings
from yamsim_cli.review.episode_detail import film_strip, gripper_columns, timeline
from yamsim_cli.review.episode_index import read_reports, read_rows
from yamsim_cli.review.episode_motion import measure_motion, read_motion

PERIOD, RATE, WIDTH = 0.02, 3.0, 0.4  # s, rad/s and rad of a swinging joint


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    """A dataset with one episode, whose second joint swings."""
    times = PERIOD * np.arange(150)
    frames = [
        make_frame(
            joints=np.array([[0.1, WIDTH * np.sin(RATE * t), 0, 0, 0, 0, 0.02 * np.sin(50 * t)]]),
            timestamp=float(t),
            intrinsics={CAMERA: np.eye(3)},
            extrinsics={CAMERA: np.eye(4)},
            object_poses={"banana": np.eye(4), "plate": np.eye(4)},
            ee_pose=np.eye(4)[None],
            ctrl=np.zeros((1, 7)),
            action_joints=np.zeros((1, 7)),
            magnet=np.array([False]),
            language_task="pick",
            language_prompt="pick",
        )
        for t in times
    ]
    with patch("os.fsync"):  # for 300 files
        return write_dataset(tmp_path / "dataset", made(0, frames=frames))


def test_the_figures_of_a_sine_are_those_of_its_formula(dataset: Path, locations: Locations) -> None:
    figures = measure_motion(open_recorded_episode(dataset / "ep_000000"), [6])
    assert figures["duration_s"] == pytest.approx(2.98)
    # The third derivative of a sine has the RMS a w^3 / sqrt(2); five of the six joints rest.
    assert figures["jerk"] == pytest.approx(WIDTH * RATE**3 / np.sqrt(2) / np.sqrt(6), rel=0.03)
    assert (figures["joint2_min"], figures["joint2_max"]) == (pytest.approx(-WIDTH, abs=1e-3), pytest.approx(WIDTH))
    assert (figures["joint1_min"], "joint7_min" in figures) == (pytest.approx(0.1), False)
    swings = 2.98 * RATE / (2 * np.pi)
    assert figures["path_rad"] == pytest.approx(4 * WIDTH * swings, rel=0.05)


def test_known_figures_need_no_frames_until_the_episode_changes(dataset: Path, tmp_path: Path) -> None:
    cache, directories = tmp_path / "cache/motion.json", dict(episode_directories(dataset))

    def read() -> dict[int, dict[str, float]]:
        return read_motion(directories, None, cache, dataset, lambda done, total: None)

    first = read()
    assert first[0]["jerk"] > 0
    shutil.rmtree(dataset / "ep_000000/lowdim")
    assert read() == first
    record = dataset / "ep_000000/episode.json"
    record.write_bytes(record.read_bytes() + b"\n")
    assert read() == {}, "a changed episode is read again, and cannot be"
    record.write_bytes(record.read_bytes()[:-1])
    cache.write_text('{"version": 1, "episodes": [')
    assert read() == {}, "a damaged cache is ignored"


def test_values_of_reports_and_motion_become_columns(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "d", made(0), made(1))
    (tmp_path / "gap.json").write_text(
        json.dumps({"recordings": [{"name": "d/ep_000001", "rms_rad": 0.0123}, {"name": "other.csv", "rms_rad": 1}]})
    )
    (tmp_path / "checks.json").write_text(json.dumps({"problems": [{"episode": "ep_000001", "code": "lowdim.jump"}]}))
    more = read_reports([tmp_path / "gap.json", tmp_path / "checks.json"])
    rows = read_rows(dataset, {1: {**more[1], "jerk": 5.0}})
    assert [row["gap_mrad"] for row in rows] == [None, 12.3]
    assert (rows[1]["problems"], rows[1]["jerk"], rows[0]["jerk"]) == (("lowdim.jump",), 5.0, None)
    assert (rows[1]["seed"], rows[1]["attempt"]) == (7, 1)
    (tmp_path / "gap.json").write_text('{"recordings": [{"name": "ep_000001"}]}')
    with pytest.raises(ConfigError, match="is no report of"):
        read_reports([tmp_path / "gap.json"])


@pytest.mark.parametrize("write", [write_lerobot_v2, write_raiden_raw, write_lowdim])
def test_recordings_of_other_programs_are_reviewed_after_an_import(
    write: Callable[[Path, RecordedMotion, RigConfig], Path], station: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    source = write(tmp_path / "source", swinging(station, 0.3), station)
    run = yamsim("review", source)
    assert run.code == 4
    assert f"import it with `yamsim import {source} --rig RIG --out DIR`" in run.err
    out = tmp_path / "real"
    import_recordings(ImportRequest([source], station, out=out), locations, lambda done, total: None)
    (row,) = read_rows(out, {})
    assert row["format"] in write.__name__
    directory = out / "ep_000000"
    detail = timeline(directory, station, out)
    assert len(detail["series"]["joints"]) == detail["frames"] == row["frames"]
    assert len(detail["grippers"]) == 2
    if write is not write_raiden_raw:
        assert len(film_strip(directory, out)) > 500
    else:
        with pytest.raises(DatasetError, match="has no pictures"):
            film_strip(directory, out)
    found = measure_motion(open_recorded_episode(directory), gripper_columns(station, 14))
    assert found["duration_s"] == pytest.approx(detail["times"][-1] - detail["times"][0], abs=1e-3)
    assert "joint12_max" in found
