"""LeRobotDataset v3.0: its files, one by one. lerobot itself reads and edits them in `tests/clients`."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.export.conftest import CAMERAS, EPISODES, frames_of, ignore
from tests.export.lerobot_files import check_numbers, jpegs, recorded, rows
from yamsim_cli.core.errors import DatasetError, InterruptedJobError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.export import lerobot_schema
from yamsim_cli.export.export_source import open_source
from yamsim_cli.export.lerobot import export_lerobot
from yamsim_cli.export.lerobot_stats import PixelCounts, RunningStats, column_stats

av = pytest.importorskip("av", reason="yamsim[lerobot] is not installed")
parquet = pytest.importorskip("pyarrow.parquet", reason="yamsim[lerobot] is not installed")

# Of 255, mean difference of H.264 from its source JPEGs, for smooth pictures.
CLOSE = 5.0


@pytest.fixture(scope="module")
def export(dataset: Path, locations: Locations, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("lerobot") / "out"
    done = export_lerobot(open_source(dataset, None, locations), out, ignore)
    assert (done.episodes, done.frames) == (EPISODES, sum(frames_of(dataset)))
    return out


@pytest.fixture(scope="module")
def of_numbers(dataset: Path, locations: Locations, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Without pictures, and with object poses."""
    out = tmp_path_factory.mktemp("lerobot") / "numbers"
    export_lerobot(open_source(dataset, None, locations), out, ignore, pictures=False, environment_state=True)
    return out


@pytest.fixture(scope="module")
def split(dataset: Path, locations: Locations, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same, with a new data file for every episode or two."""
    out = tmp_path_factory.mktemp("lerobot") / "split"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lerobot_schema, "DATA_FILE_MB", 0.001)
        patch.setattr(lerobot_schema, "CHUNK_FILES", 2)
        export_lerobot(open_source(dataset, None, locations), out, ignore)
    return out


@pytest.mark.parametrize("which", ["export", "split"])
def test_numbers_are_the_recorded_ones(which: str, dataset: Path, request: pytest.FixtureRequest) -> None:
    root: Path = request.getfixturevalue(which)
    found = rows(root, "data/*/*.parquet")
    check_numbers(found, recorded(dataset), CAMERAS)
    assert {f"camera.{what}.{camera}" for what in ("intrinsics", "extrinsics") for camera in CAMERAS} < set(found)


@pytest.mark.parametrize("which", ["export", "split"])
def test_episodes_say_where_their_frames_and_images_are(
    which: str, dataset: Path, request: pytest.FixtureRequest
) -> None:
    """As a loader finds them: by file, and by time in it."""
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
            in_chunk = info["chunks_size"]
            assert (place["chunk_index"], place["file_index"]) == divmod(k, in_chunk), "an episode has its own videos"
            start, end = (episodes[f"videos/{key}/{name}_timestamp"][k] for name in ("from", "to"))
            with av.open(str(root / info["video_path"].format(video_key=key, **place))) as container:
                images = [image for image in container.decode(video=0) if start - 1e-6 < image.time < end - 1e-6]
            times = np.arange(last - first) * 0.064
            np.testing.assert_allclose([image.time - start for image in images], times, atol=1e-9)
            shown = np.array([image.to_ndarray(format="rgb24") for image in images], float)
            assert np.abs(shown - pictures[first:last]).mean(axis=(1, 2, 3)).max() < CLOSE
    if which == "split":
        assert episodes["data/chunk_index"] == [0, 0, 1], "no new files were begun"
        assert episodes["data/file_index"] == [0, 1, 0]


def test_the_whole_is_described(export: Path, dataset: Path) -> None:
    info = json.loads((export / "meta" / "info.json").read_text())
    counts = [info[f"total_{name}"] for name in ("episodes", "frames", "tasks")]
    assert (info["codebase_version"], info["fps"], counts) == ("v3.0", 15.625, [3, sum(frames_of(dataset)), 1])
    assert info["splits"] == {"train": "0:3"}
    assert {key: feature["shape"] for key, feature in info["features"].items()} == {
        **{f"observation.images.{camera}": [16, 24, 3] for camera in CAMERAS},
        **{f"camera.intrinsics.{camera}": [9] for camera in CAMERAS},
        **{f"camera.extrinsics.{camera}": [16] for camera in CAMERAS},
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
    assert provenance["recorded"]["rig"] == "single" and provenance["recorded"]["quality"]["name"]
    assert provenance["episodes"][2] == {"episode_index": 2, "episode": "ep_000002", "seed": 0, "attempt": 2}
    assert {path.name for path in export.iterdir()} == {"data", "meta", "videos"}


def test_where_things_are_is_a_row_of_poses_in_the_base(of_numbers: Path, dataset: Path) -> None:
    found = rows(of_numbers, "data/*/*.parquet")
    frames = [frame for episode in recorded(dataset) for frame in episode]
    wanted = [
        np.concatenate([frame[key].T[k, :3] for key in ("banana_pose", "plate_pose") for k in (3, 0, 1)])
        for frame in frames
    ]
    np.testing.assert_array_equal(np.array(found["observation.environment_state"], np.float32), wanted)
    check_numbers(found, recorded(dataset), ())
    info = json.loads((of_numbers / "meta" / "info.json").read_text())
    feature = info["features"]["observation.environment_state"]
    assert (feature["dtype"], feature["shape"]) == ("float32", [18])
    assert feature["names"][:4] == ["banana_x", "banana_y", "banana_z", "banana_x_axis_x"]
    assert feature["names"][-1] == "plate_y_axis_z"
    stats = json.loads((of_numbers / "meta" / "stats.json").read_text())["observation.environment_state"]
    np.testing.assert_allclose(stats["mean"], np.mean(wanted, axis=0, dtype=np.float64), atol=1e-9)


def test_things_with_other_joints_are_not_exported_together(
    dataset: Path, locations: Locations, tmp_path: Path
) -> None:
    source = open_source(dataset, None, locations)
    record = source.first.record.model_copy(update={"joints": {"cabinet": ("slide",)}})
    other = replace(source, first=replace(source.first, record=record))
    with pytest.raises(DatasetError, match=r"ep_000000 has objects with other joints than ep_000000"):
        export_lerobot(other, tmp_path / "out", ignore, pictures=False, environment_state=True)
    assert not (tmp_path / "out").exists()


def test_without_pictures_there_are_no_videos_and_no_cameras(of_numbers: Path) -> None:
    info = json.loads((of_numbers / "meta" / "info.json").read_text())
    assert {path.name for path in of_numbers.iterdir()} == {"data", "meta"}
    assert info["video_path"] is None
    assert not [key for key in info["features"] if "camera" in key or "images" in key]
    assert not [key for key in rows(of_numbers, "meta/episodes/*/*.parquet") if "camera" in key or "video" in key]


def test_elements_of_matrices_are_named_by_row_and_column(export: Path, dataset: Path) -> None:
    features = json.loads((export / "meta" / "info.json").read_text())["features"]
    found, frame = rows(export, "data/*/*.parquet"), recorded(dataset)[0][0]
    for what, element, row, column in (("intrinsics", "K02", 0, 2), ("extrinsics", "T13", 1, 3)):
        key = f"camera.{what}.scene_camera"
        place = features[key]["names"].index(element)
        assert found[key][0][place] == np.float32(frame[what]["scene_camera"][row, column])


def test_videos_are_described_so_that_lerobot_encodes_them_alike(export: Path) -> None:
    """Its editing tools encode again with these settings."""
    features = json.loads((export / "meta" / "info.json").read_text())["features"]
    info = features["observation.images.scene_camera"]["info"]
    told = {key: info[f"video.{key}"] for key in ("codec", "pix_fmt", "g", "crf", "preset", "extra_options")}
    same = {"codec": "h264", "pix_fmt": "yuv420p", "g": 2, "crf": 21, "preset": "veryfast"}
    assert told == same | {"extra_options": {"bf": "0", "mbtree": "0"}}
    with av.open(str(next(export.glob("videos/*scene_camera/*/*.mp4")))) as container:
        # BT.601, which decoders assume that ignore the tag.
        assert container.streams.video[0].codec_context.colorspace == 6


def test_statistics_are_those_of_the_data(export: Path, dataset: Path) -> None:
    stats = json.loads((export / "meta" / "stats.json").read_text())
    info = json.loads((export / "meta" / "info.json").read_text())
    assert set(stats) == set(info["features"])
    joints = np.array([frame["joints"] for episode in recorded(dataset) for frame in episode], np.float64)
    for name in ("min", "max", "mean", "std"):
        np.testing.assert_allclose(stats["observation.state"][name], getattr(joints, name)(0), atol=1e-9)
    assert stats["observation.state"]["count"] == [len(joints)]
    pixels = jpegs(dataset, "scene_camera")[:, ::4, ::4].reshape(-1, 3) / 255
    shown = stats["observation.images.scene_camera"]
    for name in ("min", "max", "mean", "std"):
        np.testing.assert_allclose(np.ravel(shown[name]), getattr(pixels, name)(0), atol=1e-9)
    assert np.shape(shown["q99"]) == (3, 1, 1)
    row = rows(export, "meta/episodes/*/*.parquet")
    first, second, _ = frames_of(dataset)
    np.testing.assert_allclose(row["stats/observation.state/mean"][1], joints[first : first + second].mean(0))
    assert row["stats/action/count"] == [[frames] for frames in frames_of(dataset)]


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
    export_lerobot(open_source(dataset, None, locations), tmp_path / "again", ignore)
    files = [file for file in export.rglob("*") if file.is_file()]
    assert len(files) == 6 + len(CAMERAS) * EPISODES
    for file in files:
        assert (tmp_path / "again" / file.relative_to(export)).read_bytes() == file.read_bytes(), file.name


def test_an_export_that_fails_leaves_nothing(dataset: Path, locations: Locations, tmp_path: Path) -> None:
    copy = shutil.copytree(dataset, tmp_path / "copy")
    (copy / "ep_000001" / "rgb" / "scene_camera" / "000030.jpg").write_bytes(b"\xff\xd8\xff\xd9")
    with pytest.raises(DatasetError, match=r"000030\.jpg is not what was recorded"):
        export_lerobot(open_source(copy, None, locations), tmp_path / "out", ignore)

    def interrupt(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(InterruptedJobError, match="nothing was written"):
        export_lerobot(open_source(dataset, None, locations), tmp_path / "out", interrupt)
    assert [path.name for path in tmp_path.iterdir()] == ["copy"]
