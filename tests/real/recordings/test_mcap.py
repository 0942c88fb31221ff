"""MCAP files as ABC-130k has them: protobuf, states and actions of arms and grippers apart, videos in packets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.real.recordings.foreign import FILM_EVERY, PROMPT, grey_of, write_mcap
from tests.real.recordings.making import same_motion, swinging
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.images.jpeg import decode_jpeg
from yamsim_cli.core.recorded_motion import RecordedMotion
from yamsim_cli.real.import_recording.importing import ImportRequest, import_recordings
from yamsim_cli.real.recordings.motion_reading import detect_format, format_reader

pytest.importorskip("mcap", reason="the extra mcap is not installed")


@pytest.fixture(scope="module")
def motion(station: RigConfig) -> RecordedMotion:
    return swinging(station, 0.6)


@pytest.fixture(scope="module")
def file(station: RigConfig, motion: RecordedMotion, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_mcap(tmp_path_factory.mktemp("mcap") / "episode.mcap", motion, station)


def test_a_recording_comes_in_with_its_film(
    file: Path, station: RigConfig, motion: RecordedMotion, locations: Locations
) -> None:
    assert detect_format(file) == "mcap"
    (recording,) = format_reader("mcap")(file, station, None, locations)
    same_motion(recording.motion_in_metres(station), motion, atol=1e-9)
    assert recording.prompt == PROMPT
    pictures = recording.pictures["top_camera"]
    np.testing.assert_array_equal(pictures.samples, np.arange(0, len(motion.times), FILM_EVERY))
    images = [decode_jpeg(data) for data in pictures.read()]
    assert len(images) == len(pictures.samples)
    for k, image in enumerate(images):
        assert image is not None
        assert abs(float(image.mean()) - grey_of(k)) < 3


def test_the_error_for_another_rig_names_the_topics(file: Path, single: RigConfig, locations: Locations) -> None:
    with pytest.raises(DatasetError, match="/left-arm-state"):
        format_reader("mcap")(file, single, None, locations)


def test_a_topic_that_ends_early_and_a_camera_that_paused_are_reported(
    station: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    path = write_mcap(
        tmp_path / "one.mcap",
        swinging(station, 3.0),
        station,
        leave_out=lambda topic, time: (
            (topic == "/left-arm-action" and time > 1.5) or (topic == "/top-camera" and 1 < time < 2)
        ),
    )
    request = ImportRequest([path], station, out=tmp_path / "real")
    report = import_recordings(request, locations, lambda done, total: None)
    (problems,) = report.problems.values()
    early, paused = (next(line for line in problems if word in line) for word in ("-action ends", "has no image"))
    assert "/left-arm-action ends 1.5 s before the arm's state" in early
    assert "top_camera has no image for 1.00 s from 1.00 s on" in paused
