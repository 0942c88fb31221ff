"""Scenes of the benchmark as program tasks: their conversion, and the same verdicts as the benchmark's."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

pytest.importorskip("inspect_robots", reason="needs yamsim[inspect]")
pytest.importorskip("kitchenbench", reason="needs yamsim[inspect]")

from inspect_robots.rollout import derive_seed
from kitchenbench import tasks
from kitchenbench.sim import build_blueprint, make_success_checker

from tests.attempts import all_actions
from tests.kitchenbench.realizations import blueprint_of
from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.config.goals.goal import Goal
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.reader import read_recording_config
from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode
from yamsim_cli.core.episode.execution import simulate_expert
from yamsim_cli.core.episode.expert import arm_sides
from yamsim_cli.core.episode.sampling import sample_attempt
from yamsim_cli.core.episode.simulator import SimulatorCache
from yamsim_cli.core.errors import UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import pose
from yamsim_cli.core.sim.sim_world import SimWorld, make_sim_world
from yamsim_cli.core.workers.stop_request import StopRequest
from yamsim_cli.datasets.verify import EpisodeVerifier, Tolerances
from yamsim_cli.kitchen_scenes import resolve_scene_task
from yamsim_cli.kitchenbench.benchmark_scene import build_benchmark_scene
from yamsim_cli.kitchenbench.lids import LID
from yamsim_cli.kitchenbench.object_poses import AHEAD, BESIDE
from yamsim_cli.kitchenbench.scene_goals import goal_data
from yamsim_cli.kitchenbench.scene_stepper import SceneStepper
from yamsim_cli.kitchenbench.success_judges import KitchenJudge
from yamsim_cli.recording.collect import RecordCallbacks
from yamsim_cli.recording.executor_factories import inline_executor
from yamsim_cli.recording.recorder import record
from yamsim_cli.recording.recording_output import RecordingOutput
from yamsim_cli.session_opener import SessionOpener

SCENE = next(scene for scene in tasks.TASK_FACTORIES["stack"]().scenes if scene.id == "stack-tight-spacing")
NAME = "kitchenbench/stack/tight-spacing"


@pytest.fixture(scope="module")
def task() -> dict[str, Any]:
    found = resolve_scene_task(NAME)
    assert isinstance(found, dict)
    return found


@pytest.fixture(scope="module")
def session(task: dict[str, Any], locations: Locations) -> Session:
    return _session(task, locations)


def _session(task: dict[str, Any], locations: Locations) -> Session:
    opener = SessionOpener(os.environ, lambda text: None, "--{}".format)
    config = opener.load_record_config("default", locations, task=task, n=1, workers=1, size="32x24", quality="fast")
    return Session(config, locations).without_meshes()


@pytest.fixture(scope="module")
def simulators(session: Session) -> Iterator[SimulatorCache]:
    with SimulatorCache(session) as made:
        yield made


def test_a_scene_becomes_a_task_with_its_realizations(task: dict[str, Any]) -> None:
    assert task["phrasings"]["training"] == ["stack the cups"] and task["rig"] == "yam_station_linear_4310_d405"
    first, names = task["arrangements"][0], list(task["things"])
    assert first["seed"] == derive_seed(0, SCENE.init_seed, 0)
    for one in task["arrangements"]:
        blueprint = build_blueprint(SCENE, one["seed"])
        assert [item.name for item in blueprint.objects] == names
        for item in blueprint.objects:
            x, y, _ = one["places"][item.name]
            assert (x, y) == pytest.approx((AHEAD + item.y_cm / 100, BESIDE - item.x_cm / 100), abs=1e-5)
    seeds = [one["seed"] for one in task["arrangements"]]
    assert len(set(seeds)) == len(seeds) == 100


@pytest.mark.slow
def test_another_realization_may_have_other_things(task: dict[str, Any]) -> None:
    others = [resolve_scene_task(f"{NAME}@{k}") for k in (1, 2, 3)]
    counts = {len(one["things"]) for one in (*others, task) if isinstance(one, dict)}
    assert counts == {2, 3}


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("kitchenbench/stak/cups", "unknown task 'stak'; did you mean 'stack'?"),
        ("kitchenbench/stack/cubs", "stack has no scene 'cubs'; did you mean 'cups'?"),
        ("kitchenbench/stack/cups@two", "'two' is not a realization; give a whole number"),
        ("kitchenbench/fold_cloth/", "fold_cloth has no scene ''"),
    ],
)
def test_a_scene_that_cannot_be_recorded_is_refused(name: str, said: str) -> None:
    with pytest.raises(UsageError) as caught:
        resolve_scene_task(name)
    assert str(caught.value).startswith(f"{name}: ") and said in str(caught.value)


# One scene for each task whose goal requires at least what the checker requires: its predicate, and its last skill.
OTHER_TASKS = {
    "sort_cutlery/sparse@3": ("in", "sort"),
    "fold_cloth/napkin-half": ("folded_small", "fold_small"),
    "open_container/snap-lid": ("open", "open_lid"),
    "seal_container/tight-fit": ("over", "place"),
    "pour_pasta/narrow-cup": ("contains", "pour"),
    "scoop_pasta/rigatoni-large": ("contains", "scoop"),
    "place_in_rack/plate": ("in", "place"),
}
# The same for a scene in which the checker is satisfied only while the cutlery falls.
ALL_TASKS = {**OTHER_TASKS, "place_cutlery/from-drawer": ("on", "place")}


@pytest.mark.parametrize("name", ALL_TASKS)
def test_every_kind_of_goal_becomes_a_task(name: str, locations: Locations) -> None:
    found = resolve_scene_task(f"kitchenbench/{name}")
    assert isinstance(found, dict)
    assert {key for clause in found["goal"]["all"] for key in clause} == {ALL_TASKS[name][0]}
    assert list(found["expert"][-1]) == [ALL_TASKS[name][1]]
    assert len(found["arrangements"]) > 1
    _session(found, locations)  # the config is valid


def test_a_large_cloth_gets_a_larger_table(locations: Locations) -> None:
    found = resolve_scene_task("kitchenbench/fold_cloth/large-cloth")
    assert isinstance(found, dict)
    table = _session(found, locations).config.widened_table
    low, high = (np.array(table.position) + sign * np.array(table.half_size) for sign in (-1, 1))
    for one in found["arrangements"]:
        x, y, _ = one["places"]["cloth"]
        # Half the diagonal of a square of 60 cm, and the border.
        assert ((np.array((x, y)) - 0.47 >= low[:2]) & (np.array((x, y)) + 0.47 <= high[:2])).all()


def test_attempts_go_through_all_realizations(simulators: SimulatorCache, task: dict[str, Any]) -> None:
    starts = set()
    for number in range(4):
        job = AttemptJob(0, number)
        attempt = sample_attempt(simulators.get(job), job)
        assert attempt.layout is not None
        x, y, _ = attempt.layout.T_in_world["cup_1"][:3, 3]
        starts.add(min(range(100), key=lambda k: _off(task["arrangements"][k], (x, y))))
        assert min(_off(one, (x, y)) for one in task["arrangements"]) < 1e-3
    assert len(starts) == 4


def _off(arrangement: dict[str, Any], place: tuple[float, float]) -> float:
    return float(np.linalg.norm(np.subtract(arrangement["places"]["cup_1"][:2], place)))


class Queries:
    """Queries of the benchmark's checker, on a recorded task's state; `filled`: substance -> the object it fills."""

    def __init__(self, world: SimWorld, filled: Mapping[str, str] | None = None) -> None:
        self._world, self._filled = world, filled or {}
        self.aabb, self.contained_fraction = world.aabb, world.volume_fraction_in_box

    def contained_mass_g(self, substance: str, container: str) -> float:
        return self._world.grams_inside(self._filled[substance], container)

    def opening_fraction(self, name: str) -> float:
        return self._world.joint_opening(name, LID)


@pytest.mark.slow
def test_the_goal_holds_when_the_benchmarks_checker_says_so(simulators: SimulatorCache, task: dict[str, Any]) -> None:
    job = AttemptJob(0, 0)
    simulator = simulators.get(job)
    done = simulate_expert(simulator, sample_attempt(simulator, job))
    assert done.outcome.success, done.outcome
    scene, goal = simulator.scene, simulator.config.task.goal
    data = mujoco.MjData(scene.model)
    world = SimWorld(scene.model, data, scene.arms, arm_sides(simulator.config), list(scene.object_qpos))
    checker = make_success_checker(build_blueprint(SCENE, task["arrangements"][0]["seed"]), Queries(world))  # type: ignore[arg-type]
    agreed = []
    for state in done.recorded_states[::5]:
        data.qpos[:] = state.qpos
        mujoco.mj_forward(scene.model, data)
        ours = all(measure.holds for measure in goal.measures(world, simulator.roles))
        assert ours == checker(Queries(world)).success  # type: ignore[arg-type]
        agreed.append(ours)
    assert not agreed[0] and agreed[-1]
    assert len(all_actions(done.recorded_states).ctrl) > 100


@pytest.mark.slow
@pytest.mark.parametrize("name", OTHER_TASKS)
def test_other_goals_hold_only_when_the_benchmarks_checker_says_so(name: str, locations: Locations) -> None:
    """A yamsim goal may need more: the object out of the hand."""
    data = resolve_scene_task(f"kitchenbench/{name}")
    assert isinstance(data, dict)
    path, _, epoch = name.partition("@")
    scene_id = path.replace("_", "-").replace("/", "-")
    scene = next(one for one in tasks.TASK_FACTORIES[path.partition("/")[0]]().scenes if one.id == scene_id)
    # The task's name gives the realization, and the realization gives the amounts in the goal.
    blueprint = build_blueprint(scene, derive_seed(0, scene.init_seed, int(epoch or 0)))
    filled = {item.name: item.parent or item.name for item in blueprint.objects}
    with SimulatorCache(_session(data, locations)) as simulators:
        for number in range(3):
            simulator = simulators.get(AttemptJob(0, number))
            done = simulate_expert(simulator, sample_attempt(simulator, AttemptJob(0, number)))
            if done.outcome.success:
                break
        scene_model = simulator.scene
        state = mujoco.MjData(scene_model.model)
        world = make_sim_world(scene_model, state, arm_sides(simulator.config))
        scene_model.reset(state, done.recorded_states[0].qpos)
        world.store_start()
        checker = make_success_checker(blueprint, Queries(world, filled))  # type: ignore[arg-type]
        found = []
        for recorded in done.recorded_states[::5]:
            state.qpos[:] = recorded.qpos
            mujoco.mj_forward(scene_model.model, state)
            ours = all(measure.holds for measure in simulator.config.task.goal.measures(world, simulator.roles))
            assert checker(Queries(world, filled)).success or not ours  # type: ignore[arg-type]
            found.append(ours)
        assert not found[0] and found[-1]


@pytest.mark.parametrize(
    ("name", "verdict"),
    [("from-drawer", "cutlery is not resting on plate"), ("cluttered-bench", "fork rests on dishware")],
)
def test_cutlery_at_rest_on_a_dish_reaches_the_goal(name: str, verdict: str, base: Session) -> None:
    """The checker agrees on a bowl, across which a fork rests on the rim. On a plate, it measures from the rim too."""
    scenes = {scene.id: scene for scene in tasks.TASK_FACTORIES["place_cutlery"]().scenes}
    realized = build_benchmark_scene(blueprint_of(scenes[f"place-cutlery-{name}"]), base)
    try:
        blueprint, scene = realized.blueprint, realized.simulator.scene
        item, dish = blueprint.roles["item"][0], blueprint.roles["surface"][0]
        goal = Goal.model_validate(goal_data(blueprint))
        motion = SceneStepper(realized, 10)
        judge, world = KitchenJudge(realized, motion), motion.episode.world
        start, middle, rim = motion.data.qpos.copy(), world.pose(dish)[:2, 3], world.aabb(dish)[1][2]

        def is_goal_reached(x: float, y: float, height: float, seconds: float) -> bool:
            """Put the item at an offset from the dish's middle, over its rim, let it fall, and evaluate the goal."""
            qpos = start.copy()
            scene.set_object_pose(qpos, item, pose((middle[0] + x, middle[1] + y, rim + height)))
            scene.reset(motion.data, qpos)
            scene.step(motion.data, round(seconds / scene.model.opt.timestep))
            mujoco.mj_forward(scene.model, motion.data)
            return all(measure.holds for measure in goal.measures(world, realized.simulator.roles))

        assert is_goal_reached(0.0, 0.0, 0.005, 3.0)
        assert judge.evaluate()[1].startswith(verdict)
        assert not is_goal_reached(0.0, 0.25, 0.005, 3.0)
        assert judge.evaluate() == (False, f"{item} is not over {dish}")
        # While it falls, only the checker is satisfied.
        assert not is_goal_reached(0.0, 0.0, 0.015, 0.0)
        assert judge.evaluate()[0]
    finally:
        realized.simulator.close()


@pytest.mark.slow
def test_cutlery_is_put_onto_a_napkin_that_bends(locations: Locations) -> None:
    scene = next(scene for scene in tasks.TASK_FACTORIES["place_cutlery"]().scenes if scene.id.endswith("napkin-soft"))
    task = resolve_scene_task("kitchenbench/place_cutlery/napkin-soft")
    assert isinstance(task, dict) and task["things"]["napkin"]["of"][0]["cloth"]["size_mm"] == [200.0, 200.0]
    with SimulatorCache(_session(task, locations)) as simulators:
        simulator = simulators.get(AttemptJob(0, 0))
        attempt = sample_attempt(simulator, AttemptJob(0, 0))
        done = simulate_expert(simulator, attempt)
        assert done.outcome.success, done.outcome
        data = mujoco.MjData(simulator.scene.model)
        simulator.scene.reset(data, done.recorded_states[-1].qpos)
        world = make_sim_world(simulator.scene, data, arm_sides(simulator.config))
        checker = make_success_checker(build_blueprint(scene, task["arrangements"][0]["seed"]), Queries(world))  # type: ignore[arg-type]
        assert checker(Queries(world)).success  # type: ignore[arg-type]
        # The fork lies on the fabric, released, and did not go through it.
        assert world.are_touching("cutlery", "napkin") and not world.holding_sides("cutlery")
        assert not world.are_touching("cutlery", "table")


@pytest.mark.slow
@pytest.mark.render
@pytest.mark.parametrize("name", ["stack/tight-spacing", *ALL_TASKS])
def test_what_is_recorded_is_made_again_without_the_benchmark(
    name: str, locations: Locations, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = resolve_scene_task(f"kitchenbench/{name}")
    assert isinstance(data, dict)
    session, out = _session(data, locations), tmp_path / "dataset"
    watch = RecordCallbacks(lambda done, wanted, attempts: None, lambda text: None)
    record(session, RecordingOutput(out, ExistingDatasetMode.NEW), inline_executor, watch, StopRequest())
    monkeypatch.setitem(__import__("sys").modules, "kitchenbench", None)
    again = Session(read_recording_config(out, locations), locations).without_meshes()
    with EpisodeVerifier(again, Tolerances(0.0, 0.0)) as verifier:
        verdict = verifier.run((0, out / "ep_000000"))
    assert verdict.is_reproduced, verdict
