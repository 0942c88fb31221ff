"""Composed scenes in MuJoCo 3.3 and newer and in dm_control: they load, are stable, and move as recorded."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.attempts import all_actions, planned
from tests.clients.environments import Interpreter
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.scene.blueprint import Blueprint, task_blueprint
from yamsim_cli.viewers.show.compose import compose_at_home, first_attempt_start, write_scene

Client = Callable[[str], Interpreter]
# The oldest version that can load composed scenes, the last 3.x, and one between.
OLDER = (
    pytest.param("mujoco-3.3", marks=pytest.mark.client),
    pytest.param("mujoco-3.11", marks=pytest.mark.client_heavy),
    pytest.param("mujoco-3.17", marks=pytest.mark.client),
)

# Name -> rig, task and grasp, boards.
SCENES: dict[str, tuple[str, str | None, str, bool]] = {
    **{rig: (rig, None, "weld", True) for rig in ("single", "single_linear", "bimanual", "russet")},
    **{f"{rig}-bare": (rig, None, "weld", False) for rig in ("single", "single_linear", "russet")},
    "pickplace": ("single", "pickplace", "weld", True),
    "friction": ("single_linear", "pickplace", "contact", True),
    "handover": ("bimanual", "handover", "weld", True),
}
# The replayed ones: a weld, pads that press, and two arms.
EPISODES = ("pickplace", "friction", "handover")
SEED = 8

# rad and m, largest difference of an episode between MuJoCo 3.3 and 4.0, whose contacts and welds differ. An episode
# succeeds within 0.05 m.
MOST = 0.001


def _config(name: str, make_config: Callable[..., RecordConfig]) -> RecordConfig:
    rig, task, grasp, boards = SCENES[name]
    return make_config({("rig",): rig, ("task",): task, ("grasp",): grasp, ("seed",): SEED, ("boards",): boards})


@pytest.fixture(scope="module")
def scenes(
    tmp_path_factory: pytest.TempPathFactory, make_config: Callable[..., RecordConfig], locations: Locations
) -> dict[str, Path]:
    """scene.xml of each, as `compose-xml` writes it by default."""
    folder = tmp_path_factory.mktemp("composed")
    studio = load_config(SceneConfig, "scenes", "studio", locations)
    for name, (rig, task, _, boards) in SCENES.items():
        if task is None:
            loaded = load_config(RigConfig, "rigs", rig, locations)
            spec, model = compose_at_home(Blueprint(loaded, studio, boards=boards), locations)
        else:
            config, home = first_attempt_start(Session(_config(name, make_config), locations))
            spec, model = compose_at_home(task_blueprint(config, boards=boards), locations, home)
        write_scene(spec, model, folder / name, as_zip=False, overwrite=False)
    return {name: folder / name / "scene.xml" for name in SCENES}


@pytest.fixture(scope="module")
def episodes(
    tmp_path_factory: pytest.TempPathFactory, make_config: Callable[..., RecordConfig], locations: Locations
) -> dict[str, Path]:
    """Actions of an episode of each, tick by tick, as in recordings, and its states."""
    folder = tmp_path_factory.mktemp("episodes")
    for name in EPISODES:
        config = _config(name, make_config)
        simulator = Simulator(Session(config, locations))
        done = planned(simulator, SEED)
        assert done.outcome.success, done.outcome
        states, arms, actions = done.recorded_states, simulator.scene.arms, all_actions(done.recorded_states)
        welds = [k for k, arm in enumerate(arms) if arm.weld is not None]
        np.savez(
            folder / f"{name}.npz",
            qpos=states[0].qpos,
            ctrl=actions.ctrl,
            holds=np.array(actions.magnet)[:, welds],
            welds=[f"{arms[k].prefix}grasp_weld" for k in welds],
            hands=[f"{arms[k].prefix}link_6" for k in welds],
            item=simulator.roles.object_of("object"),
            steps=config.task.timing.physics_steps_per_tick,
            frames=[state.qpos for state in states],
            arms=np.concatenate([arm.joint_qpos for arm in arms]),
            objects=[address + k for address in simulator.scene.object_qpos.values() for k in range(3)],
        )
    return {name: folder / f"{name}.npz" for name in EPISODES}


@pytest.mark.parametrize("key", [*OLDER, pytest.param("mujoco-4", marks=pytest.mark.client)])
def test_scenes_load_and_stand_still(key: str, client: Client, scenes: dict[str, Path]) -> None:
    found = client(key).run("mujoco_rest.py", *scenes.values())["scenes"]
    for name, path in scenes.items():
        scene = found[str(path)]
        arms = 2 if name.startswith(("bimanual", "russet", "handover")) else 1
        things = 2 if name in EPISODES else 0
        assert (scene["nq"], scene["nu"]) == (8 * arms + 7 * things, 7 * arms), name
        # Closed crank fingers push each other apart by 0.2 mm, and objects sink into the table by 0.3 mm.
        assert scene["moved"] < 0.0005, name


def _replay(interpreter: Interpreter, scene: Path, episode: Path, out: Path) -> dict[str, np.ndarray]:
    interpreter.run("mujoco_replay.py", scene, episode, out)
    with np.load(out) as found:
        return dict(found)


@pytest.mark.parametrize("name", EPISODES)
@pytest.mark.parametrize("key", OLDER)
def test_an_episode_moves_as_in_mujoco_4(
    name: str, key: str, client: Client, scenes: dict[str, Path], episodes: dict[str, Path], tmp_path: Path
) -> None:
    old = _replay(client(key), scenes[name], episodes[name], tmp_path / "old.npz")
    new = _replay(client("mujoco-4"), scenes[name], episodes[name], tmp_path / "new.npz")
    states = np.abs(old.pop("states") - new.pop("states"))
    # Equal up to the rounding of an inertia's axes, which 3.3 computes in another way.
    for field, value in new.items():
        np.testing.assert_allclose(old[field], value, rtol=0, atol=1e-10, err_msg=field)
    with np.load(episodes[name]) as episode:
        arms, objects = states[:, episode["arms"]], states[:, episode["objects"]]
        moving = states[: np.flatnonzero(episode["holds"].any(axis=1))[0] if episode["holds"].any() else 20]
        free = moving[:, episode["arms"]].max()
    print(
        f"{name}, {key} against mujoco-4: arms {arms.max():.1e} rad, objects {objects.max():.1e} m, any number "
        f"{states.max():.1e}, at the end {states[-1].max():.1e}; arms before the grasp {free:.1e} rad"
    )
    # Nothing touches the arms yet, and no weld holds: only the model could differ.
    assert free < 1e-7
    assert arms.max() < MOST
    assert objects.max() < MOST


@pytest.mark.client
@pytest.mark.parametrize("name", EPISODES)
def test_an_episode_moves_as_it_was_recorded(
    name: str, client: Client, scenes: dict[str, Path], episodes: dict[str, Path], tmp_path: Path
) -> None:
    found = _replay(client("mujoco-4"), scenes[name], episodes[name], tmp_path / "now.npz")
    with np.load(episodes[name]) as episode:
        # The last frame may have fewer ticks.
        frames, every = episode["frames"], -(-len(episode["ctrl"]) // len(episode["frames"]))
    differences = np.abs(found["states"][every - 1 :: every][: len(frames) - 1] - frames[1:])
    print(f"{name}: {differences.max():.1e} from what was recorded")
    # In the composed scene the objects start elsewhere, so MuJoCo rounds their inverse weights differently, by 1e-11. A
    # falling object amplifies that.
    assert differences.max() < 1e-4


@pytest.mark.render
@pytest.mark.parametrize("name", ["single", "friction"])
@pytest.mark.parametrize("key", OLDER)
def test_a_scene_looks_as_in_mujoco_4(
    name: str, key: str, client: Client, scenes: dict[str, Path], tmp_path: Path
) -> None:
    pictures = []
    for number, version in enumerate((key, "mujoco-4")):
        client(version).run("mujoco_picture.py", scenes[name], tmp_path / f"{number}.npy")
        pictures.append(np.load(tmp_path / f"{number}.npy").astype(int))
    assert np.ptp(pictures[0]) > 150, "an empty picture"
    assert np.abs(pictures[0] - pictures[1]).mean() < 0.1


@pytest.mark.client
def test_dm_control_reads_steps_and_attaches_them(client: Client, scenes: dict[str, Path]) -> None:
    bare = [path for name, path in scenes.items() if name.endswith("-bare")]
    found = client("dm_control").run("dm_control_scenes.py", *scenes.values(), "--attach", *bare)
    for path in scenes.values():
        assert found["scenes"][str(path)]["moved"] < 0.0005, path
    assert len(found["attached"]) == 3
    for path, scene in found["attached"].items():
        assert scene["moved"] < 0.0005, path
        assert scene["hand_off"] < 0.0005, path
