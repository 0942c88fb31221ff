"""Checks of a task: its expert succeeds often enough, and wrong motions and near misses do not reach its goal."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import mujoco
import numpy as np

from ..core.attempt_data import ActionSequence, Attempt, AttemptJob
from ..core.config.goals.goal import evaluate_goal
from ..core.config.goals.role_assignment import RoleAssignment
from ..core.config.goals.world import TABLE
from ..core.config.program_task import NearMiss, ProgramTask
from ..core.config.session import Session
from ..core.config.task_objects import ObjectStartRanges
from ..core.episode.episode_rules import REPLAY_RULES
from ..core.episode.execution import SimulatedAttempt, simulate_expert
from ..core.episode.sampling import sample_attempt
from ..core.episode.simulator import Simulator, SimulatorCache, open_episode
from ..core.errors import SimulationError
from ..core.expert.skills.program import build_program
from ..core.geometry.se3 import Array, quat_from_rotation, rotation_from_vector
from ..core.progress import Progress
from ..core.scene.compiled import CompiledScene, Ids
from ..program_checks import program_contradiction
from ..trials import run_expert_trials

MIN_REACH = 0.9  # share of a start region's points that hands must reach
_GRID_POINTS = 8  # along each side of a start region
_HAND_HEIGHT = 0.03  # m over the surface
_MIN_MOTION = 0.05  # m from the start, above which an object counts as moved
_STILL_SECONDS = 2.0  # s at rest before the goal is evaluated, besides the hold time
_MAX_ATTEMPTS = 3  # of each check in which the goal must not be reached

# Keys of a batch report that are also in a validation report.
_BATCH_REPORT_KEYS = (
    "task", "rig", "seed", "n", "n_success", "success_rate", "wilson95", "causes", "recovered", "seconds",
    "core_seconds_per_trial",
)  # fmt: skip


@dataclass(frozen=True)
class TaskCheck:
    """Result of one check: `ok` is None if it does not apply, and `value` is the measured share or count, if any."""

    name: str
    ok: bool | None
    value: float | None
    detail: str


def check_program_fits(task: ProgramTask) -> TaskCheck:
    """Check without simulation that no step of the expert contradicts the goal."""
    why = program_contradiction(task)
    return TaskCheck("program", why is None, None, why or "no step contradicts the goal")


def check_reach(simulator: Simulator) -> TaskCheck:
    """Check that a hand reaches enough points of each start region on the table."""
    shares = {
        role: _reachable_share(simulator, start)
        for role, start in simulator.config.start_regions_in_world.items()
        if start.on == TABLE
    }
    least = min(shares.values(), default=1.0)
    listed = ", ".join(f"{role} {share:.0%}" for role, share in shares.items())
    return TaskCheck(
        "reach", least >= MIN_REACH, least, f"of each region: {listed}; at least {MIN_REACH:.0%} is needed"
    )


def _reachable_share(simulator: Simulator, start: ObjectStartRanges) -> float:
    height = simulator.config.widened_table.top_height + _HAND_HEIGHT
    places = list(itertools.product(np.linspace(*start.x, _GRID_POINTS), np.linspace(*start.y, _GRID_POINTS)))
    return sum(simulator.expert_planner.is_place_reachable(np.array((x, y, height))) for x, y in places) / len(places)


def check_holding_still(simulators: SimulatorCache, seed: int, n: int) -> TaskCheck:
    """Check that arms that hold still never reach the goal."""
    reached = []
    for job in (AttemptJob(seed, number) for number in range(n)):
        simulator = simulators.get(job)
        attempt = sample_attempt(simulator, job)
        if attempt.start is None:
            continue
        episode = open_episode(simulator, attempt, REPLAY_RULES)
        task = simulator.config.task
        ticks = math.ceil(_STILL_SECONDS / task.timing.tick_seconds) + task.hold_ticks
        episode.run_commands(_hold_actions(simulator.scene, attempt.start, ticks))
        reached.append(episode.has_succeeded)
    return _check_goal_never_reached("hold_still", reached, "attempts in which nothing is done")


def check_open_fingers(simulators: SimulatorCache, seed: int, n: int) -> TaskCheck:
    """Check that an expert whose fingers do not close never reaches the goal."""
    task = simulators.session.config.task
    if all(skill.REQUIRES_HELD_OBJECT is not False for skill in build_program(task, task.typical_roles)):
        return TaskCheck("open_fingers", None, None, "nothing is taken into a hand")
    reached = []
    for job in (AttemptJob(seed, number) for number in range(n)):
        simulator = simulators.get(job)
        attempt = sample_attempt(simulator, job)
        if attempt.start is not None:
            reached.append(simulate_expert(simulator, attempt, grips=False).outcome.success)
    return _check_goal_never_reached("open_fingers", reached, "attempts in which no finger closes")


def check_near_misses(simulator: Simulator, done: SimulatedAttempt) -> TaskCheck:
    """Check that the goal fails if one object is displaced at the end of a success.

    Each moved object is put back to its start in turn. Each near miss of the task is applied by itself.
    """
    episode = open_episode(simulator, done.attempt, REPLAY_RULES)
    for state in done.recorded_states:
        episode.run_commands(state.actions)
    task, roles = simulator.config.task, simulator.roles
    ended = episode.data.qpos.copy()
    counted, count = [], 0
    for what, qpos in _near_miss_states(simulator.scene, task, roles, done.attempt, ended):
        episode.data.qpos[:] = qpos
        mujoco.mj_forward(simulator.scene.model, episode.data)
        count += 1
        if evaluate_goal(task.goal, episode.world, roles).reached:
            counted.append(what)
    detail = f"{count} near misses" + (f", of which these count: {'; '.join(counted)}" if counted else ", none counts")
    return TaskCheck("near_misses", not counted if count else None, float(len(counted)), detail)


def _near_miss_states(
    scene: CompiledScene, task: ProgramTask, roles: RoleAssignment, attempt: Attempt, ended: Array
) -> Iterator[tuple[str, Array]]:
    assert attempt.start is not None, "a success has a start"
    judged = {role for _, predicate in task.goal.predicates() for _, role in predicate.roles()}
    named = {name for role in judged for name in roles.objects_of(role)}
    for name in _moved_objects(scene, attempt.start, ended):
        if name not in named:
            continue  # it has no effect on the goal
        back, at = ended.copy(), _qpos_addresses(scene, name)
        back[at] = attempt.start[at]
        yield f"the {name} where it started", back
    for miss in task.near_misses:
        for name in roles.objects_of(miss.thing):
            displaced = ended.copy()
            _displace_to_near_miss(scene, displaced, name, miss)
            yield f"the {name} {miss.what}", displaced


def _moved_objects(scene: CompiledScene, start: Array, ended: Array) -> Iterator[str]:
    for name in scene.object_names:
        if name in scene.cloths:
            moved = np.linalg.norm((ended - start)[scene.cloths[name].qpos], axis=1).max()
        else:
            at = scene.object_qpos[name]
            moved = np.linalg.norm(ended[at : at + 3] - start[at : at + 3])
        if float(moved) > _MIN_MOTION:
            yield name


def _qpos_addresses(scene: CompiledScene, name: str) -> Ids:
    if name in scene.cloths:
        return scene.cloths[name].qpos
    # An object's pieces belong to it.
    first = [scene.object_qpos[name], *scene.model.jnt_qposadr[list(scene.pieces.get(name, ()))]]
    return np.concatenate([np.arange(k, k + 7) for k in first])


def _displace_to_near_miss(scene: CompiledScene, qpos: Array, name: str, miss: NearMiss) -> None:
    turned = rotation_from_vector([math.radians(miss.tilt_deg), 0.0, 0.0])
    if name in scene.cloths:
        cloth = scene.cloths[name]
        points = cloth.points(qpos)
        middle = points.mean(axis=0)
        qpos[cloth.qpos] = (points - middle) @ turned.T + middle + miss.move - cloth.flat_points
        return
    at = scene.object_qpos[name]
    qpos[at : at + 3] += miss.move
    if miss.tilt_deg:
        R = np.empty(9)
        mujoco.mju_quat2Mat(R, qpos[at + 3 : at + 7])
        qpos[at + 3 : at + 7] = quat_from_rotation(turned @ R.reshape(3, 3))


def _check_goal_never_reached(name: str, reached: Sequence[bool], what: str) -> TaskCheck:
    if not reached:
        return TaskCheck(name, False, None, "no attempt had a start")
    count = sum(reached)
    return TaskCheck(name, not count, count / len(reached), f"{count} of {len(reached)} {what} reach the goal")


def _hold_actions(scene: CompiledScene, start: Array, ticks: int) -> ActionSequence:
    ctrl = np.zeros(scene.model.nu)
    for arm in scene.arms:
        ctrl[arm.drive_ctrl] = start[arm.recorded_qpos]
    joints = np.array([start[arm.recorded_qpos] for arm in scene.arms])
    return ActionSequence(
        np.tile(ctrl, (ticks, 1)), np.zeros((ticks, len(scene.arms)), bool), np.tile(joints, (ticks, 1, 1))
    )


def validate_task(session: Session, minimum: float, progress: Progress) -> dict[str, Any]:
    """Run `episodes` trials of a task, and every check. Return a report as JSON data.

    The expert must reach the goal in the share `minimum` of the trials.
    """
    config = session.config
    report = run_expert_trials(session, (), progress)
    rate = report["success_rate"]
    low, high = report["wilson95"]
    counted = f"{report['n_success']} of {report['n']} succeed, 95 % interval {low:.1%} to {high:.1%}"
    detail = f"{counted}; at least {minimum:.0%} is needed"
    checks = [check_program_fits(config.task), TaskCheck("expert", rate >= minimum, rate, detail)]
    attempts = min(_MAX_ATTEMPTS, config.episodes)
    with SimulatorCache(session.without_meshes()) as simulators:
        checks.append(check_reach(simulators.get(AttemptJob(config.seed, 0))))
        checks.append(check_holding_still(simulators, config.seed, attempts))
        checks.append(check_open_fingers(simulators, config.seed, attempts))
        checks.append(_near_misses(simulators, report))
    return {
        "ok": all(check.ok is not False for check in checks),
        **{key: report[key] for key in _BATCH_REPORT_KEYS},
        "checks": [asdict(check) for check in checks],
        "trials": [trial for trial in report["trials"] if not trial["outcome"]["success"]],
    }


def _near_misses(simulators: SimulatorCache, report: Mapping[str, Any]) -> TaskCheck:
    success = next((trial for trial in report["trials"] if trial["outcome"]["success"]), None)
    if success is None:
        return TaskCheck("near_misses", None, None, "no attempt succeeded, so there is no state to move objects from")
    job = AttemptJob(success["seed"], success["trial"])
    simulator = simulators.get(job)
    return check_near_misses(simulator, simulate_expert(simulator, sample_attempt(simulator, job)))


def require_passed(report: Mapping[str, Any]) -> None:
    """Raise SimulationError if a check failed."""
    failed = [check for check in report["checks"] if check["ok"] is False]
    if failed:
        first = failed[0]
        more = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
        raise SimulationError(f"task {report['task']!r}: {first['name']}: {first['detail']}{more}")
