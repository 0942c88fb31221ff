"""Recordings of real arms are imported as whole episodes with exactly the recorded data."""

from __future__ import annotations

import json
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.real.recordings.foreign import PROMPT, write_lerobot_v2, write_lowdim, write_raiden_raw
from tests.real.recordings.making import (
    full_opening,
    in_degrees,
    same_motion,
    swapped,
    swinging,
    upside_down,
    write_csv,
)
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.dataset.reader import open_episode, open_recorded_episode, read_recorded_rig, read_recording_config
from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode
from yamsim_cli.core.errors import ConfigError, DatasetError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import pose
from yamsim_cli.core.recorded_motion import RecordedMotion
from yamsim_cli.datasets.check_summary import summarize_checks
from yamsim_cli.datasets.summarize import check_dataset
from yamsim_cli.photos.overlay.photos import episode_photos
from yamsim_cli.real.import_recording.importing import (
    Corrections,
    ImportReport,
    ImportRequest,
    KnownCamera,
    import_recordings,
)
from yamsim_cli.real.recordings.motion_reading import read_motions


def bring_in(request: ImportRequest, locations: Locations) -> ImportReport:
    return import_recordings(request, locations, lambda done, total: None)


def test_a_csv_becomes_an_episode_and_comes_back(single: RigConfig, locations: Locations, tmp_path: Path) -> None:
    motion = swinging(single, 0.5)
    source = write_csv(tmp_path / "log.csv", motion, single)
    report = bring_in(ImportRequest([source], single, out=tmp_path / "real"), locations)
    assert (report.episodes, report.frames, report.problems) == (1, 50, {})
    record = json.loads((tmp_path / "real/ep_000000/episode.json").read_text())
    assert (record["source"], record["format_version"], record["imported"]["format"]) == ("real", 4, "csv")
    (back,) = read_motions([tmp_path / "real"], single, locations)
    same_motion(back, motion)
    assert set(open_recorded_episode(tmp_path / "real/ep_000000").frames()[0]) == {"joints", "timestamp", "ctrl"}


def test_imported_recordings_cannot_be_simulated_again(single: RigConfig, locations: Locations, tmp_path: Path) -> None:
    source = write_csv(tmp_path / "log.csv", swinging(single, 0.3), single)
    bring_in(ImportRequest([source], single, out=tmp_path / "real"), locations)
    with pytest.raises(DatasetError, match="imported recording"):
        open_episode(tmp_path / "real/ep_000000")
    with pytest.raises(DatasetError, match="not simulated"):
        read_recording_config(tmp_path / "real", locations)


def test_pictures_and_words_come_along(station: RigConfig, locations: Locations, tmp_path: Path) -> None:
    folder = write_lerobot_v2(tmp_path / "two", swinging(station, 0.3), station)
    bring_in(ImportRequest([folder], station, out=tmp_path / "real"), locations)
    episode = open_recorded_episode(tmp_path / "real/ep_000000")
    assert episode.record.cameras == {"top": (64, 48)}
    frame = episode.frames()[0]
    assert frame["language_prompt"] == PROMPT
    # Camera matrices and objects were not recorded.
    assert set(frame) == {"joints", "timestamp", "ctrl", "language_prompt"}
    assert all(episode.image("top", k)[:2] == b"\xff\xd8" for k in range(episode.record.frames))


def test_photos_with_a_known_place_are_overlaid_on(single: RigConfig, locations: Locations, tmp_path: Path) -> None:
    """Each frame gives a photo with its camera's lens and pose, and the arm's joints."""
    motion = swinging(single, 0.1)
    folder = write_lowdim(tmp_path / "one", motion, single)
    T = pose([0.4, 0.0, 0.9], np.diag([1.0, -1.0, -1.0]))
    for file in (folder / "lowdim").iterdir():
        known = {"intrinsics": {"scene_camera": np.diag([30.0, 30.0, 1.0])}, "extrinsics": {"scene_camera": T}}
        file.write_bytes(pickle.dumps(pickle.loads(file.read_bytes()) | known))
    bring_in(ImportRequest([folder], single, out=tmp_path / "real"), locations)
    rig = read_recorded_rig(tmp_path / "real", locations)
    photos = episode_photos(tmp_path / "real/ep_000000", None, rig)
    assert (rig.name, len(photos)) == ("single", 10)
    assert photos[3].T_base_in_cam is not None
    np.testing.assert_allclose(photos[3].T_base_in_cam, np.linalg.inv(T), atol=1e-6)
    assert photos[3].time == pytest.approx(0.03)


def test_the_calibration_of_a_camera_is_stored(single: RigConfig, locations: Locations, tmp_path: Path) -> None:
    folder = write_lowdim(tmp_path / "one", swinging(single, 0.1), single)
    T, K = pose([0.4, 0.0, 0.9], np.diag([1.0, -1.0, -1.0])), np.diag([30.0, 30.0, 1.0])

    def request(name: str, size: tuple[int, int], out: str) -> ImportRequest:
        cameras = {name: KnownCamera(K, size, T, distorted=True)}
        return ImportRequest([folder], single, out=tmp_path / out, cameras=cameras)

    bring_in(request("scene_camera", (32, 24), "real"), locations)
    (photo, *_) = episode_photos(tmp_path / "real/ep_000000", None, read_recorded_rig(tmp_path / "real", locations))
    assert photo.camera is not None and photo.camera.mean_focal_length == 30
    assert photo.T_base_in_cam is not None
    np.testing.assert_allclose(photo.T_base_in_cam, np.linalg.inv(T), atol=1e-6)
    problems = open_recorded_episode(tmp_path / "real/ep_000000").record.problems
    assert any("lens distortion" in problem for problem in problems)
    with pytest.raises(DatasetError, match=r"is calibrated for \(320, 240\)"):
        bring_in(request("scene_camera", (320, 240), "other"), locations)
    with pytest.raises(UsageError, match="the calibration has cameras top, and the recording scene_camera"):
        bring_in(request("top", (32, 24), "none"), locations)


def test_photos_without_a_place_say_how_they_are_used(single: RigConfig, locations: Locations, tmp_path: Path) -> None:
    folder = write_lowdim(tmp_path / "one", swinging(single, 0.1), single)
    bring_in(ImportRequest([folder], single, out=tmp_path / "real"), locations)
    with pytest.raises(DatasetError, match=r"--img .*rgb/scene_camera"):
        episode_photos(tmp_path / "real/ep_000000", None, single)


@pytest.mark.slow
def test_a_dataset_of_real_recordings_is_checked(station: RigConfig, locations: Locations, tmp_path: Path) -> None:
    raw = write_raiden_raw(tmp_path / "raw", swinging(station, 0.5), station)
    out = tmp_path / "real"
    bring_in(ImportRequest([raw], station, out=out), locations)
    assert codes(out, locations) == set()
    report = summarize_checks(check_dataset(out, locations, 1, lambda done, total: None), (0.05,))
    assert (report["real"], report["success_rate"], report["noted_at_import"]) == (True, {}, {})
    (out / "ep_000000/lowdim/000007.pkl").write_bytes((out / "ep_000000/lowdim/000008.pkl").read_bytes())
    (out / "ep_000000/lowdim/000049.pkl").unlink()
    assert {"file.hash", "file.missing"} <= codes(out, locations)


def codes(dataset: Path, locations: Locations) -> set[str]:
    return {problem.code for problem in check_dataset(dataset, locations, 1, lambda done, total: None).problems}


def _shares(motion: RecordedMotion, full: float) -> RecordedMotion:
    arms = [
        replace(arm, openings=arm.openings / full, commanded_openings=arm.commanded_openings / full)  # type: ignore[operator]
        for arm in motion.arms
    ]
    return replace(motion, arms=tuple(arms))


def _commands_upside_down(motion: RecordedMotion, full: float) -> RecordedMotion:
    arms = [replace(arm, commanded_openings=full - arm.commanded_openings) for arm in motion.arms]  # type: ignore[operator]
    return replace(motion, arms=tuple(arms))


@pytest.mark.parametrize(
    ("spoil", "flag", "corrections"),
    [
        (in_degrees, "--degrees", Corrections(degrees=True)),
        (swapped, "--swap-arms", Corrections(swap_arms=True)),
        (_shares, "--gripper share", Corrections(gripper="share")),
        (upside_down, "--mirror-gripper measured", Corrections(mirrored="measured")),
        (_commands_upside_down, "or --mirror-gripper commanded", Corrections(mirrored="commanded")),
    ],
)
def test_a_refused_recording_is_imported_with_its_correction(
    spoil: Callable[[RecordedMotion, float], RecordedMotion],
    flag: str,
    corrections: Corrections,
    station: RigConfig,
    locations: Locations,
    tmp_path: Path,
) -> None:
    motion = swinging(station, 2.0)
    source = write_csv(tmp_path / "log.csv", spoil(motion, full_opening(station)), station)
    request = ImportRequest([source], station, out=tmp_path / "real")
    with pytest.raises(DatasetError, match=flag):
        bring_in(request, locations)
    assert not (tmp_path / "real").exists()
    bring_in(replace(request, corrections=corrections), locations)
    (back,) = read_motions([tmp_path / "real"], station, locations)
    same_motion(back, motion, atol=1e-5)


def test_resuming_keeps_existing_episodes(single: RigConfig, locations: Locations, tmp_path: Path) -> None:
    one = write_csv(tmp_path / "one.csv", swinging(single, 0.3), single)
    two = write_csv(tmp_path / "two.csv", swinging(single, 0.4), single)
    request = ImportRequest([one], single, out=tmp_path / "real")
    bring_in(request, locations)
    before = (tmp_path / "real/ep_000000/episode.json").stat().st_mtime_ns
    with pytest.raises(UsageError, match="--resume"):
        bring_in(replace(request, sources=[one, two]), locations)
    report = bring_in(replace(request, sources=[one, two], mode=ExistingDatasetMode.RESUME), locations)
    assert (report.kept_episodes, report.episodes) == (1, 1)
    assert (tmp_path / "real/ep_000000/episode.json").stat().st_mtime_ns == before
    with pytest.raises(ConfigError, match="gripper"):
        bring_in(replace(request, mode=ExistingDatasetMode.RESUME, corrections=Corrections(gripper="share")), locations)
