"""`yamsim import` of files that other programs' libraries wrote, and `yamsim export` of the result.

`YAMSIM_RAIDEN` names a checkout of TRI-ML's repository.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from tests.clients.environments import Interpreter, checkout
from tests.export.real_datasets import bring_in, with_film
from tests.real.recordings.foreign import NAMES, PROMPT, START_NS, grey_of, shares
from tests.real.recordings.making import swinging
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.dataset.reader import RecordedEpisode, open_recorded_episode, read_side_by_side_images
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.recorded_motion import RecordedMotion
from yamsim_cli.export.export_source import open_real_source
from yamsim_cli.export.lerobot import export_lerobot
from yamsim_cli.export.raiden import export_real_raiden
from yamsim_cli.export.raiden_schema import RaidenOptions
from yamsim_cli.real.recordings.csv_file import csv_columns
from yamsim_cli.real.recordings.motion_reading import read_motions

# s; the machine may be busy
PATIENCE = 900
EVERY = 4


@pytest.fixture(scope="module")
def station(locations: Locations) -> RigConfig:
    return load_config(RigConfig, "rigs", "yam_station_linear_4310_d405", locations)


def same(
    dataset: Path, number: int, truth: RecordedMotion, rig: RigConfig, locations: Locations, atol: float = 1e-6
) -> None:
    """Assert that an imported episode has the joints, openings and commands of a motion."""
    (found,) = read_motions([dataset / f"ep_{number:06d}"], rig, locations)
    for arm, other in zip(found.arms, truth.arms, strict=True):
        for key in ("joints", "commands", "openings", "commanded_openings"):
            np.testing.assert_allclose(getattr(arm, key), getattr(other, key), atol=atol, err_msg=key)


def greys(episode: RecordedEpisode, camera: str) -> list[float]:
    return [float(image.mean()) for image in read_side_by_side_images(episode, (camera,))]


def save_motions(path: Path, motions: Sequence[RecordedMotion], rig: RigConfig) -> Path:
    """What `lerobot_writes.py` takes."""
    arrays = {"names": np.array(NAMES), "fps": np.array(100), "episodes": np.array(len(motions))}
    for number, motion in enumerate(motions):
        measured, told = shares(motion, rig)
        arrays |= {f"state{number}": np.hstack(measured), f"action{number}": np.hstack(told)}
        arrays[f"grey{number}"] = np.array([grey_of(k + 7 * number) for k in range(len(motion.times))])
    np.savez(path, **arrays)
    return path


@pytest.mark.client_heavy
@pytest.mark.parametrize("kind", ["films", "pictures"])
def test_lerobots_own_datasets_come_in_and_go_out_again(
    kind: str, client: Callable[[str], Interpreter], station: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    lerobot = client("lerobot-writes")
    motions = [swinging(station, 0.6), swinging(station, 0.9, lag=5)]
    given = save_motions(tmp_path / "motions.npz", motions, station)
    told = lerobot.run("lerobot_writes.py", given, tmp_path / "written", kind, timeout_s=PATIENCE)
    assert told == {"episodes": 2, "frames": 150}
    dataset = bring_in(tmp_path / "real", [tmp_path / "written"], station, locations)
    for number, motion in enumerate(motions):
        same(dataset, number, motion, station, locations)
        episode = open_recorded_episode(dataset / f"ep_{number:06d}")
        assert episode.frames()[0]["language_prompt"] == f"task {number}"
        wanted = [grey_of(k + 7 * number) for k in range(len(motion.times))]
        np.testing.assert_allclose(greys(episode, "top"), wanted, atol=4)

    export_lerobot(open_real_source(dataset, None, locations), tmp_path / "out", lambda done, total: None)
    read = lerobot.run("read_lerobot.py", tmp_path / "out", tmp_path / "read.npz", timeout_s=PATIENCE)
    assert (read["fps"], read["tasks"]) == (100, ["task 0", "task 1"])
    assert read["policy"] == {"observation.images.top": "VISUAL", "observation.state": "STATE", "action": "ACTION"}
    found = np.load(tmp_path / "read.npz")
    given_states = np.concatenate([np.load(given)[f"state{number}"] for number in range(2)])
    np.testing.assert_allclose(found["observation.state"], given_states, atol=1e-6)
    seen = 255 * found["observation.images.top"].mean(axis=(1, 2, 3))
    np.testing.assert_allclose(seen, np.concatenate([np.load(given)[f"grey{number}"] for number in range(2)]), atol=5)


@pytest.mark.client_heavy
def test_raidens_own_recordings_come_in(
    client: Callable[[str], Interpreter], station: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    motion = swinging(station, 1.0)
    measured, told = shares(motion, station)
    arrays = dict(zip(("l", "r"), measured, strict=True)) | dict(zip(("l_told", "r_told"), told, strict=True))
    np.savez(tmp_path / "motion.npz", **arrays)
    interpreter = client("raiden-records")
    done = interpreter.run(
        "raiden_records.py", checkout("YAMSIM_RAIDEN"), tmp_path / "motion.npz", tmp_path / "raw", timeout_s=PATIENCE
    )
    assert done["asked"] == 100
    dataset = bring_in(tmp_path / "real", [tmp_path / "raw"], station, locations)
    (found,) = read_motions([dataset], station, locations)
    assert len(found.times) == done["frames"]
    # It records until it is stopped: the motion's last sample may be repeated.
    kept = np.minimum(np.arange(done["frames"]), 99)
    for arm, other in zip(found.arms, motion.arms, strict=True):
        np.testing.assert_allclose(arm.joints, other.joints[kept], atol=1e-6)
        for mine, wanted in ((arm.commands, other.commands), (arm.openings, other.openings)):
            assert mine is not None
            assert wanted is not None
            np.testing.assert_allclose(mine, wanted[kept], atol=1e-6)
    assert open_recorded_episode(dataset / "ep_000000").frames()[0]["language_prompt"] == PROMPT


@pytest.mark.client_heavy
def test_raiden_shards_an_export_of_real_arms(
    client: Callable[[str], Interpreter], station: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    """Its windows omit the last 12 frames, which lack future frames, and have two pictures each."""
    interpreter = client("raiden-records")
    motion = swinging(station, 2.0)
    dataset = with_film(tmp_path, motion, station, locations)
    source = open_real_source(dataset, None, locations, 30.0)
    export_real_raiden(source, tmp_path / "out", locations, lambda done, total: None, RaidenOptions())
    (tmp_path / "raiden").mkdir()
    given = (checkout("YAMSIM_RAIDEN"), tmp_path / "out", tmp_path / "raiden", "top")
    told = interpreter.run("raiden_shards.py", *given, timeout_s=PATIENCE)
    assert (told["pictures"], told["said"], told["controls"]) == (2 * 48, [PROMPT], ["unknown"])
    measured, commanded = shares(motion, station)
    for side, rows, commands in zip(("left", "right"), measured, commanded, strict=True):
        for what, wanted in (("actual", rows), ("desired", commands)):
            found = told["rows"][f"robot__{what}__joint_position__{side}"]
            assert len(found) == 48
            for frame, row in found.items():
                np.testing.assert_allclose(row, wanted[round(100 * int(frame) / 30)], atol=1e-6, err_msg=what)


@pytest.mark.client
@pytest.mark.parametrize("encoder", ["libx264", "libx265"])
def test_mcap_by_foxgloves_libraries_comes_in(
    encoder: str, client: Callable[[str], Interpreter], station: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    motion = swinging(station, 1.0)
    measured, told = shares(motion, station)
    wanted = [grey_of(k) for k in range(25)]
    np.savez(
        tmp_path / "motion.npz",
        left=measured[0],
        right=measured[1],
        left_told=told[0],
        right_told=told[1],
        times=START_NS + np.round(motion.times * 1e9).astype(np.int64),
        grey=np.array(wanted),
    )
    done = client("mcap").run("mcap_writes.py", tmp_path / "motion.npz", tmp_path / "one.mcap", encoder)
    assert done == {"pictures": 25}
    dataset = bring_in(tmp_path / "real", [tmp_path / "one.mcap"], station, locations)
    episode = open_recorded_episode(dataset / "ep_000000")
    frames = episode.frames()
    np.testing.assert_allclose([frame["timestamp"] for frame in frames], motion.times[::EVERY], atol=1e-6)
    for k, arm in enumerate(motion.arms):
        mine = np.array([frame["joints"] for frame in frames])[:, 7 * k : 7 * k + 7]
        assert arm.openings is not None
        np.testing.assert_allclose(mine, np.column_stack([arm.joints, arm.openings])[::EVERY], atol=1e-6)
    np.testing.assert_allclose(greys(episode, "top_camera"), wanted, atol=4)
    assert frames[0]["language_prompt"] == PROMPT


def test_numpys_own_tables_come_in(locations: Locations, tmp_path: Path) -> None:
    """Tables by `numpy.savetxt`, and by `csv` with quotes and the line ends of Windows."""
    rig = load_config(RigConfig, "rigs", "single", locations)
    motion = swinging(rig, 0.5)
    (arm,) = motion.arms
    assert arm.commands is not None
    columns = [motion.times, *arm.commands.T, arm.commanded_openings, *arm.joints.T, arm.openings]
    rows = np.column_stack(columns)  # type: ignore[arg-type]
    np.savetxt(tmp_path / "numpy.csv", rows, delimiter=",", header=",".join(csv_columns(rig)), comments="")
    with (tmp_path / "quoted.csv").open("w", newline="", encoding="utf-8-sig") as file:
        writer = csv.writer(file, quoting=csv.QUOTE_ALL)
        writer.writerow(csv_columns(rig))
        writer.writerows(rows.tolist())
    dataset = bring_in(tmp_path / "real", [tmp_path / "numpy.csv", tmp_path / "quoted.csv"], rig, locations)
    for number in range(2):
        same(dataset, number, motion, rig, locations)
