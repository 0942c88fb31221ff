from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..attempt_data import Attempt, AttemptJob, ObjectLayout
from ..config.goals.world import TABLE
from ..config.recording import RecordConfig
from ..config.session import Session
from ..config.variation import RandomizationSample
from ..expert.planning.arm_solvers import start_postures
from ..files.documents.config_base import ConflictError
from ..geometry.se3 import Array, pose
from ..scene.compiled import CompiledScene
from ..scene.random_streams import Stream, random_generator
from ..scene.randomization_sampling import sample_randomization
from ..scene.start_sampling import LocalBoxFunction, ObjectPlacement, sample_phrasing, sample_placements
from ..sim.cloth import crumple_cloth
from ..sim.settling import settle_objects
from ..sim.sim_world import make_sim_world
from .episode_rules import EpisodeRules
from .expert import arm_sides
from .simulator import Simulator, SimulatorCache, open_episode

MAX_DRAWS = 20  # samples of the start, after which an attempt has no start because the goal already held in each
_MAX_START_SPEED = 0.1  # m/s and rad/s, of an object after settling; a faster one has not come to rest
GOAL_HOLDS_AT_START = "the goal holds already at the start"

DROP_HEIGHT = 0.5  # m over the table, where the search for an object's resting height starts
WAITING_OBJECT_SPACING = 2.0  # m between objects that wait above the table until they are placed
SPAWN_GAP = 2e-4  # m between a placed object and its support, so that no contact exists before the first step


def sample_attempt(simulator: Simulator, job: AttemptJob) -> Attempt:
    """Sample an attempt: roles, variation, and a start with all objects at rest; distractors are placed later.

    A start in which an object still moves, such as a rocking bottle, is used only if there is no other. The attempt has
    no start if its objects have no room, or if its goal holds in every sampled start; see `describe_missing_start`.
    """
    config, task, roles = simulator.config, simulator.config.task, simulator.roles
    attempt = Attempt(job, None, sample_variation(config, job), roles=roles, phrasing=sample_phrasing(task, job))
    scene = simulator.apply_randomization(attempt)
    moving: Attempt | None = None
    for number in range(MAX_DRAWS):
        places = sample_placements(task, roles, _local_box_function(simulator), config.widened_table, job, number)
        if isinstance(places, str):
            break
        settled = settle_objects(scene, _drop_objects(simulator, places), task.timing.timestep)
        start = _crumple_cloths(simulator, settled.qpos, random_generator(job, Stream.CRUMPLES, number))
        episode = open_episode(simulator, replace(attempt, start=start), EpisodeRules())
        if episode.verdict is not None and not episode.verdict.reached:
            poses = {name: episode.world.pose(name) for name in scene.object_names}
            with_start = replace(attempt, layout=ObjectLayout(poses), start=start)
            if settled.speed <= _MAX_START_SPEED:
                return with_start
            moving = moving or with_start
    return moving or attempt


def sample_object_placements(simulator: Simulator, job: AttemptJob) -> dict[str, ObjectPlacement] | str:
    """Return the placements of objects before they settle, or the name of an object that has no room."""
    config = simulator.config
    return sample_placements(config.task, simulator.roles, _local_box_function(simulator), config.widened_table, job)


def describe_missing_start(simulator: Simulator, attempt: Attempt) -> str:
    """Return why an attempt has no start."""
    places = sample_object_placements(simulator, attempt.job)
    if isinstance(places, str):
        return f"no free place for the {places} in its start region"
    return f"{GOAL_HOLDS_AT_START}, in each of {MAX_DRAWS} samples"


def sample_variation(config: RecordConfig, job: AttemptJob) -> RandomizationSample:
    """Sample an attempt's variation in the look of the config, without distractors."""
    if not config.randomization.varied_parts:
        return RandomizationSample()
    dofs = [config.rig.arms[number].robot.dof for number in config.rig.recording_order]
    lights, objects = len(config.scene.lights), config.task.objects
    return sample_randomization(config.randomization, job, lights, objects, dofs, config.look)


def _local_box_function(simulator: Simulator) -> LocalBoxFunction:
    scene, replica = simulator.scene, simulator.state_replay
    world = make_sim_world(scene, replica.data, arm_sides(simulator.config))

    @functools.cache
    def local_box_of_object(name: str, opened: tuple[tuple[str, float], ...]) -> Array:
        qpos = scene.model.qpos0.copy()
        _set_openings(scene, qpos, name, dict(opened))
        replica.set_state(qpos)
        return world.local_box(name)

    return lambda name, opened: local_box_of_object(name, tuple(opened.items()))


def _set_openings(scene: CompiledScene, qpos: Array, name: str, opened: Mapping[str, float]) -> None:
    for part, share in opened.items():
        joint = scene.model.joint(f"{name}_{part}")
        low, high = joint.range
        qpos[joint.qposadr[0]] = low + share * (high - low)


def _drop_objects(simulator: Simulator, places: Mapping[str, ObjectPlacement]) -> Array:
    scene, top = simulator.scene, simulator.config.widened_table.top_height
    waiting = {name: pose((0.0, 0.0, top + WAITING_OBJECT_SPACING * (k + 1))) for k, name in enumerate(places)}
    qpos = scene.start_qpos(ObjectLayout(waiting), start_postures(simulator.config))
    for name, placed in places.items():
        _set_openings(scene, qpos, name, placed.joint_openings)
        T = placed.T.copy()
        if name in scene.cloths:
            T[2, 3] = top + scene.cloths[name].half_thickness + SPAWN_GAP
        else:
            T[2, 3] = top + DROP_HEIGHT
            T[2, 3] = simulator.expert_planner.rest_height(qpos, name, T, top - DROP_HEIGHT) + SPAWN_GAP
        scene.set_object_pose(qpos, name, T)
    return qpos


def _crumple_cloths(simulator: Simulator, start: Array, rng: np.random.Generator) -> Array:
    """Crumple the cloths that start crumpled; in `start`, all are flat."""
    task, scene = simulator.config.task, simulator.scene
    for role, how in task.starts.items():
        for name in simulator.roles.objects_of(role):
            if how.crumpled is not None and name in scene.cloths:
                share = float(rng.uniform(*how.crumpled))
                start = crumple_cloth(scene, start, name, rng, share, task.timing.timestep)
    return start


_MAX_START_ATTEMPTS = 3  # attempts after which a task without any start is rejected; usually the first has one


def require_start(session: Session) -> None:
    """Raise ConflictError, with a path from the root, if none of a task's first attempts has a start."""
    task = session.config.task
    with SimulatorCache(session.without_meshes()) as simulators:
        for number in range(_MAX_START_ATTEMPTS):
            job = AttemptJob(session.config.seed, number)
            simulator = simulators.get(job)
            attempt = sample_attempt(simulator, job)
            if attempt.layout is not None:
                return
            why = describe_missing_start(simulator, attempt)
    message = f"{why}; none of the first {_MAX_START_ATTEMPTS} attempts of seed {session.config.seed} has a start"
    if why.startswith(GOAL_HOLDS_AT_START):
        raise ConflictError(message, ("task", "goal"))
    role = next(role for role in reversed(list(task.starts)) if task.starts[role].on == TABLE)
    raise ConflictError(message, ("task", "starts", role))
