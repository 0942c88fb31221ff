"""The main job of a user: record, summarize, interrupt, resume."""

from __future__ import annotations

import hashlib
import json
import pickle
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml

from tests.cli.run_cli import yamsim
from yamsim_cli.core.config.rendering import ImageConfig
from yamsim_cli.gl import GlBackend
from yamsim_cli.recording.disk_space import EpisodeSize

pytestmark = pytest.mark.render

SMALL = ("--size", "96x72", "--wrist", "--seed", "3")


def digest(dataset: Path) -> dict[str, str]:
    """Hash of every file of a dataset."""
    return {
        path.relative_to(dataset).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(dataset.rglob("*"))
        if path.is_file()
    }


def frames(dataset: Path) -> list[int]:
    """Number of frames in each episode's record."""
    return [json.loads(file.read_text())["frames"] for file in sorted(dataset.glob("ep_*/episode.json"))]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("record") / "two_workers"
    run = yamsim("record", "--n", "3", "--workers", "2", "--out", path, *SMALL, "--json")
    assert run.code == 0, run.err
    assert run.json["episodes"] == 3
    assert run.json["path"] == str(path)
    assert run.json["attempts"] >= 3
    return path


def test_layout_on_the_disk(dataset: Path) -> None:
    assert sorted(path.name for path in dataset.iterdir()) == [
        "attempts.jsonl",
        "config.yaml",
        "ep_000000",
        "ep_000001",
        "ep_000002",
        "manifest.json",
    ]
    count = frames(dataset)[1]
    for camera in ("scene_camera", "right_wrist_camera"):
        names = sorted(path.name for path in (dataset / "ep_000001" / "rgb" / camera).iterdir())
        assert names == [f"{k:06d}.jpg" for k in range(count)]
    assert len(list((dataset / "ep_000001" / "lowdim").iterdir())) == count
    image = ImageConfig(size_px=(96, 72), jpeg_quality=85)
    assert EpisodeSize.estimate((count, count), 2, image, 4096).inodes == 1 + len(
        list((dataset / "ep_000001").rglob("*"))
    )


def test_lowdim_reads_without_yamsim(dataset: Path) -> None:
    """A consumer has only numpy and pickle, and the documented keys."""
    every = [pickle.loads(file.read_bytes()) for file in sorted((dataset / "ep_000000" / "lowdim").iterdir())]
    number, frame = next((k, frame) for k, frame in enumerate(every) if frame["magnet"])
    assert list(frame) == [
        "joints",
        "timestamp",
        "intrinsics",
        "extrinsics",
        "banana_pose",
        "plate_pose",
        "ee_pose",
        "ctrl",
        "action_joints",
        "magnet",
        "language_task",
        "language_prompt",
        "K_wrist",
        "sim_qpos",
        "sim_ctrl",
        "sim_magnet",
    ]
    assert frame["joints"].shape == frame["ctrl"].shape == frame["action_joints"].shape == (7,)
    assert frame["timestamp"] == pytest.approx(number * 0.064)
    assert frame["magnet"] is True
    for key in ("banana_pose", "plate_pose", "ee_pose"):
        assert frame[key].shape == (4, 4)
        assert frame[key].dtype == np.float32
        np.testing.assert_allclose(frame[key][:3, :3] @ frame[key][:3, :3].T, np.eye(3), atol=1e-5)
    for camera in ("scene_camera", "right_wrist_camera"):
        assert frame["intrinsics"][camera].shape == (3, 3)
        assert frame["extrinsics"][camera].shape == (4, 4)
    np.testing.assert_array_equal(frame["K_wrist"], frame["intrinsics"]["right_wrist_camera"])
    # The banana is in the hand.
    assert np.linalg.norm(frame["banana_pose"][:3, 3] - frame["ee_pose"][:3, 3]) < 0.08


def test_summary_of_a_whole_dataset(dataset: Path) -> None:
    run = yamsim("summarize", dataset, "--json")
    assert run.code == 0, run.err
    report = run.json
    assert (report["episodes"], report["frames"], report["problems"]) == (3, sum(frames(dataset)), [])
    assert report["success_rate"] == {"0.05": 1.0, "0.08": 1.0}
    assert report["bytes"] == sum(p.stat().st_size for p in dataset.rglob("ep_*/**/*") if p.is_file())
    low, high = report["workspace"]["objects"]["banana"]["start"]["x"]
    assert 0.29 < low <= high < 0.56
    assert run.err == ""


def test_summary_for_a_person(dataset: Path) -> None:
    run = yamsim("summarize", dataset)
    assert run.code == 0
    assert f"3: {sum(frames(dataset))} frames" in run.out
    assert "No problems: every file was opened" in run.out


def test_rescoring_needs_no_simulation(dataset: Path) -> None:
    run = yamsim("summarize", dataset, "--threshold", "0.0001", "--json")
    assert run.json["success_rate"] == {"0.0001": 0.0}


def test_damage_is_named_and_fails(dataset: Path, tmp_path: Path) -> None:
    copy = tmp_path / "damaged"
    shutil.copytree(dataset, copy)
    image = copy / "ep_000001" / "rgb" / "scene_camera" / "000010.jpg"
    image.write_bytes(image.read_bytes()[:-40])
    (copy / "ep_000002" / "lowdim" / "000003.pkl").unlink()
    run = yamsim("summarize", copy, "--json")
    assert run.code == 4
    assert [(p["episode"], p["file"]) for p in run.json["problems"]] == [
        ("ep_000001", "rgb/scene_camera/000010.jpg"),
        ("ep_000002", "lowdim/000003.pkl"),
    ]
    assert "ep_000001/rgb/scene_camera/000010.jpg" in run.message


@pytest.mark.parametrize(("first", "second"), [(signal.SIGTERM, None), (signal.SIGINT, signal.SIGTERM)])
@pytest.mark.slow
def test_interrupted_then_resumed_gives_the_same_bytes(
    dataset: Path, tmp_path: Path, first: signal.Signals, second: signal.Signals | None
) -> None:
    """One signal waits for the present episode, two do not; nothing is lost either way."""
    path = tmp_path / "interrupted"
    flags = ["--n", "3", "--workers", "1", "--out", str(path), *SMALL]
    for _ in range(3):
        code, err = interrupted(path, flags, first, second)
        if code != 0:
            break
        shutil.rmtree(path)  # on a busy machine, the last episode may begin before the signal arrives
    whole = len(list(path.glob("ep_*")))
    assert code == 130, err
    assert err.splitlines()[-1] == (
        f"yamsim: interrupted: {whole} of 3 episodes are complete in {path}, {3 - whole} are left; "
        "continue with --resume"
    )
    # One signal may arrive before the second attempt has begun.
    assert whole == 1 or (whole == 2 and second is None)
    assert not (path / ".lock").exists()
    assert yamsim("summarize", path, "--json").json["problems"] == []

    run = yamsim("record", *flags, "--resume", "--json")
    assert run.code == 0, run.err
    assert digest(path) == digest(dataset)


def interrupted(path: Path, flags: list[str], first: signal.Signals, second: signal.Signals | None) -> tuple[int, str]:
    """Record, and send signals after the first episode; the exit code and the rest of stderr."""
    with subprocess.Popen(
        [sys.executable, "-m", "yamsim_cli", "record", *flags], stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stderr
        wait_for(path / "ep_000000" / "episode.json")
        process.send_signal(first)
        assert process.stderr.readline().startswith("Stopping once the attempts in progress are done.")
        if second:
            process.send_signal(second)
        _, err = process.communicate(timeout=300)
    return process.returncode, err


def wait_for(path: Path) -> None:
    end = time.monotonic() + 120
    while not path.exists():
        assert time.monotonic() < end, f"{path} does not appear"
        time.sleep(0.01)


@pytest.mark.slow
def test_a_lost_episode_is_made_again(dataset: Path, tmp_path: Path) -> None:
    copy = tmp_path / "lost"
    shutil.copytree(dataset, copy)
    shutil.rmtree(copy / "ep_000001")
    (copy / "manifest.json").unlink()
    run = yamsim("record", "--n", "3", "--out", copy, *SMALL, "--resume")
    assert run.code == 0, run.err
    assert digest(copy) == digest(dataset)


def test_resuming_a_finished_dataset_changes_nothing(dataset: Path, tmp_path: Path) -> None:
    before = digest(dataset)
    run = yamsim("record", "--n", "3", "--out", dataset, *SMALL, "--resume", "--json")
    assert run.code == 0, run.err
    assert digest(dataset) == before


def test_resuming_with_another_seed_is_refused(dataset: Path) -> None:
    before = digest(dataset)
    run = yamsim("record", "--n", "4", "--out", dataset, "--size", "96x72", "--wrist", "--seed", "4", "--resume")
    assert run.code == 3
    assert "seed: 3 there, 4 now" in run.message
    assert digest(dataset) == before


def test_the_quality_that_was_chosen_is_kept(dataset: Path) -> None:
    """`auto` is resolved before rendering; the dataset has its value and the renderer."""
    config = yaml.safe_load((dataset / "config.yaml").read_text())
    renderer = json.loads((dataset / "ep_000000" / "episode.json").read_text())["renderer"]
    assert config["render"]["name"] == ("balanced" if GlBackend("egl", renderer).is_software else "high")
    assert config["render"]["shadow_map_px"] > 0


def test_resuming_with_another_quality_is_refused(dataset: Path) -> None:
    """For example on another machine, where `auto` has another value."""
    before = digest(dataset)
    run = yamsim("record", "--n", "4", "--out", dataset, *SMALL, "--quality", "fast", "--resume")
    assert run.code == 3
    assert "render.name: " in run.message
    assert "'fast' now" in run.message
    assert digest(dataset) == before


@pytest.mark.slow
def test_overwrite_moves_the_old_dataset_aside(dataset: Path, tmp_path: Path) -> None:
    copy = tmp_path / "again"
    shutil.copytree(dataset, copy)
    run = yamsim("record", "--n", "1", "--out", copy, *SMALL, "--overwrite", "--json")
    assert run.code == 0, run.err
    assert digest(Path(run.json["moved_aside"])) == digest(dataset)
    assert len(list(copy.glob("ep_*"))) == 1
