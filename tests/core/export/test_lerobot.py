"""LeRobotDataset v3.0: its files read back one by one, and the whole by lerobot's own loader where there is one."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.core.export.conftest import CAMERAS, EPISODES
from tests.core.export.lerobot_files import rows, run_reader
from yamsim_cli.core.dataset.lowdim import load_frame
from yamsim_cli.core.errors import DatasetError, InterruptedJobError
from yamsim_cli.core.export import lerobot_schema
from yamsim_cli.core.export.lerobot import export_lerobot
from yamsim_cli.core.export.lerobot_stats import PixelCounts, RunningStats, column_stats
from yamsim_cli.core.export.source import open_source
from yamsim_cli.core.images.jpeg import decode_jpeg
from yamsim_cli.core.resources import Locations

av = pytest.importorskip("av", reason="yamsim[lerobot] is not installed")
parquet = pytest.importorskip("pyarrow.parquet", reason="yamsim[lerobot] is not installed")

FRAMES = 57
# H.264 of smooth pictures against the JPEGs it was made of, mean of an image's pixels, of 255.
CLOSE = 5.0


@pytest.fixture(scope="module")
def export(dataset: Path, locations: Locations, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("lerobot") / "out"
    done = export_lerobot(open_source(dataset, None, locations), out, lambda *_: None)
    assert (done.episodes, done.frames) == (EPISODES, EPISODES * FRAMES)
    return out


@pytest.fixture(scope="module")
def split(dataset: Path, locations: Locations, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same, with a new file for every episode or two."""
    out = tmp_path_factory.mktemp("lerobot") / "split"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lerobot_schema, "VIDEO_FILE_MB", 0.01)
        patch.setattr(lerobot_schema, "DATA_FILE_MB", 0.001)
        patch.setattr(lerobot_schema, "CHUNK_FILES", 2)
        export_lerobot(open_source(dataset, None, locations), out, lambda *_: None)
    return out


def recorded(dataset: Path) -> list[dict[str, Any]]:
    files = [file for k in range(EPISODES) for file in sorted((dataset / f"ep_{k:06d}" / "lowdim").iterdir())]
    return [load_frame(file.read_bytes()) for file in files]


def jpegs(dataset: Path, camera: str) -> np.ndarray:
    files = [file for k in range(EPISODES) for file in sorted((dataset / f"ep_{k:06d}" / "rgb" / camera).iterdir())]
    return np.array([decode_jpeg(file.read_bytes()) for file in files])


def check_numbers(found: dict[str, Any], frames: list[dict[str, Any]]) -> None:
    def same(key: str, wanted: list[Any]) -> None:
        np.testing.assert_array_equal(np.asarray(found[key], np.float32), np.asarray(wanted, np.float32), err_msg=key)

    same("observation.state", [frame["joints"] for frame in frames])
    same("action", [[*frame["ctrl"], float(frame["magnet"])] for frame in frames])
    for camera in CAMERAS:
        same(f"observation.intrinsics.{camera}", [frame["intrinsics"][camera] for frame in frames])
        same(f"observation.extrinsics.{camera}", [frame["extrinsics"][camera] for frame in frames])
    same("timestamp", [frame["timestamp"] for frame in frames])
    same("frame_index", list(range(FRAMES)) * EPISODES)
    same("episode_index", np.repeat(range(EPISODES), FRAMES).tolist())
    same("index", list(range(FRAMES * EPISODES)))
    same("task_index", [0] * FRAMES * EPISODES)


@pytest.mark.parametrize("which", ["export", "split"])
def test_numbers_are_the_recorded_ones(which: str, dataset: Path, request: pytest.FixtureRequest) -> None:
    root: Path = request.getfixturevalue(which)
    check_numbers(rows(root, "data/*/*.parquet"), recorded(dataset))


@pytest.mark.parametrize("which", ["export", "split"])
def test_episodes_say_where_their_frames_and_images_are(
    which: str, dataset: Path, request: pytest.FixtureRequest
) -> None:
    """As a loader looks them up: by file, and by time in it."""
    root: Path = request.getfixturevalue(which)
    info = json.loads((root / "meta" / "info.json").read_text())
    episodes = rows(root, "meta/episodes/*/*.parquet")
    for camera in CAMERAS:
        pictures, key = jpegs(dataset, camera), f"observation.images.{camera}"
        for k in range(EPISODES):
            first, last = episodes["dataset_from_index"][k], episodes["dataset_to_index"][k]
            place = {name: episodes[f"data/{name}"][k] for name in ("chunk_index", "file_index")}
            table = parquet.read_table(root / info["data_path"].format(**place)).to_pydict()
            assert table["index"][table["episode_index"].index(k)] == first
            assert last - first == episodes["length"][k] == table["episode_index"].count(k)
            place = {name: episodes[f"videos/{key}/{name}"][k] for name in ("chunk_index", "file_index")}
            start, end = (episodes[f"videos/{key}/{name}_timestamp"][k] for name in ("from", "to"))
            with av.open(str(root / info["video_path"].format(video_key=key, **place))) as container:
                images = [image for image in container.decode(video=0) if start - 1e-6 < image.time < end - 1e-6]
            np.testing.assert_allclose([image.time - start for image in images], np.arange(FRAMES) * 0.064, atol=1e-9)
            shown = np.array([image.to_ndarray(format="rgb24") for image in images], float)
            assert np.abs(shown - pictures[first:last]).mean(axis=(1, 2, 3)).max() < CLOSE
    if which == "split":
        assert episodes["data/chunk_index"] == [0, 0, 1], "no new files were begun"
        assert episodes["data/file_index"] == [0, 1, 0]


def test_the_whole_is_described(export: Path, dataset: Path) -> None:
    info = json.loads((export / "meta" / "info.json").read_text())
    counts = [info[f"total_{name}"] for name in ("episodes", "frames", "tasks")]
    assert (info["codebase_version"], info["fps"], counts) == ("v3.0", 15.625, [3, 171, 1])
    assert info["splits"] == {"train": "0:3"}
    assert {key: feature["shape"] for key, feature in info["features"].items()} == {
        **{f"observation.images.{camera}": [16, 24, 3] for camera in CAMERAS},
        **{f"observation.intrinsics.{camera}": [3, 3] for camera in CAMERAS},
        **{f"observation.extrinsics.{camera}": [4, 4] for camera in CAMERAS},
        "observation.state": [7],
        "action": [8],
        **{key: [1] for key in ("timestamp", "frame_index", "episode_index", "index", "task_index")},
    }
    task = "pick up the banana and put it on the plate"
    table = parquet.read_table(export / "meta" / "tasks.parquet")
    assert table.to_pydict() == {"task_index": [0], "task": [task]}
    assert json.loads(table.schema.metadata[b"pandas"])["index_columns"] == ["task"]
    assert rows(export, "meta/episodes/*/*.parquet")["tasks"] == [[task]] * EPISODES
    provenance = json.loads((export / "meta" / "yamsim.json").read_text())
    assert provenance["episodes"][2] == {"episode_index": 2, "episode": "ep_000002", "seed": 0, "attempt": 2}
    assert {path.name for path in export.iterdir()} == {"data", "meta", "videos"}


def test_statistics_are_those_of_the_data(export: Path, dataset: Path) -> None:
    stats = json.loads((export / "meta" / "stats.json").read_text())
    info = json.loads((export / "meta" / "info.json").read_text())
    assert set(stats) == set(info["features"])
    joints = np.array([frame["joints"] for frame in recorded(dataset)], np.float64)
    for name in ("min", "max", "mean", "std"):
        np.testing.assert_allclose(stats["observation.state"][name], getattr(joints, name)(0), atol=1e-9)
    assert stats["observation.state"]["count"] == [EPISODES * FRAMES]
    pixels = jpegs(dataset, "scene_camera")[:, ::4, ::4].reshape(-1, 3) / 255
    shown = stats["observation.images.scene_camera"]
    for name in ("min", "max", "mean", "std"):
        np.testing.assert_allclose(np.ravel(shown[name]), getattr(pixels, name)(0), atol=1e-9)
    assert np.shape(shown["q99"]) == (3, 1, 1)
    row = rows(export, "meta/episodes/*/*.parquet")
    np.testing.assert_allclose(row["stats/observation.state/mean"][1], joints[FRAMES : 2 * FRAMES].mean(0))
    assert row["stats/action/count"] == [[FRAMES]] * EPISODES


def test_counted_pixels_give_exact_quantiles() -> None:
    image = np.random.default_rng(1).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    counts = PixelCounts()
    counts.add(image)
    found = counts.stats()
    pixels = image[::4, ::4].reshape(-1, 3)
    for name, part in (("q01", 0.01), ("q50", 0.5), ("q99", 0.99)):
        wanted = np.quantile(pixels, part, axis=0, method="inverted_cdf") / 255
        np.testing.assert_allclose(found[name].ravel(), wanted)
    assert found["count"] == 1


def test_running_statistics_are_those_of_all_at_once() -> None:
    values = np.random.default_rng(2).normal(3, 2, (100, 4))
    running = RunningStats()
    for part in np.split(values, [7, 30, 31]):
        running.add({"x": column_stats(part)})
    whole, found = column_stats(values), running.stats()["x"]
    for name in ("min", "max", "mean", "std", "count"):
        np.testing.assert_allclose(found[name], whole[name])


def test_the_same_dataset_gives_the_same_bytes(
    export: Path, dataset: Path, locations: Locations, tmp_path: Path
) -> None:
    export_lerobot(open_source(dataset, None, locations), tmp_path / "again", lambda *_: None)
    files = [file for file in export.rglob("*") if file.is_file()]
    assert len(files) == 8
    for file in files:
        assert (tmp_path / "again" / file.relative_to(export)).read_bytes() == file.read_bytes(), file.name


def test_what_breaks_off_leaves_nothing(dataset: Path, locations: Locations, tmp_path: Path) -> None:
    copy = shutil.copytree(dataset, tmp_path / "copy")
    (copy / "ep_000001" / "rgb" / "scene_camera" / "000030.jpg").write_bytes(b"\xff\xd8\xff\xd9")
    with pytest.raises(DatasetError, match=r"000030\.jpg is not what was recorded"):
        export_lerobot(open_source(copy, None, locations), tmp_path / "out", lambda *_: None)

    def interrupt(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(InterruptedJobError, match="nothing was written"):
        export_lerobot(open_source(dataset, None, locations), tmp_path / "out", interrupt)
    assert [path.name for path in tmp_path.iterdir()] == ["copy"]


@pytest.mark.slow
@pytest.mark.parametrize("which", ["export", "split"])
def test_lerobots_own_loader_reads_every_frame(
    which: str, dataset: Path, lerobot_python: str, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    found = run_reader(lerobot_python, request.getfixturevalue(which), tmp_path)
    check_numbers(found, recorded(dataset))
    assert (float(found["fps"]), set(found["task"])) == (15.625, {"pick up the banana and put it on the plate"})
    for camera in CAMERAS:
        shown, wanted = found[f"observation.images.{camera}"].transpose(0, 2, 3, 1) * 255, jpegs(dataset, camera)
        # Its decoder, of an older FFmpeg, ignores the colour space: so each is held against its neighbours too.
        apart = [np.abs(shown - np.roll(wanted, by, axis=0)).mean(axis=(1, 2, 3)) for by in (0, 1, -1)]
        assert apart[0].max() < 12
        assert (apart[0] < np.minimum(apart[1], apart[2])).all()


@pytest.mark.slow
def test_lerobot_doctor_finds_no_failure(export: Path, lerobot_python: str) -> None:
    doctor = Path(lerobot_python).with_name("lerobot-doctor")
    if not doctor.exists():
        pytest.skip("lerobot-doctor is not installed beside lerobot")
    done = subprocess.run([str(doctor), "check", str(export)], capture_output=True, text=True, check=False)
    assert "[FAIL]" not in done.stdout, done.stdout
    for check in ("Metadata & Format Compliance", "Temporal Consistency", "Video Integrity", "Feature Consistency"):
        assert f"[PASS] {check}" in done.stdout, done.stdout
