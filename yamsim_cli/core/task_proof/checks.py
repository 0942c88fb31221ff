"""The checks of a task, each with its figure."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from ..attempt.engine import Simulated, demonstrate
from ..attempt.episodes import open_episode
from ..attempt.sampling import sample
from ..attempt.simulator import Simulator
from ..attempt.simulators import Simulators
from ..config.program_task import NearMiss, ProgramTask, Start
from ..episode.rules import REPEATED_RULES
from ..geometry.se3 import Array, quat_from_rotation, rotation_from_vector
from ..goals.cast import Cast
from ..goals.goal import judge
from ..goals.world import TABLE
from ..scene.compiled import CompiledScene, Ids
from ..skills.contradictions import program_contradiction
from ..skills.program import read_program
from ..types import Actions, Attempt, EpisodeJob

# A region is looked at in so many places along each side.
_GRID = 8

# The least share of a region that hands have to reach.
LEAST_REACH = 0.9

# Hands get to things so high over what they start on, m.
_HEIGHT = 0.03

# What lies nearer than this to where it started counts as not moved, m.
_MOVED = 0.05

# How long nothing is done before it is judged, s.
_STILL_S = 2.0


@dataclass(frozen=True)
class Check:
    """What one check found.

    Attributes:
        name: which check.
        ok: whether it passed; None where it does not apply.
        value: its figure, a share or a count; None without one.
        detail: the figures behind it, for a person.
    """

    name: str
    ok: bool | None
    value: float | None
    detail: str


def check_program_fits(task: ProgramTask) -> Check:
    """Whether the expert's steps can reach the goal, as far as they tell without a simulation."""
    why = program_contradiction(task)
    return Check("program", why is None, None, why or "no step contradicts the goal")


def check_reach(simulator: Simulator) -> Check:
    """Of the places in the regions on the table, how many some hand reaches, in whatever way it is turned."""
    shares = {role: _reached(simulator, start) for role, start in simulator.config.starts.items() if start.on == TABLE}
    least = min(shares.values(), default=1.0)
    told = ", ".join(f"{role} {share:.0%}" for role, share in shares.items())
    return Check("reach", least >= LEAST_REACH, least, f"of each region: {told}; at least {LEAST_REACH:.0%} is needed")


def _reached(simulator: Simulator, start: Start) -> float:
    height = simulator.config.table.top + _HEIGHT
    places = list(itertools.product(np.linspace(*start.x, _GRID), np.linspace(*start.y, _GRID)))
    return sum(simulator.expert_tools.reaches_place(np.array((x, y, height))) for x, y in places) / len(places)


def check_still(simulators: Simulators, seed: int, n: int) -> Check:
    """Whether the goal is never reached by doing nothing."""
    reached = []
    for job in (EpisodeJob(seed, number) for number in range(n)):
        simulator = simulators.of(job)
        attempt = sample(simulator, job)
        if attempt.start is None:
            continue
        episode = open_episode(simulator, attempt, REPEATED_RULES)
        task = simulator.config.task
        ticks = math.ceil(_STILL_S / task.timing.tick) + task.hold_ticks
        episode.act(_nothing(simulator.scene, attempt.start, ticks))
        reached.append(episode.succeeds)
    return _never("hold_still", reached, "attempts in which nothing is done")


def check_open_fingers(simulators: Simulators, seed: int, n: int) -> Check:
    """Whether the goal is never reached by an expert whose fingers do not close."""
    task = simulators.session.config.task
    if all(skill.NEEDS is not False for skill in read_program(task.expert, task.typical_cast)):
        return Check("open_fingers", None, None, "nothing is taken into a hand")
    reached = []
    for job in (EpisodeJob(seed, number) for number in range(n)):
        simulator = simulators.of(job)
        attempt = sample(simulator, job)
        if attempt.start is not None:
            reached.append(demonstrate(simulator, attempt, grips=False).outcome.success)
    return _never("open_fingers", reached, "attempts in which no finger closes")


def check_near_misses(simulator: Simulator, done: Simulated) -> Check:
    """Whether the goal fails where one thing is put off from how a success ended: back to where it started, or as one
    of the task's own near misses says. Each near miss starts from the end of the success.
    """
    episode = open_episode(simulator, done.attempt, REPEATED_RULES)
    for state in done.states:
        episode.act(state.actions)
    task, cast = simulator.config.task, simulator.cast
    ended = episode.data.qpos.copy()
    passed, looked = [], 0
    for what, qpos in _misses(simulator.scene, task, cast, done.attempt, ended):
        episode.data.qpos[:] = qpos
        mujoco.mj_forward(simulator.scene.model, episode.data)
        looked += 1
        if judge(task.goal, episode.world, cast).reached:
            passed.append(what)
    detail = f"{looked} near misses" + (f", of which these count: {'; '.join(passed)}" if passed else ", none counts")
    return Check("near_misses", not passed if looked else None, float(len(passed)), detail)


def _misses(
    scene: CompiledScene, task: ProgramTask, cast: Cast, attempt: Attempt, ended: Array
) -> Iterator[tuple[str, Array]]:
    """What was put off, and MuJoCo's positions (nq,) then."""
    assert attempt.start is not None, "it has moved"
    for name in _moved(scene, attempt.start, ended):
        back, at = ended.copy(), _addresses(scene, name)
        back[at] = attempt.start[at]
        yield f"the {name} where it started", back
    for miss in task.near_misses:
        for name in cast.of(miss.thing):
            off = ended.copy()
            _put_off(scene, off, name, miss)
            yield f"the {name} {miss.what}", off


def _moved(scene: CompiledScene, start: Array, ended: Array) -> Iterator[str]:
    for name in scene.things:
        if name in scene.cloths:
            moved = np.linalg.norm((ended - start)[scene.cloths[name].qpos], axis=1).max()
        else:
            at = scene.object_qpos[name]
            moved = np.linalg.norm(ended[at : at + 3] - start[at : at + 3])
        if float(moved) > _MOVED:
            yield name


def _addresses(scene: CompiledScene, name: str) -> Ids:
    """Where all of a thing's positions are."""
    if name in scene.cloths:
        return scene.cloths[name].qpos
    return np.arange(scene.object_qpos[name], scene.object_qpos[name] + 7)


def _put_off(scene: CompiledScene, qpos: Array, name: str, miss: NearMiss) -> None:
    turned = rotation_from_vector([math.radians(miss.tilt_deg), 0.0, 0.0])
    if name in scene.cloths:
        cloth = scene.cloths[name]
        points = cloth.points(qpos)
        middle = points.mean(axis=0)
        qpos[cloth.qpos] = (points - middle) @ turned.T + middle + miss.move - cloth.rest
        return
    at = scene.object_qpos[name]
    qpos[at : at + 3] += miss.move
    if miss.tilt_deg:
        R = np.empty(9)
        mujoco.mju_quat2Mat(R, qpos[at + 3 : at + 7])
        qpos[at + 3 : at + 7] = quat_from_rotation(turned @ R.reshape(3, 3))


def _never(name: str, reached: Sequence[bool], what: str) -> Check:
    if not reached:
        return Check(name, False, None, "no attempt had a start")
    count = sum(reached)
    return Check(name, not count, count / len(reached), f"{count} of {len(reached)} {what} reach the goal")


def _nothing(scene: CompiledScene, start: Array, ticks: int) -> Actions:
    """Actions with which every arm holds its place."""
    ctrl = np.zeros(scene.model.nu)
    for arm in scene.arms:
        ctrl[arm.drives] = start[arm.recorded_qpos]
    joints = np.array([start[arm.recorded_qpos] for arm in scene.arms])
    return Actions(np.tile(ctrl, (ticks, 1)), np.zeros((ticks, len(scene.arms)), bool), np.tile(joints, (ticks, 1, 1)))
