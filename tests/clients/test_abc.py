"""ABC's converter and the dataset of its trainer on `export abc`, and `import` of the converter's output.

`YAMSIM_ABC` names a checkout of amazon-far/abc. Its converter also needs ffmpeg and ffprobe, and its dataset the
libraries of ffmpeg.
"""

from __future__ import annotations

import ctypes.util
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.clients.environments import Interpreter, checkout
from tests.export.real_datasets import bring_in
from tests.export.station_datasets import CAMERAS, CODEC_ERROR, image_error, images_of, motion_at, station_dataset
from tests.real.recordings.foreign import PROMPT, shares
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.dataset.reader import open_recorded_episode
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.images.resize import resize_image
from yamsim_cli.export.abc import AbcLayout, export_abc
from yamsim_cli.export.export_source import open_real_source
from yamsim_cli.real.recordings.motion_reading import read_motions

FRAMES = 65
ROLES = ("top", "left", "right")
CHUNK = 30  # rows of an action in ABC's loader
PATIENCE_S = 600  # the machine may be busy


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, station: RigConfig, locations: Locations) -> Path:
    return station_dataset(tmp_path_factory.mktemp("abc"), [motion_at(station, FRAMES)], station, locations)


@pytest.fixture
def export(recorded: Path, locations: Locations, tmp_path: Path) -> Callable[[AbcLayout], Path]:
    def run(layout: AbcLayout) -> Path:
        source = open_real_source(recorded, None, locations)
        return export_abc(source, tmp_path / layout, lambda *_: None, layout=layout).path

    return run


def both_arms(station: RigConfig) -> np.ndarray:
    """States and actions (n, 28)."""
    measured, commanded = shares(motion_at(station, FRAMES), station)
    return np.hstack([*measured, *commanded])


def squares(recorded: Path, camera: str) -> np.ndarray:
    return np.stack([resize_image(image, (224, 224), pad=True) for image in images_of(recorded, 0, camera)])


@pytest.mark.client
def test_its_converter_gives_the_recorded_rows_which_come_in_again(
    client: Callable[[str], Interpreter],
    export: Callable[[AbcLayout], Path],
    recorded: Path,
    station: RigConfig,
    locations: Locations,
    tmp_path: Path,
) -> None:
    """Its rows begin one tick after the first message, so that it leaves out the first frame."""
    if not shutil.which("ffprobe"):
        pytest.skip("ffmpeg and ffprobe, which its converter calls, are not here")
    converter = client("abc-export")
    release, converted = export("release"), tmp_path / "converted"
    script = checkout("YAMSIM_ABC") / "export_mcap.py"
    done = converter.call([str(script), str(release), str(converted), "1"], timeout_s=PATIENCE_S)
    assert done.returncode == 0, done.stderr
    assert "exported 1/1" in done.stdout
    (folder,) = converted.iterdir()
    assert folder.name == next(release.glob("*/*")).name
    rows = np.fromfile(folder / "states_actions.bin").reshape(-1, 28)
    np.testing.assert_allclose(rows, both_arms(station)[1:], atol=1e-6)
    theirs = json.loads((folder / "episode_metadata.json").read_text())
    (own,) = export("training").iterdir()
    ours = json.loads((own / "episode_metadata.json").read_text())
    # Its first row is our second one, a tick later.
    later = {"num_steps": FRAMES - 1, "t0_ns": theirs["tick_ns"]}
    assert theirs == {key: value for key, value in ours.items() if key != "yamsim"} | later
    assert own.name == folder.name

    again = bring_in(tmp_path / "again", [converted], station, locations)
    (found,), (wanted,) = (read_motions([path], station, locations) for path in (again, recorded))
    np.testing.assert_allclose(found.times, wanted.times[1:] - wanted.times[1], atol=1e-6)
    for arm, other in zip(found.arms, wanted.arms, strict=True):
        for key in ("joints", "commands", "openings", "commanded_openings"):
            np.testing.assert_allclose(getattr(arm, key), getattr(other, key)[1:], atol=1e-6)
    for camera in CAMERAS:
        # Three encodings, and its own scaling.
        assert image_error(images_of(again, 0, camera), squares(recorded, camera)[1:]) < 2 * CODEC_ERROR
    assert open_recorded_episode(again / "ep_000000").frames()[0]["language_prompt"] == PROMPT


@pytest.mark.client_heavy
def test_its_trainers_dataset_reads_the_training_layout(
    client: Callable[[str], Interpreter],
    export: Callable[[AbcLayout], Path],
    recorded: Path,
    station: RigConfig,
    tmp_path: Path,
) -> None:
    if not ctypes.util.find_library("avcodec"):
        pytest.skip("the libraries of ffmpeg, with which its dataset decodes videos, are not here")
    data = export("training")
    told = client("abc-loader").run(
        "abc_loads.py", checkout("YAMSIM_ABC"), data, tmp_path / "read.npz", timeout_s=PATIENCE_S
    )
    usable = FRAMES - CHUNK + 1
    assert told == {"episodes": [[next(data.iterdir()).name, FRAMES, usable]], "prompts": [PROMPT]}
    found, rows = np.load(tmp_path / "read.npz"), both_arms(station)
    np.testing.assert_allclose(found["state"], rows[:usable, :14], atol=1e-5)
    wanted = np.stack([rows[k : k + CHUNK, 14:] for k in range(usable)])
    np.testing.assert_allclose(found["actions"], wanted, atol=1e-5)
    for camera, role in zip(CAMERAS, ROLES, strict=True):
        images = found[role].transpose(0, 2, 3, 1)
        assert image_error(images, squares(recorded, camera)[:usable]) < CODEC_ERROR
