"""The maker's station program on `export maker`, and `import` of what it records and converts.

`YAMSIM_MAKER` names a checkout of i2rt-robotics/yam-abc-reproduce, without its submodules.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import av
import numpy as np
import pytest

from tests.clients.environments import Interpreter, checkout
from tests.export.real_datasets import bring_in
from tests.export.station_datasets import CAMERAS, CODEC_ERROR, image_error, images_of, motion_at, station_dataset
from tests.real.recordings.foreign import PROMPT, grey_of, shares
from tests.real.recordings.making import same_motion
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.dataset.reader import open_recorded_episode
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.export.export_source import open_real_source
from yamsim_cli.export.maker import export_maker
from yamsim_cli.real.recordings.motion_reading import read_motions

FRAMES = (45, 35)
ROLES = ("top", "left", "right")
TASK = PROMPT.replace(" ", "_")
PATIENCE_S = 600  # the machine may be busy


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, station: RigConfig, locations: Locations) -> Path:
    motions = [motion_at(station, count) for count in FRAMES]
    return station_dataset(tmp_path_factory.mktemp("maker"), motions, station, locations)


@pytest.fixture(scope="module")
def episodes(recorded: Path, locations: Locations, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("maker_out") / "episodes"
    export_maker(open_real_source(recorded, None, locations), out, lambda *_: None)
    return out


def both_arms(station: RigConfig, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Measurements and commands (n, 14)."""
    measured, commanded = shares(motion_at(station, frames), station)
    return np.hstack(measured), np.hstack(commanded)


@pytest.mark.client
def test_its_reader_review_tab_and_converter_to_abc_read_the_export(
    client: Callable[[str], Interpreter],
    recorded: Path,
    episodes: Path,
    station: RigConfig,
    locations: Locations,
    tmp_path: Path,
) -> None:
    program = client("maker")
    # A take that was cut off is no episode to its programs.
    (episodes / TASK / "cut_off").mkdir(exist_ok=True)
    shown = program.run("maker_reads.py", checkout("YAMSIM_MAKER"), episodes, tmp_path, timeout_s=PATIENCE_S)
    (episodes / TASK / "cut_off").rmdir()
    found = np.load(tmp_path / "read.npz")
    for number, frames in enumerate(FRAMES):
        measured, commanded = both_arms(station, frames)
        for k, side in enumerate(("left", "right")):
            for names, rows in (
                ((f"{side}-joint_pos", f"{side}-gripper_pos"), measured),
                ((f"action-{side}-joint", f"action-{side}-gripper"), commanded),
            ):
                read = np.hstack([found[f"ep_{number:06d}/{name}"] for name in names])
                np.testing.assert_allclose(read, rows[:, 7 * k : 7 * k + 7], atol=1e-6)
        for camera, role in zip(CAMERAS, ROLES, strict=True):
            wanted = images_of(recorded, number, camera)
            assert image_error(found[f"ep_{number:06d}/{role}-images-rgb"], wanted) < CODEC_ERROR
    assert [entry["id"] for entry in shown["listed"]] == [f"{TASK}/ep_000001", f"{TASK}/ep_000000"]
    assert {entry["task_name"] for entry in shown["listed"]} == {PROMPT}
    assert [entry["num_frames"] for entry in shown["listed"]] == [*FRAMES[::-1]]
    assert sorted(shown["listed"][0]["cameras"]) == sorted(ROLES)
    signals = shown["signals"]
    assert (signals["num_frames"], signals["control_hz"], signals["arm_names"]) == (FRAMES[0], 30, ["left", "right"])
    np.testing.assert_allclose(signals["arms"]["right"]["joint_pos"], both_arms(station, 45)[0][:, 7:13], atol=1e-6)
    np.testing.assert_allclose(signals["cameras"]["top"]["timestamps"], np.arange(45) / 0.03, atol=1e-4)
    with av.open(str(tmp_path / "film.mp4")) as film:
        assert sum(1 for _ in film.decode(video=0)) == FRAMES[0]

    again = bring_in(tmp_path / "again", sorted((tmp_path / "abc").glob("*.mcap")), station, locations)
    for one, other in zip(
        read_motions([again], station, locations), read_motions([recorded], station, locations), strict=True
    ):
        same_motion(one, other)
    for camera in CAMERAS:
        assert image_error(images_of(again, 1, camera), images_of(recorded, 1, camera)) < 2 * CODEC_ERROR
    assert open_recorded_episode(again / "ep_000001").frames()[0]["language_prompt"] == PROMPT


@pytest.mark.client
def test_its_recorders_episodes_come_in(
    client: Callable[[str], Interpreter], station: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    motion = motion_at(station, 40)
    measured, commanded = shares(motion, station)
    grey = np.array([grey_of(k) for k in range(40)])
    times = 1_760_000_000_123.5 + 1000 * motion.times
    arrays = {"left": measured[0], "right": measured[1], "left_told": commanded[0], "right_told": commanded[1]}
    np.savez(tmp_path / "motion.npz", ms=times, grey=grey, **arrays)
    program = client("maker")
    told = program.run(
        "maker_records.py",
        checkout("YAMSIM_MAKER"),
        tmp_path / "motion.npz",
        tmp_path / "episodes",
        timeout_s=PATIENCE_S,
    )
    assert Path(told["folder"]).parent.name == TASK
    dataset = bring_in(tmp_path / "real", [tmp_path / "episodes"], station, locations)
    (found,) = read_motions([dataset], station, locations)
    same_motion(found, motion)
    assert open_recorded_episode(dataset / "ep_000000").frames()[0]["language_prompt"] == PROMPT
    for role in ROLES:
        np.testing.assert_allclose(images_of(dataset, 0, role).mean(axis=(1, 2, 3)), grey, atol=3)


@pytest.mark.client_heavy
def test_its_converter_to_lerobot_gives_the_recorded_numbers(
    client: Callable[[str], Interpreter], recorded: Path, episodes: Path, station: RigConfig, tmp_path: Path
) -> None:
    program = client("maker-lerobot")
    info = program.run(
        "maker_to_lerobot.py", checkout("YAMSIM_MAKER"), episodes / TASK, tmp_path / "out", timeout_s=PATIENCE_S
    )
    assert (info["fps"], info["total_episodes"], info["total_frames"]) == (30, 2, sum(FRAMES))
    read = program.run("read_lerobot.py", tmp_path / "out", tmp_path / "read.npz", timeout_s=PATIENCE_S)
    assert read["tasks"] == [PROMPT]
    found = np.load(tmp_path / "read.npz")
    rows = [both_arms(station, frames) for frames in FRAMES]
    for name, k in (("observation.state", 0), ("action", 1)):
        np.testing.assert_allclose(found[name], np.concatenate([pair[k] for pair in rows]), atol=1e-6)
    for camera, role in zip(CAMERAS, ROLES, strict=True):
        images = (255 * found[f"observation.images.{role}_rgb"].transpose(0, 2, 3, 1)).round().astype(np.uint8)
        wanted = np.concatenate([images_of(recorded, number, camera) for number in range(2)])
        assert image_error(images, wanted) < 2 * CODEC_ERROR
