"""ABC's task `put_bottles` in a miniature of its scene.

`tests/clients/test_abc_environment.py` compares it with the original.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import nullcontext
from io import StringIO
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from rich.console import Console

from tests.abc_evaluation.miniature import write_miniature
from yamsim_cli.abc_evaluation import evaluation, model_files
from yamsim_cli.abc_evaluation.environment import ACTION_SECONDS, BOTTLES, GRIPPER_OPENING, PutBottles
from yamsim_cli.abc_evaluation.evaluation import DEFAULT_SEED, BottlesEvaluation, require_supported_flags
from yamsim_cli.abc_evaluation.expert import BottlesExpert, Waypoint, grasp_pose, interpolate
from yamsim_cli.abc_evaluation.model_files import find_model_folder, git_tree_id
from yamsim_cli.abc_evaluation.start import sample_start
from yamsim_cli.abc_evaluation.trial import EXECUTED_ACTIONS, PROMPT, STATION, BottlesTrialRunner
from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.policy import PolicyConfig
from yamsim_cli.core.errors import ResourceError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import pose, rotation_z
from yamsim_cli.core.workers.executors import InlineExecutor, J, R
from yamsim_cli.kitchen_scenes import ABC_TASK, resolve_scene_task
from yamsim_cli.policies.action_chunks import ChunkSettings
from yamsim_cli.policies.evaluate.policy_choice import PolicyChoice
from yamsim_cli.policies.evaluate.policy_trial import TrialEnd
from yamsim_cli.policies.external_policy import MappedPolicy
from yamsim_cli.terminal.trial_tables import evaluation_table

HERE = Path(__file__).parents[2]
THIS = "tests.abc_evaluation.test_put_bottles"
SIZE = (32, 24)


class Waving:
    """Sends chunks of 30 actions that turn the first joint, and remembers its observations."""

    images: tuple[str, ...] = ()
    wants = ("objects", "velocities")
    seen: ClassVar[list[Mapping[str, Any]]] = []

    def reset(self, seed: int) -> None:
        self.seen.clear()
        self.seed = seed

    def __call__(self, observation: Mapping[str, Any]) -> Mapping[str, Any]:
        self.seen.append(dict(observation))
        ctrl = np.tile(observation["joints"], (30, 1))
        ctrl[:, 0] += 0.01 * np.arange(1, 31)
        return {"ctrl": ctrl, "period": 1 / 30}


class Broken(Waving):
    def __call__(self, observation: Mapping[str, Any]) -> Mapping[str, Any]:
        return {"ctrl": [0.0] * 13}


class Done(Waving):
    def __call__(self, observation: Mapping[str, Any]) -> Mapping[str, Any]:
        return {"ctrl": np.tile(observation["joints"], (3, 1)), "done": True}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_miniature(tmp_path_factory.mktemp("miniature"))


def choose(name: str, **given: Any) -> PolicyChoice:
    return PolicyChoice(f"{THIS}:{name}", HERE, **given)


def run(folder: Path, choice: PolicyChoice, locations: Locations) -> Any:
    with BottlesTrialRunner(folder, choice, SIZE, locations) as runner:
        return runner.run(AttemptJob(3, 1))


def test_a_folder_has_the_id_that_git_gives_it(tmp_path: Path) -> None:
    """The id is from `git write-tree`; in git's order, `a.b` comes before the folder `a`, and `a0` after it."""
    for name, text in {"a/c": "x", "a.b": "hello\n", "a0": "", "b/d": "y"}.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    assert git_tree_id(tmp_path) == "e89acba3f8b703f502658385d8b48b3b3a4f999d"


def test_model_files_are_those_of_the_commit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ResourceError, match="YAMSIM_ABC is not set: clone the repository amazon-far/abc, check out"):
        find_model_folder({})
    with pytest.raises(ResourceError, match="YAMSIM_ABC: there is no folder"):
        find_model_folder({"YAMSIM_ABC": str(tmp_path)})
    folder = write_miniature(tmp_path / "assets" / "put_bottles")
    with pytest.raises(ResourceError, match=r"differs from commit e5e1fbc of amazon-far/abc: its git tree is \w{40}"):
        find_model_folder({"YAMSIM_ABC": str(tmp_path)})
    monkeypatch.setattr(model_files, "MODEL_TREE", git_tree_id(folder))
    assert find_model_folder({"YAMSIM_ABC": str(tmp_path)}) == folder
    (folder / "solid.obj").write_text("v 0 0 0\n")
    with pytest.raises(ResourceError, match="differs from commit"):
        find_model_folder({"YAMSIM_ABC": str(tmp_path)})


def test_a_folder_of_many_files_is_refused(tmp_path: Path) -> None:
    for k in range(1001):
        (tmp_path / str(k)).touch()
    with pytest.raises(ResourceError, match="more than 1000 files"):
        git_tree_id(tmp_path)


def test_a_seed_gives_the_start_of_abcs_environment() -> None:
    """The numbers are from `PutBottlesEnv.reset` of amazon-far/abc e5e1fbc with its default seed."""
    start = sample_start(DEFAULT_SEED)
    scales = [1.096537, 0.996635, 1.010374, 1.018132, 1.016419, 0.954445]
    np.testing.assert_allclose(start.bottle_scales, scales, atol=1e-6)
    assert start.bin_scale == pytest.approx(1.012373899)
    bin_pose = [0.708946, -0.009068, 0.840270, 0.700178, 0.700178, -0.098744, -0.098744]
    np.testing.assert_allclose(start.bin_pose, bin_pose, atol=1e-6)
    first, last = start.bottles[0], start.bottles[-1]
    np.testing.assert_allclose(first, [0.535756, 0.4152, 0.783145, 0.598044, 0.377284, 0.598044, -0.377284], atol=1e-6)
    np.testing.assert_allclose(
        last, [0.306632, -0.597791, 0.775829, 0.707102, 0.002487, 0.707102, -0.002487], atol=1e-6
    )


def test_sizes_are_those_of_the_start(folder: Path) -> None:
    """ABC samples a size for the sixth bottle, too, but its meshes are not scaled."""
    with PutBottles(folder, DEFAULT_SEED) as scene:
        extents = {
            scene.model.mesh(k).name: float(np.ptp(mesh_vertices(scene, k), axis=0).max())
            for k in range(scene.model.nmesh)
        }
    start = scene.start
    wanted = {f"bottle_{k}_shape": start.bottle_scales[k] for k in range(5)}
    wanted |= {"bottle_7_shape": 1.0, "water_bottle_bin": start.bin_scale}
    reference = extents["bottle_7_shape"]
    assert {name: extent / reference for name, extent in extents.items()} == pytest.approx(wanted, rel=1e-5)


def mesh_vertices(scene: PutBottles, k: int) -> np.ndarray:
    first, count = scene.model.mesh_vertadr[k], scene.model.mesh_vertnum[k]
    found: np.ndarray = scene.model.mesh_vert[first : first + count]
    return found


def test_an_action_lasts_34_ms_and_moves_the_arms(folder: Path) -> None:
    with PutBottles(folder, 0) as scene:
        start = scene.joints
        np.testing.assert_allclose(start, [[0, 1.047, 1.047, 0, 0, 0, 0]] * 2, atol=1e-6)
        command = start.copy()
        command[0, 3], command[1, 6] = 0.4, GRIPPER_OPENING
        for _ in range(100):
            scene.step(command)
        assert scene.data.time == pytest.approx(100 * ACTION_SECONDS)
        np.testing.assert_allclose(scene.joints, command, atol=2e-3)
        assert scene.actions == 100


@pytest.mark.parametrize(
    ("offset", "inside"),
    [
        ((0.154, 0, 0), True),
        ((0.156, 0, 0), False),
        ((0.11, 0.11, 0), False),
        ((0, 0, -0.059), True),
        ((0, 0, -0.061), False),
        ((0, 0, 0.259), True),
        ((0, 0, 0.261), False),
    ],
)
def test_a_bottle_is_in_the_bin_within_a_cylinder(folder: Path, offset: tuple[float, ...], inside: bool) -> None:
    with PutBottles(folder, 0) as scene:
        assert not scene.in_bin().any()
        address = scene.model.joint("bottle_4_joint").qposadr[0]
        scene.data.qpos[address : address + 3] = scene.start.bin_pose[:3] + offset
        assert scene.in_bin().tolist() == [name == "bottle_4" and inside for name in BOTTLES]


def test_success_is_all_bottles_in_the_bin_at_once_and_remains(folder: Path) -> None:
    with PutBottles(folder, 0) as scene:
        addresses = [scene.model.joint(f"{name}_joint").qposadr[0] for name in BOTTLES]
        away = scene.data.qpos[addresses[0] : addresses[0] + 3].copy()
        for address in addresses:
            assert not scene.has_succeeded
            scene.data.qpos[address : address + 3] = scene.start.bin_pose[:3]
            scene.step(scene.joints)
        assert scene.has_succeeded
        assert scene.most_in_bin == 6
        scene.data.qpos[addresses[0] : addresses[0] + 3] = away
        scene.step(scene.joints)
        assert scene.in_bin().tolist() == [False] + [True] * 5
        assert (scene.has_succeeded, scene.most_in_bin) == (True, 6)


def test_a_trial_executes_15_actions_of_a_chunk_until_its_limit(folder: Path, locations: Locations) -> None:
    result = run(folder, choose("Waving", time_limit=50 * ACTION_SECONDS), locations)
    assert (result.ended, result.success, result.actions) == (TrialEnd.TIME_LIMIT, False, 50)
    assert result.start_seed == 4
    times = [observation["time"] for observation in Waving.seen]
    assert times == pytest.approx([k * ACTION_SECONDS for k in (0, 15, 30, 45)])
    assert result.chunk_stats.actions == 120
    assert result.chunking.execute == EXECUTED_ACTIONS
    first = Waving.seen[0]
    assert first["prompt"] == PROMPT
    assert first["joints"].shape == first["joint_velocities"].shape == (14,)
    assert first["ee_pose_world"].shape == (2, 4, 4)
    np.testing.assert_allclose(first["T_bottle_2_in_world"][:3, 3], sample_start(4).bottles[1, :3])
    T_cam = np.diag([1.0, -1.0, -1.0, 1.0])  # looks down from a height of 2 m
    T_cam[2, 3] = 2.0
    np.testing.assert_allclose(first["T_cam_in_world"], T_cam, atol=1e-12)


def test_execute_and_done_apply(folder: Path, locations: Locations) -> None:
    once = choose("Waving", time_limit=3 * ACTION_SECONDS, chunking=ChunkSettings(execute=1))
    assert run(folder, once, locations).chunk_stats.chunks == 3
    result = run(folder, choose("Done"), locations)
    assert (result.ended, result.success, result.actions) == (TrialEnd.DONE, False, 3)


def test_a_fault_of_the_policy_ends_its_trial(folder: Path, locations: Locations) -> None:
    result = run(folder, choose("Broken"), locations)
    assert (result.ended, result.success) == (TrialEnd.INVALID, False)
    assert result.fault.text == "ctrl has the shape (13,), not (14,), or (1 to 1000 actions, 14)"


def test_a_policy_that_needs_another_scene_is_refused(
    folder: Path, locations: Locations, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("yamsim_cli.abc_evaluation.trial.make_policy", lambda *_: Privileged())
    with pytest.raises(UsageError, match="--policy replay:dataset: no dataset of put_bottles exists"):
        run(folder, PolicyChoice("replay:dataset", HERE), locations)


class Privileged(Waving):
    def prepare_trial(self, trial: object) -> None: ...


def test_the_expert_acts_in_its_trials(folder: Path, locations: Locations, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(BottlesExpert, "__call__", lambda self, seen: {"ctrl": seen["joints"], "done": True})
    result = run(folder, PolicyChoice("scripted", HERE), locations)
    assert (result.ended, result.actions, result.chunking.execute) == (TrialEnd.DONE, 1, 1000)


def test_the_experts_hand_points_down_with_its_fingers_beside_the_bottle() -> None:
    lying = pose((0.5, 0.2, 0.78), rotation_z(0.7) @ [[0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    T = grasp_pose(lying)
    np.testing.assert_allclose(T[:3, 2], [0, 0, -1])
    np.testing.assert_allclose(T[:3, 0], lying[:3, 2], atol=1e-12)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1)
    np.testing.assert_allclose(T[:2, 3] - lying[:2, 3], 0.075 * lying[:2, 2])
    standing = grasp_pose(pose((0.5, 0.2, 0.75)))
    np.testing.assert_allclose(standing[:3, 2], [0, 0, -1])


def test_the_expert_keeps_to_its_speed_and_moves_one_arm() -> None:
    command = np.zeros((2, 7))
    path = [Waypoint(np.full(6, 0.6), 0.0, 1.5, 3), Waypoint(np.full(6, 0.6), GRIPPER_OPENING, 1.5)]
    rows = interpolate(command, 1, path).reshape(-1, 2, 7)
    np.testing.assert_array_equal(rows[:, 0], 0)
    np.testing.assert_allclose(rows[-1, 1], [0.6] * 6 + [GRIPPER_OPENING])
    speeds = 30 * np.abs(np.diff(rows[:, 1, :6], axis=0)).max(axis=1)
    assert 1.5 < speeds.max() < 1.5 * np.pi / 2  # the mean speed of a motion is the waypoint's
    assert len(rows) == 12 + 3 + 12


class RecordingClient:
    """Answers with the present state of the arms, 30 times."""

    def __init__(self) -> None:
        self.asked: list[Mapping[str, Any]] = []

    def begin_trial(self, seed: int) -> None:
        pass

    def infer(self, message: Mapping[str, Any]) -> Mapping[str, Any]:
        self.asked.append(message)
        return {"actions": np.tile(message["state"], (30, 1))}

    def close(self) -> None:
        pass


@pytest.mark.render
def test_servers_of_abcs_policies_get_the_keys_of_its_own_loop(
    folder: Path, locations: Locations, monkeypatch: pytest.MonkeyPatch
) -> None:
    client = RecordingClient()
    mapping = load_config(PolicyConfig, "policies", "maker", locations)
    monkeypatch.setattr(
        "yamsim_cli.abc_evaluation.trial.make_policy", lambda *_: MappedPolicy(client, mapping, STATION)
    )
    result = run(folder, PolicyChoice("ws://recorded", HERE, time_limit=16 * ACTION_SECONDS), locations)
    assert len(client.asked) == 2, result
    message = client.asked[0]
    assert {key: getattr(value, "shape", None) for key, value in message.items() if key != "images"} == {
        "state": (14,),
        "prompt": None,
    }
    assert message["prompt"] == PROMPT
    assert {key: image.shape for key, image in message["images"].items()} == dict.fromkeys(
        ("top", "left", "right"), (24, 32, 3)
    )


class Inline(InlineExecutor[J, R]):
    def __init__(self, factory: Any, workers: int, seconds: float) -> None:
        super().__init__(factory)


def evaluate(folder: Path, locations: Locations, choice: PolicyChoice, *others: str, seed: int = 5) -> Any:
    job = BottlesEvaluation(folder, locations, 2, seed, 1, SIZE, 60.0, lambda: nullcontext(lambda *_: None))
    return job.evaluate(choice, others)


def test_a_report_has_the_form_of_other_evaluations(
    folder: Path, locations: Locations, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(evaluation, "ProcessPool", Inline)
    choice = choose("Waving", time_limit=2 * ACTION_SECONDS)
    report, others = evaluate(folder, locations, choice, f"{THIS}:Broken")
    assert [trial["start_seed"] for trial in report["trials"]] == [5, 6]
    assert report["stats"]["causes"] == {"bottles_left": 2}
    assert others[0]["stats"]["causes"] == {"policy_invalid": 2}
    assert report["compared"][0]["neither"] == 2
    assert report["settings"]["engine"].startswith("MuJoCo ")
    assert report["trials"][0]["layout"].keys() == {*BOTTLES, "bin"}
    console = Console(width=200, file=StringIO())
    console.print(evaluation_table(report))
    assert "at most 0.00, and 0.00 at the end (means of the trials)" in console.file.getvalue()


@pytest.mark.parametrize(("given", "told"), [({"seed": -1}, "--seed -1"), ({"workers": 0}, "--workers 0")])
def test_numbers_that_are_too_small_are_refused(given: dict[str, int], told: str, locations: Locations) -> None:
    values = {"n": 1, "seed": 0, "workers": 1} | given
    with pytest.raises(UsageError, match=told):
        BottlesEvaluation(HERE, locations, **values, size=SIZE, trial_seconds=1.0, watch=nullcontext)  # type: ignore[arg-type]


def test_what_does_not_apply_is_refused() -> None:
    require_supported_flags({"--rig": None})
    with pytest.raises(UsageError, match="--rig is not for --task abc/put_bottles"):
        require_supported_flags({"--scene": None, "--rig": "single"})
    with pytest.raises(UsageError, match="only `yamsim eval` runs it"):
        resolve_scene_task(ABC_TASK)
