"""ABC's simulated evaluation beside `yamsim eval --task abc/put_bottles`: starts, motion and verdicts.

`YAMSIM_ABC` names a checkout of amazon-far/abc. Both environments run the MuJoCo version of the tests.
"""

from __future__ import annotations

import shutil
import struct
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.clients.environments import Interpreter, checkout
from yamsim_cli.abc_evaluation.environment import BOTTLES, GRIPPER_OPENING, PutBottles
from yamsim_cli.abc_evaluation.evaluation import DEFAULT_SEED, DEFAULT_SIZE
from yamsim_cli.abc_evaluation.expert import BottlesExpert
from yamsim_cli.abc_evaluation.trial import EXECUTED_ACTIONS, MAX_ACTIONS, PROMPT

SEQUENCES = 200
ACTIONS = 40  # of each sequence
FILLED_EVERY = 5  # of as many sequences, one begins with all bottles in the bin
HOME = np.array([0, 1.047, 1.047, 0, 0, 0, 0.5] * 2)
PATIENCE_S = 3600  # the machine may be busy

# Visual meshes, which a checkout without its large files lacks. They have no mass and touch nothing.
VISUALS = (
    "assets/i2rt_yam/assets/base_visual_gate.stl",
    "assets/task_water_bottles/bottle/bottle_3/visual/model_normalized_0.obj",
)


def complete_checkout(source: Path, folder: Path) -> Path:
    """Return a checkout with all model files: `source`, or a copy in which tetrahedra replace missing visual meshes."""
    models = Path("assets", "put_bottles")
    missing = [name for name in VISUALS if not (source / models / name).is_file()]
    if not missing:
        return source
    shutil.copytree(source / "abc_minimal", folder / "abc_minimal")
    shutil.copytree(source / models, folder / models)
    corners = [(0.0, 0.0, 0.0), (0.01, 0.0, 0.0), (0.0, 0.01, 0.0), (0.0, 0.0, 0.01)]
    sides = [(0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)]
    triangles = [struct.pack("<12fH", 0, 0, 0, *(x for k in side for x in corners[k]), 0) for side in sides]
    text = [f"v {x} {y} {z}\n" for x, y, z in corners] + [f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in sides]
    contents = {".stl": bytes(80) + struct.pack("<I", len(sides)) + b"".join(triangles), ".obj": "".join(text).encode()}
    for name in missing:
        (folder / models / name).write_bytes(contents[Path(name).suffix])
    return folder


def make_sequences() -> dict[str, np.ndarray]:
    """Return actions (sequences, actions, 14) as ABC's policies send them: independent ones, walks, and presses."""
    rng = np.random.default_rng(7)
    noise = rng.normal(size=(SEQUENCES, ACTIONS, 14))
    sequences = np.arange(SEQUENCES)
    walks = HOME + np.cumsum(0.12 * noise, axis=1)
    actions = np.where(sequences[:, None, None] % 2, walks, HOME + 0.6 * noise)
    # Every third sequence lowers both arms onto the table, turns them, and closes the grippers.
    ramp = np.linspace(0, 1, ACTIONS)[:, None]
    lowered = np.array([0, 2.2, 1.2, -0.6, 0, 0, 0] * 2)
    turns = rng.uniform(-0.8, 0.8, (SEQUENCES, 1, 2))
    press = HOME + ramp * (lowered - HOME) + np.zeros((SEQUENCES, 1, 1))
    press[:, :, [0, 7]] += ramp * turns
    actions = np.where(sequences[:, None, None] % 3 == 0, press, actions)
    actions[:, :, [6, 13]] = np.clip(actions[:, :, [6, 13]], 0, 1)
    return {
        "seeds": DEFAULT_SEED + sequences,
        "filled": sequences % FILLED_EVERY == 0,
        "actions": actions.astype(np.float32),
    }


@pytest.mark.client
def test_its_environment_and_ours_move_and_judge_alike(client: Callable[[str], Interpreter], tmp_path: Path) -> None:
    interpreter = client("abc-environment")
    root = complete_checkout(checkout("YAMSIM_ABC"), tmp_path / "checkout")
    given = make_sequences()
    np.savez(tmp_path / "sequences.npz", **given)  # type: ignore[arg-type]
    told = interpreter.run("abc_acts.py", root, tmp_path / "sequences.npz", tmp_path / "out.npz", timeout_s=PATIENCE_S)
    theirs = np.load(tmp_path / "out.npz")
    assert told["engine"] == mujoco.__version__
    touched = successes = 0
    largest = 0.0
    for k in range(SEQUENCES):
        with PutBottles(root / "assets" / "put_bottles", int(given["seeds"][k])) as scene:
            np.testing.assert_allclose(scene.data.qpos, theirs["qpos"][k, 0], atol=1e-12)
            addresses = np.array([scene.model.joint(f"{name}_joint").qposadr[0] for name in BOTTLES])
            places = addresses[:, None] + np.arange(3)
            parts = parts_of_geoms(scene)
            if given["filled"][k]:
                position = scene.data.qpos[scene.model.joint("bin_joint").qposadr[0] :][:3]
                scene.data.qpos[places] = position + np.outer(np.arange(6), [0, 0, 0.04])
            has_touched = False
            for step, action in enumerate(given["actions"][k]):
                command = action.astype(float).reshape(2, 7)
                command[:, -1] *= GRIPPER_OPENING
                scene.step(command)
                has_touched |= touches_a_bottle(scene, parts)
                offsets = scene.data.qpos[places] - theirs["qpos"][k, step + 1][places]
                error = float(np.linalg.norm(offsets, axis=1).max())
                largest = max(largest, error)
                assert error == 0.0, (k, step)  # both have the same engine
                assert scene.in_bin().tolist() == theirs["in_bin"][k, step].tolist(), (k, step)
            shares = scene.joints / ([1] * 6 + [GRIPPER_OPENING])
            shares[:, -1] = np.clip(shares[:, -1], 0, 1)
            np.testing.assert_allclose(shares.ravel(), theirs["state"][k, -1], atol=1e-3)
            assert (scene.has_succeeded, scene.most_in_bin) == (theirs["success"][k], theirs["most"][k])
            touched, successes = touched + has_touched, successes + scene.has_succeeded
    print(f"largest difference of a bottle {largest:g} m; an arm touched one in {touched}; {successes} succeeded")
    assert touched >= SEQUENCES // 10
    assert SEQUENCES // 20 <= successes < SEQUENCES // 2  # most bottles that overlap at first push each other out
    assert (told["keys"], told["prompt"]) == (["images", "prompt", "state"], PROMPT)
    assert (told["cameras"], tuple(told["size"])) == (["top", "left", "right"], DEFAULT_SIZE)
    assert (told["seed"], told["actions"], told["execute"]) == (DEFAULT_SEED, MAX_ACTIONS, EXECUTED_ACTIONS)


@pytest.mark.client
def test_its_environment_counts_the_bottles_of_our_expert(client: Callable[[str], Interpreter], tmp_path: Path) -> None:
    interpreter = client("abc-environment")
    root = complete_checkout(checkout("YAMSIM_ABC"), tmp_path / "checkout")
    expert, commands, masks = BottlesExpert(), [], []
    with PutBottles(root / "assets" / "put_bottles", DEFAULT_SEED) as scene:
        expert.set_scene(scene)
        expert.reset()
        for _ in range(2):
            poses = {f"T_{name}_in_world": T for name, T in scene.object_poses().items()}
            for row in expert({"joints": scene.joints.ravel(), **poses})["ctrl"]:
                # As shares in float32, as ABC's policies send them.
                share = (row.reshape(2, 7) / ([1] * 6 + [GRIPPER_OPENING])).astype(np.float32)
                scene.step(share.astype(float) * ([1] * 6 + [GRIPPER_OPENING]))
                commands.append(share.ravel())
                masks.append(scene.in_bin().tolist())
        most = scene.most_in_bin
    given = {"seeds": [DEFAULT_SEED], "filled": [False], "actions": [commands]}
    np.savez(tmp_path / "sequences.npz", **{key: np.array(value) for key, value in given.items()})  # type: ignore[arg-type]
    interpreter.run("abc_acts.py", root, tmp_path / "sequences.npz", tmp_path / "out.npz", timeout_s=PATIENCE_S)
    theirs = np.load(tmp_path / "out.npz")
    assert theirs["in_bin"][0].tolist() == masks
    assert theirs["most"][0] == most >= 1
    assert any(masks[-1])


def parts_of_geoms(scene: PutBottles) -> list[str]:
    """Return the arm, the bottle or the other body of the world of each geom."""
    roots = scene.model.body_rootid[scene.model.geom_bodyid]
    return [scene.model.body(int(root)).name for root in roots]


def touches_a_bottle(scene: PutBottles, parts: list[str]) -> bool:
    """Whether an arm touches a bottle now."""
    pairs = ({parts[one], parts[other]} for one, other in scene.data.contact.geom)
    return any(pair & {"left_arm", "right_arm"} and pair & set(BOTTLES) for pair in pairs)
