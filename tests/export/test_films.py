"""Exports for the eye: videos and a contact sheet against the recorded pictures; files for the rerun viewer."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.export.conftest import CAMERAS, EPISODES, frames_of, ignore, picture
from tests.unrendered import SIZE, frame_count
from yamsim_cli.core.errors import DatasetError, PartialJobError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.files.writing import move_to_backup
from yamsim_cli.core.images.jpeg import decode_jpeg
from yamsim_cli.export.export_source import open_source
from yamsim_cli.export.videos import export_mp4, export_sheet

CLOSE = 6.0


def test_each_episode_becomes_a_video_of_its_cameras_side_by_side(
    dataset: Path, locations: Locations, tmp_path: Path
) -> None:
    av = pytest.importorskip("av", reason="yamsim[video] is not installed")
    done = export_mp4(open_source(dataset, None, locations), tmp_path / "out", (), ignore)
    frames = frames_of(dataset)
    assert (done.episodes, done.frames) == (EPISODES, sum(frames))
    assert sorted(path.name for path in done.path.iterdir()) == [f"ep_{k:06d}.mp4" for k in range(EPISODES)]
    with av.open(str(done.path / "ep_000002.mp4")) as container:
        images = list(container.decode(video=0))
    assert [image.time for image in images] == pytest.approx([k * 0.064 for k in range(frames[2])])
    for k in (0, 30, frames[2] - 1):
        wanted = np.concatenate([picture(camera, 2, k) for camera in CAMERAS], axis=1)
        assert np.abs(images[k].to_ndarray(format="rgb24").astype(float) - wanted).mean() < CLOSE


def test_one_camera_and_another_speed(dataset: Path, locations: Locations, tmp_path: Path) -> None:
    av = pytest.importorskip("av", reason="yamsim[video] is not installed")
    source = open_source(dataset, "1", locations)
    export_mp4(source, tmp_path / "out", ("right_wrist_camera",), ignore, speed=2.0)
    with av.open(str(tmp_path / "out" / "ep_000001.mp4")) as container:
        images = list(container.decode(video=0))
    assert (images[0].width, images[1].time) == (SIZE[0], pytest.approx(0.032))
    with pytest.raises(UsageError, match="--camera 'scene' is not valid; valid: right_wrist"):
        export_mp4(source, tmp_path / "other", ("scene",), ignore)


def test_a_sheet_has_a_row_for_each_episode_from_first_frame_to_last(
    dataset: Path, locations: Locations, tmp_path: Path
) -> None:
    out = tmp_path / "sheet.jpg"
    done = export_sheet(open_source(dataset, None, locations), out, (), ignore, columns=3, width=96)
    assert (done.episodes, done.frames) == (EPISODES, 9)
    sheet = decode_jpeg(out.read_bytes())
    assert sheet is not None
    assert sheet.shape == (EPISODES * 64, 3 * 96, 3)
    for row, frames in enumerate(frames_of(dataset)):
        for column, k in enumerate((0, int(np.round((frames - 1) / 2)), frames - 1)):
            # Below the label.
            cell = sheet[row * 64 + 40 : row * 64 + 64, column * 96 + 8 : column * 96 + 88]
            wanted = picture("scene_camera", row, k)[10:].reshape(-1, 3).mean(0)
            assert np.abs(cell.reshape(-1, 3).mean(0) - wanted).max() < 8


def test_a_sheet_that_cannot_be_is_refused_before_the_work(dataset: Path, locations: Locations, tmp_path: Path) -> None:
    source = open_source(dataset, None, locations)
    for out, message in (("sheet.gif", "must end in .jpg"), ("no/sheet.jpg", "there is no directory")):
        with pytest.raises(UsageError, match=re.escape(message)):
            export_sheet(source, tmp_path / out, (), ignore)
    with pytest.raises(UsageError, match="at most 16000 px: give fewer --episodes"):
        export_sheet(source, tmp_path / "sheet.jpg", (), ignore, columns=100, width=1920)
    (tmp_path / "sheet.jpg").write_text("mine")
    with pytest.raises(UsageError, match="move it aside with --overwrite"):
        export_sheet(source, tmp_path / "sheet.jpg", (), ignore)
    done = export_sheet(source, tmp_path / "sheet.jpg", (), ignore, overwrite=True)
    assert done.moved_aside is not None
    assert done.moved_aside.read_text() == "mine"


def test_a_damaged_episode_leaves_no_sheet(dataset: Path, locations: Locations, tmp_path: Path) -> None:
    source = open_source(dataset, "0", locations)
    image = dataset / "ep_000000" / "rgb" / "scene_camera" / f"{frame_count(dataset / 'ep_000000') - 1:06d}.jpg"
    moved = move_to_backup(image)
    try:
        with pytest.raises(DatasetError, match=rf"{image.name} cannot be read"):
            export_sheet(source, tmp_path / "sheet.jpg", (), ignore)
    finally:
        moved.rename(image)
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_reported_for_a_sheet(
    dataset: Path, locations: Locations, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, data: bytes) -> None:
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr("yamsim_cli.export.videos.write_file", full)
    with pytest.raises(PartialJobError, match="No space left on device"):
        export_sheet(open_source(dataset, "0", locations), tmp_path / "sheet.jpg", (), ignore)


def test_rerun_reads_back_images_joints_poses_and_frusta(dataset: Path, locations: Locations, tmp_path: Path) -> None:
    pytest.importorskip("rerun", reason="yamsim[rerun] is not installed")
    from yamsim_cli.export.rrd import export_rerun

    done = export_rerun(open_source(dataset, "0-1", locations), tmp_path / "out", ignore)
    assert (done.episodes, done.frames) == (2, sum(frames_of(dataset)[:2]))
    files = sorted(done.path.iterdir())
    assert [file.name for file in files] == ["ep_000000.rrd", "ep_000001.rrd"]
    rerun = Path(sys.executable).with_name("rerun")

    def run(*words: str | Path) -> str:
        shown = subprocess.run([rerun, "rrd", *words], capture_output=True, text=True, check=True)
        return re.sub(r"\x1b\[[0-9;]*m", "", shown.stdout + shown.stderr)

    assert "verified without error" in run("verify", *files)
    text = run("print", "-v", files[0])
    entities = set(re.findall(r"/[a-z0-9_/]+", text))
    for camera in CAMERAS:
        assert {f"/base/{camera}", f"/base/{camera}/rgb"} <= entities
    assert {"/base/hand", "/base/banana", "/base/plate", "/joints/joint6", "/ctrl/gripper", "/weld"} <= entities
    for kind in ("Pinhole:image_from_camera", "EncodedImage:blob", "Transform3D:mat3x3", "Scalars:scalars"):
        assert kind in text, kind
