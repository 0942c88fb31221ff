"""`yamsim replay` on a real episode: the video in a player, the viewer's states, and refused input."""

from __future__ import annotations

import asyncio
import json
import os
import shutil
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.cli.run_cli import yamsim
from tests.cli.serve_cli import shown
from tests.unrendered import SIZE, change_frame, change_record, frame_count, read_frame, write_dataset
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.reader import RecordedImages, open_episode, read_recording_config
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.files.writing import sha256_bytes
from yamsim_cli.datasets.verify import reproduce_episode
from yamsim_cli.viewers.page_address import PageAddress
from yamsim_cli.viewers.show.replay import episode_positions, session_with_wrist_camera
from yamsim_cli.viewers.viewed_scene import EpisodePlayer
from yamsim_cli.viewers.viewpoint import Viewpoint

av = pytest.importorskip("av", reason="yamsim[video] is not installed")


@pytest.fixture(scope="module")
def original(
    tmp_path_factory: pytest.TempPathFactory, make_config: Callable[..., RecordConfig], locations: Locations
) -> Path:
    path = tmp_path_factory.mktemp("replay") / "dataset"
    write_dataset(path, make_config({("image", "size_px"): SIZE, ("seed",): 8}), locations, 2)
    return path


@pytest.fixture
def dataset(original: Path, tmp_path: Path) -> Path:
    return shutil.copytree(original, tmp_path / "dataset")


@pytest.fixture(scope="module")
def simulator(original: Path, locations: Locations) -> Simulator:
    return Simulator(session_with_wrist_camera(Session(read_recording_config(original, locations), locations)))


@pytest.fixture
def player(original: Path, simulator: Simulator) -> EpisodePlayer:
    states = episode_positions(open_episode(original / "ep_000001"), simulator)
    return EpisodePlayer("test", simulator.scene.model, states, 0.064)


def timestamps(path: Path) -> list[Fraction]:
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.pix_fmt) == ("h264", "yuv420p")
        return [frame.pts * stream.time_base for frame in container.decode(stream)]


def test_a_video_of_the_recorded_images_at_their_own_pace(original: Path, tmp_path: Path) -> None:
    run = yamsim("replay", original / "ep_000001", "--video", tmp_path / "a.mp4", "--json")
    assert (run.code, run.err) == (0, "")
    frames = frame_count(original / "ep_000001")
    assert run.json == {
        "episode": str(original / "ep_000001"),
        "video": str(tmp_path / "a.mp4"),
        "frames": frames,
        "seconds": pytest.approx(frames * 0.064),
        "size": list(SIZE),
        "cameras": ["scene_camera"],
        "rendered": False,
        "moved_aside": None,
        "max_error": 0.0,
        "first_divergence": None,
    }
    assert timestamps(tmp_path / "a.mp4") == [Fraction(k * 8, 125) for k in range(frames)]
    assert [path.name for path in tmp_path.iterdir()] == ["a.mp4"]


def test_an_episode_by_its_number_at_half_speed_and_twice_side_by_side(original: Path, tmp_path: Path) -> None:
    twice = ("--camera", "scene_camera", "--camera", "scene_camera")
    run = yamsim("replay", original, "--episode", "1", "--video", tmp_path / "a.mp4", "--speed", "0.5", *twice)
    assert (run.code, run.err) == (0, "")
    frames = frame_count(original / "ep_000001")
    assert f"{frames} frames, {frames * 0.128:.2f} s, 48x16, scene_camera, scene_camera" in run.out
    assert "bit for bit" in run.out
    assert timestamps(tmp_path / "a.mp4")[-1] == Fraction((frames - 1) * 16, 125)


def test_an_older_video_is_kept_unless_told_and_then_moved_aside(original: Path, tmp_path: Path) -> None:
    (tmp_path / "a.mp4").write_bytes(b"precious")
    command = ("replay", original / "ep_000000", "--video", tmp_path / "a.mp4")
    refused = yamsim(*command)
    assert (refused.code, "exists; move it aside with --overwrite" in refused.message) == (2, True)
    assert (tmp_path / "a.mp4").read_bytes() == b"precious"
    run = yamsim(*command, "--overwrite", "--json")
    assert run.json["moved_aside"] == str(tmp_path / "a.mp4.old-1")
    assert (tmp_path / "a.mp4.old-1").read_bytes() == b"precious"
    assert len(timestamps(tmp_path / "a.mp4")) == frame_count(original / "ep_000000")


@pytest.mark.parametrize("name", ["rgb/scene_camera/000040.jpg", "episode.json"])
@pytest.mark.parametrize("damage", ["cut", "gone"])
def test_a_damaged_episode_is_one_line_and_leaves_no_video(
    dataset: Path, tmp_path: Path, name: str, damage: str
) -> None:
    file = dataset / "ep_000001" / name
    if damage == "cut":
        file.write_bytes(file.read_bytes()[:-40])
    else:
        file.unlink()
    run = yamsim("replay", dataset / "ep_000001", "--video", tmp_path / "a.mp4")
    assert run.code == 4
    assert f"ep_000001/{name}" in run.message or name in run.message
    assert not list(tmp_path.glob("*.mp4*"))


def test_an_image_that_is_none_is_told_even_where_its_hash_agrees(dataset: Path, tmp_path: Path) -> None:
    directory = dataset / "ep_000001"
    (directory / "rgb/scene_camera/000040.jpg").write_bytes(b"no image")
    files = json.loads((directory / "episode.json").read_text())["files"]
    change_record(directory, files=files | {"rgb/scene_camera/000040.jpg": sha256_bytes(b"no image")})
    run = yamsim("replay", directory, "--video", tmp_path / "a.mp4")
    assert (run.code, "frame 40 of scene_camera is not a JPEG of 24x16" in run.message) == (4, True)


def test_a_video_is_made_though_its_actions_lead_elsewhere_and_it_says_so(dataset: Path, tmp_path: Path) -> None:
    actions = read_frame(dataset / "ep_000001", 20)["sim_ctrl"] + 0.01
    change_frame(dataset / "ep_000001", 20, rehash=True, sim_ctrl=actions)
    run = yamsim("replay", dataset / "ep_000001", "--video", tmp_path / "a.mp4", "--json")
    assert run.code == 0
    assert run.json["max_error"] > 1e-4
    assert run.json["first_divergence"]["frame"] == 20
    (dataset / "config.yaml").unlink()
    run = yamsim("replay", dataset / "ep_000001", "--video", tmp_path / "b.mp4", "--json")
    assert (run.code, run.json["max_error"]) == (0, None)
    assert "Its actions were not simulated again: " in run.err


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ((".",), "is a dataset: give one of its episodes (ep_000000, ep_000001), or --episode"),
        ((".", "--episode", "7"), "there is no ep_000007"),
        (("ep_000001", "--video", "a.avi"), "must end in .mp4"),
        (("ep_000001", "--video", "a.mp4", "--camera", "wrist"), "--camera 'wrist' is not valid; valid: scene_camera"),
        (("ep_000001", "--video", "a.mp4", "--size", "64x48"), "give --render"),
        (("ep_000001", "--video", "a.mp4", "--web"), "is for the viewer"),
        (("ep_000001", "--camera", "scene_camera"), "is for a video: give --video"),
        (("ep_000001", "--video", "a.mp4", "--speed", "0"), "--speed 0 is not valid"),
        (("ep_000001", "--video", "a.mp4", "--speed", "nan"), "--speed nan is not valid"),
    ],
)
def test_a_bad_command_line_is_one_line_and_code_2(original: Path, args: tuple[str, ...], message: str) -> None:
    run = yamsim("replay", *args, cwd=original)
    assert (run.code, message in run.message) == (2, True), run.message


def test_without_the_library_the_extra_is_named(original: Path, tmp_path: Path, repository: Path) -> None:
    (tmp_path / "av.py").write_text("raise ModuleNotFoundError(\"No module named 'av'\", name='av')")
    path = os.pathsep.join([str(tmp_path), str(repository)])
    run = yamsim("replay", original / "ep_000000", "--video", tmp_path / "a.mp4", env={"PYTHONPATH": path})
    assert (run.code, run.message) == (4, "a video needs PyAV, which is missing: pip install 'yamsim[video]'")


def test_actions_are_repeated_where_there_are_any(dataset: Path, locations: Locations) -> None:
    config = read_recording_config(dataset, locations)
    assert reproduce_episode(open_episode(dataset / "ep_000000"), Session(config, locations)).max_error == 0.0  # type: ignore[union-attr]
    for k in range(frame_count(dataset / "ep_000000")):
        change_frame(dataset / "ep_000000", k, rehash=True, sim_qpos=None, sim_ctrl=None, sim_magnet=None)
    assert reproduce_episode(open_episode(dataset / "ep_000000"), Session(config, locations)) is None


def test_states_of_another_scene_are_not_shown(dataset: Path, simulator: Simulator) -> None:
    change_frame(dataset / "ep_000001", 9, rehash=True, sim_qpos=np.zeros(5))
    with pytest.raises(DatasetError, match="frame 9 has 5 positions, and its scene has 22"):
        episode_positions(open_episode(dataset / "ep_000001"), simulator)
    change_frame(dataset / "ep_000000", 9, rehash=True, sim_qpos=None, sim_ctrl=None, sim_magnet=None)
    with pytest.raises(DatasetError, match="holds no sim_qpos"):
        episode_positions(open_episode(dataset / "ep_000000"), simulator)


def test_the_player_shows_each_frame_for_its_time_and_begins_again(player: EpisodePlayer, original: Path) -> None:
    def banana() -> np.ndarray:
        return player.body_poses()[0][player.model.body("banana").id]

    shown, frames = [], frame_count(original / "ep_000001")
    for k in range(frames + 1):
        player.advance_to(10.0 + k * 0.064)
        shown.append(player.frame_number)
        stored = read_frame(original / "ep_000001", player.frame_number)["sim_qpos"]
        np.testing.assert_array_equal(player.data.qpos, stored)
    assert shown == [*range(frames), 0]
    start = banana().copy()
    player.seek(frames - 1)
    assert player.frame_number == frames - 1
    assert np.linalg.norm(banana() - start) > 0.1
    player.reset()
    np.testing.assert_array_equal(banana(), start)


def test_a_paused_player_stands_still_and_goes_on_where_it_was(player: EpisodePlayer) -> None:
    player.advance_to(0.0)
    player.advance_to(0.64)
    player.paused = True
    player.advance_to(5.0)
    assert player.frame_number == 10
    player.seek(20)
    player.advance_to(6.0)
    assert player.frame_number == 20
    player.paused = False
    player.advance_to(6.064)
    assert player.frame_number == 21


def test_a_page_does_not_undo_what_a_user_does_with_its_slider(player: EpisodePlayer, original: Path) -> None:
    page_module = pytest.importorskip("yamsim_cli.viewers.episode_page", reason="yamsim[view] is not installed")
    viewpoint = Viewpoint(np.zeros(3), 1.0, 0.0, -30.0)
    page = page_module.EpisodePage(
        player, viewpoint, PageAddress(), RecordedImages(open_episode(original / "ep_000001"))
    )
    try:
        player.seek(5)
        page.update()
        assert page.slider.value == 5
        # viser sets it before it notifies the page.
        page.slider.value = 30
        page.update()
        assert page.slider.value == 30
        asyncio.run(page.seek(SimpleNamespace(client=object())))
        page.update()
        assert (player.frame_number, page.slider.value) == (30, 30)
    finally:
        page.close()


def test_the_page_comes_up_and_a_signal_ends_it(original: Path) -> None:
    pytest.importorskip("viser", reason="yamsim[view] is not installed")
    with shown("replay", original / "ep_000000", "--web", "--port", "0") as page:
        assert page.url.startswith("http://127.0.0.1:")
        assert page.report["max_error"] == 0.0
        assert page.end() == (0, "", [])
