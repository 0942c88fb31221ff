"""Exports of real recordings hold the recorded data, and nothing else."""

from __future__ import annotations

import json
import pickle
from dataclasses import dataclass
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from tests.export.conftest import ignore
from tests.export.lerobot_files import rows
from tests.export.real_datasets import of_tables, with_film, without_commands
from tests.real.recordings.foreign import PROMPT, grey_of, shares
from tests.real.recordings.making import same_motion, some, swinging
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.errors import DatasetError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.recorded_motion import RecordedMotion
from yamsim_cli.export.export_source import ActionSource, nearest_to_even, open_real_source, open_source
from yamsim_cli.export.lerobot import export_lerobot
from yamsim_cli.export.output_directory import ExportResult
from yamsim_cli.export.raiden import export_real_raiden
from yamsim_cli.export.raiden_schema import RaidenOptions
from yamsim_cli.export.videos import export_mp4, export_sheet
from yamsim_cli.real.recordings.motion_reading import read_motions

DRIVES = [f"{side}_{name}" for side in ("left", "right") for name in (*[f"joint{k}" for k in range(1, 7)], "gripper")]


@dataclass(frozen=True)
class Real:
    """A dataset of one recording, and the recorded motion."""

    dataset: Path
    motion: RecordedMotion
    rig: RigConfig


@pytest.fixture(scope="module")
def filmed(tmp_path_factory: pytest.TempPathFactory, station: RigConfig, locations: Locations) -> Real:
    """0.5 s of two arms at 100 Hz, with a video."""
    motion = swinging(station, 0.5)
    return Real(with_film(tmp_path_factory.mktemp("filmed"), motion, station, locations), motion, station)


DEFAULT = RaidenOptions()


def to_lerobot(
    dataset: Path, out: Path, locations: Locations, actions: ActionSource = "recorded", fps: float | None = None
) -> ExportResult:
    return export_lerobot(open_real_source(dataset, None, locations, fps), out, ignore, actions=actions)


def test_lerobot_has_what_was_recorded_and_nothing_else(filmed: Real, locations: Locations, tmp_path: Path) -> None:
    done = to_lerobot(filmed.dataset, tmp_path / "out", locations)
    assert (done.episodes, done.frames, done.notes) == (1, 50, ())
    info = json.loads((tmp_path / "out/meta/info.json").read_text())
    assert info["fps"] == 100
    assert set(info["features"]) == {
        *("observation.state", "action", "recorded_time", "observation.images.top"),
        *("timestamp", "frame_index", "episode_index", "index", "task_index"),
    }
    assert info["features"]["observation.state"]["names"] == info["features"]["action"]["names"] == DRIVES
    found = rows(tmp_path / "out", "data/*/*.parquet")
    measured, commanded = shares(filmed.motion, filmed.rig)
    np.testing.assert_allclose(found["observation.state"], np.hstack(measured), atol=1e-6)
    np.testing.assert_allclose(found["action"], np.hstack(commanded), atol=1e-6)
    np.testing.assert_allclose(found["recorded_time"], filmed.motion.times, atol=1e-9)
    assert rows(tmp_path / "out", "meta/tasks.parquet")["task"] == [PROMPT]
    about = json.loads((tmp_path / "out/meta/yamsim.json").read_text())
    assert (about["source"], about["actions"], about["gripper"]) == ("real", "recorded", "share")
    assert about["episodes"][0]["imported"]["format"] == "lerobot"
    (film,) = tmp_path.glob("out/videos/*/*/*.mp4")
    with av.open(str(film)) as container:
        greys = [frame.to_ndarray(format="rgb24").mean() for frame in container.decode(video=0)]
    np.testing.assert_allclose(greys, [grey_of(k) for k in range(50)], atol=3)


def test_an_export_to_lerobot_comes_back(filmed: Real, locations: Locations, tmp_path: Path) -> None:
    to_lerobot(filmed.dataset, tmp_path / "out", locations)
    (back,) = read_motions([tmp_path / "out"], filmed.rig, locations)
    same_motion(back, filmed.motion)


def test_commands_that_were_not_recorded_are_not_invented(
    single: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    motion = without_commands(swinging(single, 0.5))
    dataset = of_tables(tmp_path, [motion], single, locations)
    with pytest.raises(DatasetError, match=r"has no commands.*--actions measured"):
        to_lerobot(dataset, tmp_path / "refused", locations)
    assert not (tmp_path / "refused").exists()
    to_lerobot(dataset, tmp_path / "later", locations, "measured")
    found = rows(tmp_path / "later", "data/*/*.parquet")
    states, actions = np.array(found["observation.state"]), np.array(found["action"])
    np.testing.assert_array_equal(actions[:-1], states[1:])
    np.testing.assert_array_equal(actions[-1], states[-1])
    to_lerobot(dataset, tmp_path / "none", locations, "none")
    assert "action" not in rows(tmp_path / "none", "data/*/*.parquet")
    assert "action" not in json.loads((tmp_path / "none/meta/info.json").read_text())["features"]


def test_uneven_times_are_reported_or_made_even(single: RigConfig, locations: Locations, tmp_path: Path) -> None:
    whole = swinging(single, 1.0)
    kept = np.r_[0:40, 70:100]
    dataset = of_tables(tmp_path, [some(whole, kept)], single, locations)
    done = to_lerobot(dataset, tmp_path / "own", locations)
    (note,) = done.notes
    assert "10.0 to 310.0 ms apart" in note
    assert "0.69 s instead of 0.99" in note
    found = rows(tmp_path / "own", "data/*/*.parquet")
    np.testing.assert_allclose(found["timestamp"], np.arange(70) / 100, atol=1e-6)
    np.testing.assert_allclose(found["recorded_time"], kept / 100, atol=1e-9)
    even = to_lerobot(dataset, tmp_path / "even", locations, fps=50.0)
    assert (even.frames, even.notes) == (50, ())
    found = rows(tmp_path / "even", "data/*/*.parquet")
    np.testing.assert_allclose(found["timestamp"], np.arange(50) / 50, atol=1e-6)
    # In the gap, the frame before it stays, and then the one after it, whichever is nearer.
    assert max(np.abs(np.array(found["recorded_time"]) - found["timestamp"])) == pytest.approx(0.15, abs=0.011)
    outside = (np.array(found["timestamp"]) < 0.39) | (np.array(found["timestamp"]) > 0.7)
    np.testing.assert_allclose(
        np.array(found["recorded_time"])[outside], np.array(found["timestamp"])[outside], atol=1e-6
    )


def test_episodes_at_other_rates_are_exported_apart(single: RigConfig, locations: Locations, tmp_path: Path) -> None:
    whole = swinging(single, 0.6)
    motions = [whole, whole, some(whole, np.arange(0, 60, 3))]
    dataset = of_tables(tmp_path, motions, single, locations)
    with pytest.raises(DatasetError, match=r"ep_000002 has a frame every 30\.0 ms.*usually every 10\.0"):
        to_lerobot(dataset, tmp_path / "refused", locations)
    done = to_lerobot(dataset, tmp_path / "even", locations, fps=50.0)
    assert done.frames == 30 + 30 + 29


def test_nearest_frames() -> None:
    assert nearest_to_even(np.array([0.0, 0.1, 0.2, 0.3]), 0.1) == (0, 1, 2, 3)
    assert nearest_to_even(np.array([5.0, 5.09, 5.22, 5.3]), 0.1) == (0, 1, 2, 3)
    assert nearest_to_even(np.array([0.0, 0.1, 0.6]), 0.1) == (0, 1, 1, 1, 2, 2, 2)
    assert nearest_to_even(np.array([0.0, 0.1, 0.2, 0.3, 0.4]), 0.2) == (0, 2, 4)
    assert nearest_to_even(np.array([0.0]), 0.2) == (0,)


def test_films_and_sheets(filmed: Real, single: RigConfig, locations: Locations, tmp_path: Path) -> None:
    source = open_real_source(filmed.dataset, None, locations)
    done = export_mp4(source, tmp_path / "films", (), ignore)
    assert (done.frames, done.notes) == (50, ())
    with av.open(str(tmp_path / "films/ep_000000.mp4")) as container:
        times = [frame.time for frame in container.decode(video=0)]
    np.testing.assert_allclose(times, filmed.motion.times, atol=1e-6)
    export_sheet(source, tmp_path / "sheet.jpg", (), ignore, columns=3, width=32)
    blind = of_tables(tmp_path, [swinging(single, 0.3)], single, locations)
    for export in (
        lambda it: export_mp4(it, tmp_path / "no", (), ignore),
        lambda it: export_sheet(it, tmp_path / "no.jpg", (), ignore),
    ):
        with pytest.raises(DatasetError, match="has no pictures"):
            export(open_real_source(blind, None, locations))


def test_a_slower_rate_leaves_out_pictures(filmed: Real, locations: Locations, tmp_path: Path) -> None:
    export_mp4(open_real_source(filmed.dataset, None, locations, 25.0), tmp_path / "films", (), ignore)
    with av.open(str(tmp_path / "films/ep_000000.mp4")) as container:
        greys = [frame.to_ndarray(format="rgb24").mean() for frame in container.decode(video=0)]
    np.testing.assert_allclose(greys, [grey_of(k) for k in range(0, 50, 4)], atol=3)


def test_real_and_simulated_are_not_mistaken(filmed: Real, locations: Locations) -> None:
    with pytest.raises(DatasetError, match="imported recording"):
        open_source(filmed.dataset, None, locations)
    with pytest.raises(UsageError, match="no episode 4"):
        open_real_source(filmed.dataset, "4", locations)


def test_rerun_has_the_recorded_times_and_nothing_else(
    filmed: Real, single: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    pytest.importorskip("rerun", reason="yamsim[rerun] is not installed")
    chunks = pytest.importorskip("rerun.chunk", reason="this rerun cannot read its files")
    from yamsim_cli.export.rrd import export_rerun

    motion = some(swinging(single, 0.4), np.r_[0:10, 15:40])
    blind = of_tables(tmp_path, [without_commands(motion)], single, locations)
    export_rerun(open_real_source(filmed.dataset, None, locations), tmp_path / "filmed", ignore)
    export_rerun(open_real_source(blind, None, locations), tmp_path / "blind", ignore)

    def read(file: Path) -> tuple[set[str], dict[str, list[float]]]:
        """Return entities, and the seconds at which each joint was logged."""
        entities, times = set(), {}
        for chunk in chunks.RrdReader(file).stream():
            entities.add(chunk.entity_path)
            batch = chunk.to_record_batch()
            if "time" in batch.schema.names:
                seconds = [value.total_seconds() for value in batch.column("time").to_pylist()]
                times.setdefault(chunk.entity_path, []).extend(seconds)
        return entities, times

    entities, _ = read(tmp_path / "filmed/ep_000000.rrd")
    logged = {f"/{key}/{name}" for key in ("joints", "ctrl") for name in DRIVES}
    # The file's own properties are under /__properties.
    assert {path for path in entities if not path.startswith("/__")} == {
        *logged,
        "/cameras/top/rgb",
        "/base",
        "/episode",
    }
    entities, times = read(tmp_path / "blind/ep_000000.rrd")
    assert not [path for path in entities if path.startswith(("/ctrl", "/cameras"))]
    np.testing.assert_allclose(sorted(times["/joints/joint3"]), motion.times, atol=1e-6)


def to_raiden(
    dataset: Path,
    out: Path,
    locations: Locations,
    options: RaidenOptions = DEFAULT,
    actions: ActionSource = "recorded",
) -> ExportResult:
    source = open_real_source(dataset, None, locations, options.fps)
    return export_real_raiden(source, out, locations, ignore, options, actions)


def test_raidens_layout_has_recorded_frames_at_30_a_second(filmed: Real, locations: Locations, tmp_path: Path) -> None:
    done = to_raiden(filmed.dataset, tmp_path / "out", locations)
    assert (done.episodes, done.frames) == (1, 15)
    frames = [pickle.loads(file.read_bytes()) for file in sorted((tmp_path / "out/0000/lowdim").iterdir())]
    metadata = json.loads((tmp_path / "out/0000/metadata.json").read_text())
    chosen = metadata["pictures"]["recorded_frames"]
    assert chosen == [round(100 * k / 30) for k in range(15)]
    assert (metadata["framerate"], metadata["control"], metadata["cameras"], metadata["num_frames"]) == (
        30,
        "unknown",
        ["top"],
        15,
    )
    measured, commanded = (np.hstack(rows) for rows in shares(filmed.motion, filmed.rig))
    np.testing.assert_allclose([frame["joints"] for frame in frames], measured[chosen], atol=1e-6)
    np.testing.assert_allclose([frame["action_joints"] for frame in frames], commanded[chosen], atol=1e-6)
    assert str(frames[0]["language_prompt"]) == PROMPT
    # The poses of the camera and of the right base are unknown.
    assert frames[0]["extrinsics"] == frames[0]["intrinsics"] == {}
    assert "T_left_from_right" not in frames[0]
    assert not (tmp_path / "out/calibration_results.json").exists()
    # Hands follow from the joints; rotations are rotations.
    rotation = frames[3]["actual_poses"][3:12].reshape(3, 3)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-5)
    greys = [cv2.imread(str(file)).mean() for file in sorted((tmp_path / "out/0000/rgb/top").glob("*.png"))]
    np.testing.assert_allclose(greys, [grey_of(k) for k in chosen], atol=3)


def test_raidens_layout_comes_back(filmed: Real, locations: Locations, tmp_path: Path) -> None:
    to_raiden(filmed.dataset, tmp_path / "out", locations, RaidenOptions(fps=None, images="jpg"))
    original = (filmed.dataset / "ep_000000/rgb/top/000007.jpg").read_bytes()
    assert (tmp_path / "out/0000/rgb/top/0000000007.jpg").read_bytes() == original
    (back,) = read_motions([tmp_path / "out"], filmed.rig, locations)
    same_motion(back, filmed.motion)


def test_recordings_that_raidens_layout_cannot_hold_are_refused(
    filmed: Real, single: RigConfig, locations: Locations, tmp_path: Path
) -> None:
    blind = of_tables(tmp_path, [swinging(single, 0.3)], single, locations)
    with pytest.raises(DatasetError, match=r"has no pictures.*export it as lerobot"):
        to_raiden(blind, tmp_path / "out", locations)
    with pytest.raises(UsageError, match="--actions none"):
        to_raiden(filmed.dataset, tmp_path / "out", locations, actions="none")
    with pytest.raises(UsageError, match="--single"):
        to_raiden(filmed.dataset, tmp_path / "out", locations, RaidenOptions(as_single_arm=True))
    assert not (tmp_path / "out").exists()
