"""Attempts of tasks that are data: sampled, demonstrated by their expert, and judged by their goal."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..config.program_task import ProgramTask
from ..geometry.se3 import Array, pose
from ..goals.cast import Cast
from ..planning.demonstration import start_stands
from ..scene.compiled import CompiledScene
from ..sim.crumple import crumpled
from ..sim.rollout import path_actions
from ..sim.watched import See, Watched, WatchedLoop, settle
from ..sim.world import world_of
from ..skills.errors import SkillFailedError
from ..skills.program import Diary, program_of, run_program
from ..tasks.casting import BlockOf, Placed, draw_phrasing, draw_places
from ..tasks.pickplace import SPAWN_GAP, on_the_way
from ..tasks.randomness import Stream, generator
from ..types import Actions, Attempt, Cause, EpisodeJob, Layout, Outcome, Recovery
from ..variation import Variation
from .expert import sides
from .simulated import Simulated
from .simulator import Simulator

# How often things are placed anew where the goal holds already.
_DRAWS = 20
HOLDS_ALREADY = "the goal holds already at the start"

# Things are let down from so high over the table, and wait for that so far apart above it, m.
_OVER = 0.5
_AWAY = 2.0


def sample_program(simulator: Simulator, job: EpisodeJob, variation: Variation) -> Attempt:
    """The attempt of a seed and a number, everything at rest; without a layout where there is none, see `no_start`."""
    task, cast = _played(simulator)
    attempt = Attempt(job, None, variation, cast=cast, phrasing=draw_phrasing(task, job))
    scene, config = simulator.varied(attempt), simulator.config
    for number in range(_DRAWS):
        places = draw_places(task, cast, _block_of(simulator), config.table, job, number)
        if isinstance(places, str):
            break
        start = settle(scene, _let_down(simulator, places), task.timing.timestep)
        start = _crumpled(simulator, start, generator(job, Stream.CRUMPLES, number))
        loop = WatchedLoop(scene, start, task, cast, sides(config))
        if not loop.judged().reached:
            poses = {name: loop.world.pose(name) for name in scene.things}
            return replace(attempt, layout=Layout(poses, upright=False), start=start)
    return attempt


def no_start(simulator: Simulator, attempt: Attempt) -> str:
    """Why an attempt has no layout."""
    task, cast = _played(simulator)
    places = draw_places(task, cast, _block_of(simulator), simulator.config.table, attempt.job)
    if isinstance(places, str):
        return f"no free place for the {places} where it is to start"
    return f"{HOLDS_ALREADY}, in each of {_DRAWS} draws"


def demonstrate_program(simulator: Simulator, attempt: Attempt, *, grips: bool = True) -> Simulated:
    """What the task's expert makes of an attempt, in physics alone.

    Args:
        grips: whether its fingers close; without, it can only fail, where a task asks for hands at all.
    """
    if attempt.layout is None or attempt.start is None:
        return Simulated(attempt, Outcome(False, Cause.NO_LAYOUT, no_start(simulator, attempt)), None)
    config, scene = simulator.config, simulator.varied(attempt)
    task, cast = _played(simulator)
    loop = WatchedLoop(scene, attempt.start, task, cast, sides(config))
    rng = generator(attempt.job, Stream.SEARCH)
    bench = simulator.expert_tools.bench(loop.world, list(start_stands(config)), rng)
    diary, noted = Diary(), list[Recovery]()

    def note() -> None:
        noted.extend(Recovery(one.step, one.skill, one.detail, loop.frames) for one in diary.recoveries[len(noted) :])

    failure: tuple[Cause, str] | None = None
    # What comes after the program has to act as well.
    most = task.most_ticks - task.timing.settle_ticks - task.hold_ticks
    try:
        for segment in run_program(program_of(task, cast), bench, cast, diary):
            note()
            if loop.ticks + segment.ticks > most:
                failure = Cause.TIME, f"not done after {loop.ticks * task.timing.tick:.0f} s"
                break
            loop.act(_opened(scene, path_actions(scene, segment.paths), grips))
    except SkillFailedError as error:
        failure = error.cause, str(error)
    note()
    last = bench.wait(max(1, task.timing.settle_ticks + task.hold_ticks))
    loop.act(_opened(scene, path_actions(scene, last.paths), grips), last=True)
    watched = loop.result()
    outcome = replace(_outcome(watched, planned=True, failure=failure), recoveries=tuple(noted))
    return Simulated(attempt, outcome, watched)


def repeat_program(
    simulator: Simulator, attempt: Attempt, actions: Actions, *, planned: bool, see: See | None = None
) -> Simulated:
    """Let actions act that are known already, and judge them.

    Args:
        planned: whether they came from the task's expert, which may touch nothing that it must not.
    """
    assert attempt.start is not None, "nothing moves without a layout"
    task, cast = _played(simulator)
    loop = WatchedLoop(simulator.varied(attempt), attempt.start, task, cast, sides(simulator.config), see)
    loop.act(actions, last=True)
    watched = loop.result()
    return Simulated(attempt, _outcome(watched, planned=planned), watched)


def _outcome(watched: Watched, *, planned: bool, failure: tuple[Cause, str] | None = None) -> Outcome:
    motion, verdict = watched.motion, watched.verdict
    worst = verdict.worst
    cause, detail = (
        ((Cause.UNSTABLE, motion.breakdown) if motion.breakdown else None)
        or failure
        or (on_the_way(motion) if planned else None)
        or (None if verdict.reached else (Cause.GOAL, f"{worst.what}: {worst.detail or 'it does not hold'}"))
        or (None, "")
    )
    return Outcome(cause is None, cause, detail, margins=motion.margins, measures=verdict.measures)


def _played(simulator: Simulator) -> tuple[ProgramTask, Cast]:
    task, cast = simulator.config.program, simulator.cast
    assert task is not None and cast is not None, "of tasks that are data alone"
    return task, cast


def _block_of(simulator: Simulator) -> BlockOf:
    """See `draw_places`."""
    scene, replica = simulator.scene, simulator.replica
    world = world_of(scene, replica.data, sides(simulator.config))

    @functools.cache
    def block(name: str, opened: tuple[tuple[str, float], ...]) -> Array:
        qpos = scene.model.qpos0.copy()
        _open(scene, qpos, name, dict(opened))
        replica.show(qpos)
        return world.block(name)

    return lambda name, opened: block(name, tuple(opened.items()))


def _open(scene: CompiledScene, qpos: Array, name: str, opened: Mapping[str, float]) -> None:
    """Put into MuJoCo's positions (nq,) how far a thing's parts are open."""
    for part, share in opened.items():
        joint = scene.model.joint(f"{name}_{part}")
        low, high = joint.range
        qpos[joint.qposadr[0]] = low + share * (high - low)


def _let_down(simulator: Simulator, places: Mapping[str, Placed]) -> Array:
    """MuJoCo's positions (nq,) with everything let down on what it starts on."""
    scene, top = simulator.scene, simulator.config.table.top
    # Until its turn comes, each thing is where nothing else is.
    away = {name: pose((0.0, 0.0, top + _AWAY * (k + 1))) for k, name in enumerate(places)}
    qpos = scene.start_qpos(Layout(away), start_stands(simulator.config))
    for name, placed in places.items():
        _open(scene, qpos, name, placed.open)
        T = placed.T.copy()
        if name in scene.cloths:
            T[2, 3] = top + scene.cloths[name].radius + SPAWN_GAP
        else:
            T[2, 3] = top + _OVER
            T[2, 3] = simulator.expert_tools.rest_height(qpos, name, T, top - _OVER) + SPAWN_GAP
        scene.put(qpos, name, T)
    return qpos


def _crumpled(simulator: Simulator, start: Array, rng: np.random.Generator) -> Array:
    """MuJoCo's positions (nq,) with the cloths crumpled that start so; at `start` they lie flat."""
    task, cast = _played(simulator)
    scene = simulator.scene
    for role, how in task.starts.items():
        for name in cast.of(role):
            if how.crumpled is not None and name in scene.cloths:
                share = float(rng.uniform(*how.crumpled))
                start = crumpled(scene, start, name, rng, share, task.timing.timestep)
    return start


def _opened(scene: CompiledScene, actions: Actions, grips: bool) -> Actions:
    """The same actions, with fingers that stay open unless they grip."""
    if grips:
        return actions
    ctrl = actions.ctrl.copy()
    for arm in scene.arms:
        if arm.fingers is not None:
            ctrl[:, arm.fingers.ctrl] = arm.fingers.ctrl_range[1]
    return replace(actions, ctrl=ctrl)
