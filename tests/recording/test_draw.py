"""`yamsim draw`: other images of the same states, with the same physics, that `verify` reproduces."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli.run_cli import REPOSITORY, yamsim
from yamsim_cli.core.dataset.lowdim import load_frame

pytestmark = pytest.mark.render

CAMERA_KEYS = {"intrinsics", "extrinsics", "K_wrist"}
SMALL = ("--size", "48x32", "--quality", "fast", "--offline")

EFFECTS = Path(__file__).parents[1] / "data" / "camera_effects.yaml"
LOOKS = ("--looks", "2", "--views", "1", "--truth", "--camera-effects", f"view_00={EFFECTS}")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("recorded") / "dataset"
    done = yamsim("record", "--n", "2", "--workers", "1", "--seed", "6", "--randomize", *SMALL, "--out", out)
    assert done.code == 0, done.err
    return out


@pytest.fixture(scope="module")
def looks(recorded: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("looks") / "drawn"
    done = yamsim("draw", recorded, "--out", out, *LOOKS, "--workers", "1", "--offline")
    assert done.code == 0, done.err
    return out


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def record_of(dataset: Path, episode: int) -> dict[str, Any]:
    data: dict[str, Any] = json.loads((dataset / f"ep_{episode:06d}" / "episode.json").read_text())
    return data


def frames_of(dataset: Path, episode: int) -> list[dict[str, Any]]:
    return [load_frame(path.read_bytes()) for path in sorted((dataset / f"ep_{episode:06d}" / "lowdim").iterdir())]


@pytest.mark.slow
def test_without_changes_every_image_and_state_has_the_same_bytes(recorded: Path, tmp_path: Path) -> None:
    out = tmp_path / "drawn"
    assert yamsim("draw", recorded, "--out", out, "--workers", "1", "--offline").code == 0
    one, other = contents(recorded), contents(out)
    changed = {"config.yaml", "manifest.json", "ep_000000/episode.json", "ep_000001/episode.json"}
    assert one.keys() == other.keys()
    assert {name for name in one if one[name] != other[name]} == changed
    old, new = record_of(recorded, 1), record_of(out, 1)
    assert old | {"versions": None} == new | {"versions": None}
    assert set(new["versions"]) - set(old["versions"]) == {"drawn_by", "drawn_from"}


@pytest.fixture(scope="module")
def physics(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first episode of `recorded`, without images."""
    out = tmp_path_factory.mktemp("physics") / "dataset"
    flags = ("--n", "1", "--workers", "1", "--seed", "6", "--randomize", *SMALL, "--no-images")
    done = yamsim("record", *flags, "--out", out)
    assert done.code == 0, done.err
    return out


@pytest.mark.slow
def test_an_episode_without_images_is_drawn_as_it_would_have_been_recorded(
    recorded: Path, physics: Path, tmp_path: Path
) -> None:
    out = tmp_path / "drawn"
    assert {path.name for path in (physics / "ep_000000").iterdir()} == {"episode.json", "lowdim"}
    assert record_of(physics, 0)["cameras"] == {}
    assert yamsim("draw", physics, "--out", out, "--workers", "1", "--offline").code == 0
    wanted, made = contents(recorded / "ep_000000"), contents(out / "ep_000000")
    assert made.keys() == wanted.keys()
    assert {name for name in made if made[name] != wanted[name]} == {"episode.json"}


def test_exports_name_the_command_that_makes_the_missing_images(physics: Path, tmp_path: Path) -> None:
    done = yamsim("export", "lerobot", physics, tmp_path / "out")
    assert done.code == 4
    assert f"{physics} has no pictures" in done.err
    assert f"yamsim draw {physics}" in done.err
    assert len(done.err.splitlines()) == 1
    assert not (tmp_path / "out").exists()


def test_flags_for_images_contradict_no_images(tmp_path: Path) -> None:
    for flag in (("--truth",), ("--camera", "scene_camera"), ("--wrist",)):
        done = yamsim("record", "--no-images", *flag, "--out", tmp_path / "out")
        assert done.code == 2
        assert f"{flag[0]} and --no-images contradict each other" in done.err


@pytest.mark.slow
def test_other_commands_read_a_dataset_without_images(physics: Path, tmp_path: Path) -> None:
    done = yamsim("verify", physics, "--images", "--workers", "1", "--json")
    assert done.code == 0, done.err
    report = json.loads(done.out)
    assert report["checks"]["seed"]["max_error"] == 0
    assert report["checks"]["images"]["skipped"] == ["it was recorded without images"]
    assert yamsim("summarize", physics, "--strict").code == 0
    done = yamsim("replay", physics, "--episode", "0", "--video", tmp_path / "video.mp4")
    assert done.code == 4
    assert "--render" in done.err
    flags = ("--render", "--size", "64x48", "--video", tmp_path / "video.mp4", "--offline")
    assert yamsim("replay", physics, "--episode", "0", *flags).code == 0
    flags = ("--n", "1", "--workers", "1", "--seed", "6", "--randomize", *SMALL, "--no-images")
    assert yamsim("record", *flags, "--resume", "--out", physics).code == 0


@pytest.mark.slow
def test_looks_differ_in_images_and_have_the_same_physics(recorded: Path, looks: Path) -> None:
    for look in (looks / "look_1", looks / "look_2"):
        for episode in range(2):
            for old, new in zip(frames_of(recorded, episode), frames_of(look, episode), strict=True):
                assert list(old) == list(new)
                for key in old.keys() - CAMERA_KEYS:
                    np.testing.assert_array_equal(old[key], new[key], strict=isinstance(old[key], np.ndarray))
            old_record, new_record = record_of(recorded, episode), record_of(look, episode)
            for key in ("attempt", "seed", "outcome", "layout", "frames", "phrasing", "source"):
                assert old_record[key] == new_record[key]
            for key in ("mass", "friction", "arm_dynamics"):
                assert old_record["randomized"][key] == new_record["randomized"][key]
            assert old_record["randomized"]["lights"] != new_record["randomized"]["lights"]
            assert list(new_record["cameras"]) == ["scene_camera", "view_00"]
            assert new_record["truth"] is True
    one, other = contents(looks / "look_1"), contents(looks / "look_2")
    assert one.keys() == other.keys()
    for name in (name for name in one if name.startswith("ep_") and name.endswith(".jpg")):
        assert one[name] != other[name]


@pytest.mark.slow
def test_a_dataset_recorded_in_a_look_equals_the_drawn_one(looks: Path, tmp_path: Path) -> None:
    """The drawn config records the same bytes from the seed, so `verify` needs nothing else."""
    config = looks / "look_2" / "config.yaml"
    out = tmp_path / "again"
    done = yamsim("record", "--config", config, "--n", "1", "--workers", "1", "--offline", "--out", out)
    assert done.code == 0, done.err
    one, other = contents(looks / "look_2" / "ep_000000"), contents(out / "ep_000000")
    assert {name for name in one if one[name] != other.get(name)} == {"episode.json"}


@pytest.mark.slow
def test_verify_draws_again_and_finds_another_image(looks: Path, tmp_path: Path) -> None:
    done = yamsim("verify", looks / "look_1", "--images", "--offline", "--json", "--workers", "1")
    assert done.code == 0, done.err
    assert done.json["agree"] == 2
    assert done.json["checks"]["images"] | {"skipped": []} == done.json["checks"]["images"]
    copy = shutil.copytree(looks / "look_1", tmp_path / "copy")
    images = sorted((copy / "ep_000001" / "rgb" / "view_00").iterdir())
    shutil.copy(images[0], images[9])
    done = yamsim("verify", copy, "--images", "--offline", "--episodes", "1", "--workers", "1")
    assert done.code == 4
    assert "rgb/view_00/000009.jpg" in done.err


@pytest.mark.slow
def test_a_missing_and_a_damaged_episode_are_drawn_again(recorded: Path, looks: Path, tmp_path: Path) -> None:
    whole = contents(looks / "look_1")
    copy = shutil.copytree(looks, tmp_path / "copy")
    shutil.rmtree(copy / "look_1" / "ep_000000")
    (copy / "look_1" / "ep_000001" / "lowdim" / "000003.pkl").write_bytes(b"")
    (copy / "look_1" / "attempts.jsonl").unlink()
    done = yamsim("draw", recorded, "--out", copy, *LOOKS, "--workers", "1", "--offline", "--resume")
    assert done.code == 0, done.err
    found = {name: data for name, data in contents(copy / "look_1").items() if not name.startswith(".damaged")}
    assert found == whole


@pytest.mark.slow
def test_another_revision_of_the_arm_keeps_the_states(recorded: Path, tmp_path: Path) -> None:
    """`verify` repeats physics with the rig of the source, and draws with the other one."""
    out = tmp_path / "drawn"
    assert yamsim("draw", recorded, "--out", out, "--revision", "v1", "--workers", "1", "--offline").code == 0
    for old, new in zip(frames_of(recorded, 0), frames_of(out, 0), strict=True):
        np.testing.assert_array_equal(old["sim_qpos"], new["sim_qpos"])
        np.testing.assert_array_equal(old["ee_pose"], new["ee_pose"])
    done = yamsim("verify", out, "--images", "--offline", "--json", "--episodes", "0", "--workers", "1")
    assert done.code == 0, done.err
    assert done.json["checks"]["seed"]["agree"] == done.json["checks"]["images"]["agree"] == 1


@pytest.mark.slow
def test_after_a_kill_nothing_is_half_visible_and_the_rest_is_the_same(recorded: Path, tmp_path: Path) -> None:
    whole, out = tmp_path / "whole", tmp_path / "killed"
    given = ("--randomize", "--looks", "2", "--workers", "2", "--offline")
    assert yamsim("draw", recorded, "--out", whole, *given).code == 0
    command = [sys.executable, "-m", "yamsim_cli", "draw", str(recorded), "--out", str(out), *given]
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    running = subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
    until = time.monotonic() + 120
    while not (out / "look_1" / "ep_000000").exists() and time.monotonic() < until:
        time.sleep(0.05)
    running.send_signal(signal.SIGKILL)
    running.wait()
    for episode in out.glob("look_*/ep_*"):  # staged episodes are in a hidden directory
        assert {str(path.relative_to(episode)) for path in episode.rglob("*") if path.is_file()} >= {"episode.json"}
        files = json.loads((episode / "episode.json").read_text())["files"]
        assert all((episode / name).is_file() for name in files)
    assert yamsim("draw", recorded, "--out", out, *given, "--resume").code == 0
    assert contents(out) == contents(whole)


@pytest.mark.parametrize(
    ("given", "code", "message"),
    [
        (("--camera", "left"), 2, "no camera 'left'"),
        (("--views", "101"), 2, "less than or equal to 100"),
        (("--scene", "SCENE"), 2, "its table or safety_plane differs"),
        (("--rig", "bimanual"), 2, "have other joints, sides or bases"),
        (("--randomization", "default", "--no-randomize"), 2, "contradict each other"),
        (("--camera-effects", "top=d405"), 2, "no camera 'top'"),
        (("--camera-effects", "d406"), 3, "did you mean 'd405'"),
        (("--cameras", "CAMERAS"), 3, "give a list"),
        (("--looks", "2", "--no-randomize"), 2, "all looks would be equal"),
    ],
)
def test_invalid_changes_are_refused(
    given: tuple[str, ...], code: int, message: str, physics: Path, tmp_path: Path
) -> None:
    scene = tmp_path / "scene.yaml"
    text = (REPOSITORY / "configs" / "scenes" / "tabletop.yaml").read_text()
    scene.write_text(text.replace("safety_plane: ", "safety_plane: -0.01\nold: ").replace("old:", "# old:"))
    (tmp_path / "cameras.yaml").write_text("views: []\n")
    files = {"SCENE": str(scene), "CAMERAS": str(tmp_path / "cameras.yaml")}
    words = [files.get(word, word) for word in given]
    done = yamsim("draw", physics, "--out", tmp_path / "out", *words, "--offline")
    assert done.code == code, done.err
    assert message in done.err
    assert not (tmp_path / "out").exists()


def test_the_dataset_itself_is_no_output(physics: Path) -> None:
    before = contents(physics)
    done = yamsim("draw", physics, "--out", physics, "--overwrite", "--offline")
    assert done.code == 2 and "which draw does not change" in done.message
    assert contents(physics) == before
