"""LeRobot on `export lerobot`, unmodified: its loader, its tool for editing datasets, its training, its doctor."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.clients.environments import Interpreter, yamsim_beside
from tests.export.conftest import jpeg
from tests.export.lerobot_files import Frames, check_numbers, jpegs, recorded
from tests.unrendered import write_dataset
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.files.resources import Locations

pytest.importorskip("pyarrow", reason="yamsim[lerobot] is not installed")
pytest.importorskip("av", reason="yamsim[lerobot] is not installed")
from yamsim_cli.export.export_source import open_source
from yamsim_cli.export.lerobot import export_lerobot

pytestmark = pytest.mark.client_heavy
VERSIONS = ["lerobot", "lerobot-0.4"]
KINDS: Mapping[str, dict[tuple[str, ...], Any]] = {
    "one": {("wrist",): True},
    "two": {("rig",): "russet", ("task",): "handover", ("wrist",): True},
}
EPISODES = 3
# Flag that names the output of a merge.
MERGED = {"lerobot": "--new_repo_id", "lerobot-0.4": "--repo_id"}
# s; the machine may be busy
PATIENCE = 1800


@dataclass(frozen=True)
class Exported:
    """A dataset and its export."""

    dataset: Path
    path: Path
    cameras: tuple[str, ...]
    episodes: Sequence[Frames]


@pytest.fixture(scope="module", params=list(KINDS))
def exported(
    request: pytest.FixtureRequest,
    tmp_path_factory: pytest.TempPathFactory,
    make_config: Callable[..., RecordConfig],
    locations: Locations,
) -> Exported:
    folder = tmp_path_factory.mktemp(request.param)
    write_dataset(folder / "dataset", make_config(KINDS[request.param]), locations, EPISODES, jpeg)
    source = open_source(folder / "dataset", None, locations)
    export_lerobot(source, folder / "export", lambda *_: None)
    return Exported(folder / "dataset", folder / "export", tuple(source.camera_sizes), recorded(folder / "dataset"))


@dataclass(frozen=True)
class LeRobot:
    """One version of LeRobot, with its datasets under `local/`."""

    name: str
    interpreter: Interpreter
    home: Path

    def program(self, name: str, *arguments: str) -> str:
        """Run a program of LeRobot, which must succeed, and return the output."""
        path = self.interpreter.python.with_name(name)
        done = self.interpreter.call([str(path), *arguments], timeout_s=PATIENCE, cwd=self.home)
        assert done.returncode == 0, f"{name} {' '.join(arguments)}:\n{done.stdout[-2000:]}\n{done.stderr[-3000:]}"
        return done.stdout

    def edit(self, operation: str, *arguments: str) -> None:
        """`lerobot-edit-dataset`."""
        self.program("lerobot-edit-dataset", f"--operation.type={operation}", *arguments)

    def path(self, name: str) -> Path:
        """Return the path of one of its datasets."""
        return self.home / "local" / name

    def read(self, name: str) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return feature -> values of all frames by its loader, and further metadata."""
        out = self.home / f"{name}.npz"
        told = self.interpreter.run("read_lerobot.py", self.path(name), out, timeout_s=PATIENCE)
        return dict(np.load(out)), told

    def train(self, name: str) -> dict[str, Any]:
        """Return the config of an ACT policy after two training steps on a dataset."""
        out = self.home / f"trained_{name}"
        self.program(
            "lerobot-train",
            f"--dataset.repo_id=local/{name}",
            # Its default needs FFmpeg's libraries, which it does not install.
            "--dataset.video_backend=pyav",
            "--policy.type=act",
            "--policy.push_to_hub=false",
            "--policy.device=cpu",
            "--policy.pretrained_backbone_weights=null",
            "--num_workers=0",
            "--batch_size=2",
            "--steps=2",
            # A small policy: the test is that training starts.
            *("--policy.dim_model=64", "--policy.n_heads=4", "--policy.dim_feedforward=128"),
            *("--policy.chunk_size=8", "--policy.n_action_steps=8"),
            f"--output_dir={out}",
        )
        trained: dict[str, Any] = json.loads((out / "checkpoints/000002/pretrained_model/config.json").read_text())
        return trained


@pytest.fixture(params=VERSIONS)
def lerobot(
    request: pytest.FixtureRequest, client: Callable[[str], Interpreter], exported: Exported, tmp_path: Path
) -> LeRobot:
    """Each version, with the export as its dataset `x`."""
    python = client(request.param).python
    shutil.copytree(exported.path, tmp_path / "local" / "x")
    environ = {"HF_LEROBOT_HOME": str(tmp_path), "HF_HOME": str(tmp_path / "hf"), "WANDB_MODE": "disabled"}
    return LeRobot(request.param, Interpreter(python, environ), tmp_path)


def test_its_loader_reads_every_frame(lerobot: LeRobot, exported: Exported) -> None:
    found, told = lerobot.read("x")
    check_numbers(found, exported.episodes, exported.cameras)
    for camera in exported.cameras:
        assert found[f"camera.extrinsics.{camera}"].shape[1:] == (16,)
        shown, wanted = (
            found[f"observation.images.{camera}"].transpose(0, 2, 3, 1) * 255,
            jpegs(exported.dataset, camera),
        )
        apart = [np.abs(shown - np.roll(wanted, by, axis=0)).mean(axis=(1, 2, 3)) for by in (0, 1, -1)]
        assert apart[0].max() < 5
        assert (apart[0] < np.minimum(apart[1], apart[2])).all()
    joints = np.array([frame["joints"] for episode in exported.episodes for frame in episode], np.float64)
    np.testing.assert_allclose(told["state_mean"], joints.mean(0), atol=1e-9)
    assert told["fps"] == 15.625 and len(told["tasks"]) == 1
    assert told["policy"] == {
        "observation.state": "STATE",
        "action": "ACTION",
        **{f"observation.images.{camera}": "VISUAL" for camera in exported.cameras},
    }


def test_episodes_and_features_are_edited(lerobot: LeRobot, exported: Exported) -> None:
    camera = exported.cameras[-1]
    lerobot.edit("delete_episodes", "--repo_id=local/x", "--new_repo_id=local/less", "--operation.episode_indices=[1]")
    lerobot.edit("split", "--repo_id=local/x", '--operation.splits={"train": [0, 2], "val": [1]}')
    removed = (f"camera.extrinsics.{camera}", f"observation.images.{camera}")
    lerobot.edit(
        "remove_feature", "--repo_id=local/x", "--new_repo_id=local/few", f"--operation.feature_names={list(removed)}"
    )
    lerobot.edit("merge", f"{MERGED[lerobot.name]}=local/more", "--operation.repo_ids=['local/x', 'local/less']")

    whole, _ = lerobot.read("x")
    number = whole["episode_index"]
    for name, kept in {
        "less": [0, 2],
        "x_train": [0, 2],
        "x_val": [1],
        "more": [0, 1, 2, 0, 2],
        "few": [0, 1, 2],
    }.items():
        found, told = lerobot.read(name)
        cameras = exported.cameras[:-1] if name == "few" else exported.cameras
        check_numbers(found, [exported.episodes[k] for k in kept], cameras)
        for key in (f"observation.images.{camera}" for camera in cameras):
            # Equal pixels: nothing was encoded again.
            np.testing.assert_array_equal(found[key], np.concatenate([whole[key][number == k] for k in kept]))
        assert (set(found) & set(removed) == set()) is (name == "few")
        assert set(told["stats"]) == set(json.loads((lerobot.path(name) / "meta/info.json").read_text())["features"])
        joints = np.array([frame["joints"] for k in kept for frame in exported.episodes[k]], np.float64)
        np.testing.assert_allclose(told["state_mean"], joints.mean(0), atol=1e-9)


@pytest.mark.parametrize("edited", [False, True])
def test_training_starts_with_the_joints_as_the_only_state(lerobot: LeRobot, exported: Exported, edited: bool) -> None:
    if edited:
        lerobot.edit(
            "delete_episodes", "--repo_id=local/x", "--new_repo_id=local/less", "--operation.episode_indices=[1]"
        )
        lerobot.edit("merge", f"{MERGED[lerobot.name]}=local/more", "--operation.repo_ids=['local/x', 'local/less']")
    trained = lerobot.train("more" if edited else "x")
    images = {f"observation.images.{camera}" for camera in exported.cameras}
    assert set(trained["input_features"]) == images | {"observation.state"}
    arms = len(exported.episodes[0][0]["joints"]) // 7
    assert trained["input_features"]["observation.state"]["shape"] == [7 * arms]
    assert trained["output_features"]["action"]["shape"] == [8 * arms]


def test_its_doctor_finds_no_failure(client: Callable[[str], Interpreter], exported: Exported) -> None:
    doctor = client("lerobot-doctor")
    done = doctor.call([str(doctor.python.with_name("lerobot-doctor")), "check", str(exported.path)])
    assert "[FAIL]" not in done.stdout, done.stdout
    for check in ("Metadata & Format Compliance", "Temporal Consistency", "Video Integrity", "Feature Consistency"):
        assert f"[PASS] {check}" in done.stdout, done.stdout


def test_yamsim_is_installed_beside_it(
    client: Callable[[str], Interpreter], exported: Exported, tmp_path: Path
) -> None:
    """pip adds yamsim with its extras to LeRobot's packages and replaces none; both run in one environment."""
    alone = client("lerobot")
    both, place = yamsim_beside(alone, tmp_path / "both")
    checked = both.call(["-m", "pip", "check"])
    assert checked.returncode == 0, checked.stdout
    for package in ("av", "numpy", "opencv-python-headless", "pyarrow", "torch"):
        assert both.version(package) == alone.version(package)
    assert not list(place.glob("av-*"))

    done = both.call(
        ["-m", "yamsim_cli", "export", "lerobot", str(exported.dataset), str(tmp_path / "out")], cwd=tmp_path
    )
    assert done.returncode == 0, done.stderr
    both.run("read_lerobot.py", tmp_path / "out", tmp_path / "out.npz", timeout_s=PATIENCE)
    found = np.load(tmp_path / "out.npz")
    check_numbers(found, exported.episodes, exported.cameras)
    assert {key for key in found if key.startswith("camera.")}
