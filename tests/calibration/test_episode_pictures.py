"""Pictures and joints of foreign recordings, as `calibrate` reads them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.real.recordings.foreign import FILM_EVERY, grey_of, write_lerobot_v3, write_mcap
from tests.real.recordings.making import full_opening, in_degrees, swinging
from yamsim_cli.calibration.episode_pictures import EpisodePictures, camera_names, other_rigs, read_episode_pictures
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.recorded_motion import RecordedMotion


def _mcap(folder: Path, motion: RecordedMotion, rig: RigConfig) -> Path:
    pytest.importorskip("mcap", reason="the extra mcap is not installed")
    folder.mkdir()
    return write_mcap(folder / "episode.mcap", motion, rig)


@pytest.mark.parametrize(("write", "every"), [(_mcap, FILM_EVERY), (write_lerobot_v3, None)])
def test_a_recording_gives_its_pictures_and_joints(
    write: Callable[[Path, RecordedMotion, RigConfig], Path],
    every: int | None,
    station: RigConfig,
    locations: Locations,
    tmp_path: Path,
) -> None:
    motion = swinging(station, 0.6)
    episode = read_episode_pictures([write(tmp_path / "recording", motion, station)], station, locations)[0]
    first = station.recording_order[0]
    np.testing.assert_allclose(episode.joints[first], motion.arms[0].joints, atol=1e-6)
    for name in camera_names([episode]):
        pictures = episode.cameras[name]
        assert len(pictures.times) > 2
        image = pictures.read([2])[0]
        if every is not None:
            assert abs(float(image.mean()) - grey_of(2)) < 3
            np.testing.assert_allclose(pictures.times[2], motion.times[2 * every], atol=0.02)


def test_joints_in_degrees_are_refused_with_a_remedy(station: RigConfig, locations: Locations, tmp_path: Path) -> None:
    motion = in_degrees(swinging(station, 0.6), full_opening(station))
    recording = write_lerobot_v3(tmp_path / "recording", motion, station)
    with pytest.raises(DatasetError, match=r"are these degrees\? If so, import it with --degrees"):
        read_episode_pictures([recording], station, locations)


def test_episodes_of_another_rig_are_told() -> None:
    def recorded_with(rig: str | None) -> EpisodePictures:
        return EpisodePictures(f"of {rig}", np.zeros(2), (), (), {}, rig)

    assert other_rigs([recorded_with("single"), recorded_with(None)], "single") is None
    line = other_rigs([recorded_with("single"), recorded_with("bimanual")], "single")
    assert line is not None and line.startswith(
        "1 of 2 episodes, such as of bimanual, were recorded with rig 'bimanual'"
    )
