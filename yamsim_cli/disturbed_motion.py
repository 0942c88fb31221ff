"""Executes an expert's motions with the disturbances of a `DisturbanceConfig`."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from dataclasses import replace
from enum import IntEnum
from typing import Any, Protocol, TypeVar

import numpy as np

from .core.attempt_data import ActionSequence, AttemptJob, FailureCause, JointPath, StepState
from .core.config.recording import RecordConfig
from .core.geometry.se3 import Array
from .core.scene.compiled import CompiledScene
from .core.scene.random_streams import Stream, random_generator
from .core.sim.sim_world import SimWorld
from .disturbances.config import DisturbanceConfig, PushSample

MIN_NOTICED_MOTION = 0.01  # m, motion of a pushed object from which on the expert plans again; grasps hold less

Segment = TypeVar("Segment")


class CommandedEpisode(Protocol):
    """The part of `core.episode.episode.Episode` that disturbances need."""

    scene: CompiledScene
    world: SimWorld
    ticks: int
    end: Any

    @property
    def has_succeeded(self) -> bool:
        """Whether the goal has held for its hold time."""

    def run_commands(self, actions: ActionSequence, *, until_success: bool = False) -> None:
        """Execute actions."""


class _Kind(IntEnum):
    """Random streams of the kinds of disturbances. The values are part of the seeds: never renumber."""

    NOISE = 0
    PUSH = 1
    LATE_GRASP = 2


def sample_pushes(
    config: DisturbanceConfig | None, job: AttemptJob, things: Sequence[str], tick_seconds: float
) -> tuple[PushSample, ...]:
    """Return the pushes of an attempt: one or none.

    Args:
        things: names of the rigid objects that may be pushed.
        tick_seconds: length of a control tick, s.
    """
    if config is None or not things:
        return ()
    rng = random_generator(job, Stream.DISTURBANCES, _Kind.PUSH)
    if rng.random() >= config.push_probability:
        return ()
    thing = things[int(rng.integers(len(things)))]
    tick = round(rng.uniform(*config.push_time_s) / tick_seconds)
    speed, direction = rng.uniform(*config.push_mps), rng.uniform(-math.pi, math.pi)
    return (PushSample(thing, tick, (speed * math.cos(direction), speed * math.sin(direction), 0.0)),)


def run_with_pushes(
    episode: CommandedEpisode, actions: ActionSequence, pushes: Sequence[PushSample], *, until_success: bool = False
) -> list[PushSample]:
    """Execute actions as `Episode.run_commands` does, and push objects before the ticks of `pushes`.

    Args:
        pushes: of the whole episode, in the order of their ticks.

    Returns:
        The pushes that have acted.
    """
    first, begin, count, acted = episode.ticks, 0, len(actions.ctrl), []
    for push in pushes:
        if not begin <= (end := push.tick - first) < count:
            continue
        episode.run_commands(_part_of(actions, slice(begin, end)), until_success=until_success)
        begin = end
        if episode.end is None and not (until_success and episode.has_succeeded):
            dof = episode.scene.model.joint(push.thing).dofadr[0]
            episode.world.data.qvel[dof : dof + 3] += push.velocity
            acted.append(push)
    episode.run_commands(_part_of(actions, slice(begin, count)), until_success=until_success)
    return acted


def _part_of(actions: ActionSequence, ticks: slice) -> ActionSequence:
    return ActionSequence(actions.ctrl[ticks], actions.magnet[ticks], actions.joints[ticks])


class DisturbedExecution:
    """Executes the motions of an attempt's expert. If the config has no disturbances, it executes them unchanged.

    Attributes:
        pushes: the pushes of the attempt.

    Args:
        to_actions: converts paths of all arms to actions.
        picked: names of the objects that the task picks up; the rigid ones may be pushed. None disturbs nothing.
    """

    def __init__(
        self,
        config: RecordConfig,
        job: AttemptJob,
        episode: CommandedEpisode,
        to_actions: Callable[[Sequence[JointPath]], ActionSequence],
        picked: Iterable[str] | None,
    ) -> None:
        given = None if picked is None else config.disturb
        self._config, self._episode, self._to_actions = given, episode, to_actions
        rigid = [name for name in dict.fromkeys(picked or ()) if name not in episode.scene.cloths]
        self.pushes = sample_pushes(given, job, rigid, config.task.timing.tick_seconds)
        self._columns = np.concatenate([episode.scene.arms[k].arm_ctrl for k in config.acting_scene_arms])
        self._noise = np.zeros(len(self._columns))
        self._rng = random_generator(job, Stream.DISTURBANCES, _Kind.NOISE)
        self._intended: list[Array] = []
        self._moved: dict[str, Array] = {}
        self._late_ticks, self._waiting_opening = 0, 0.0
        self._late_arm: int | None = None
        if given is not None:
            rng = random_generator(job, Stream.DISTURBANCES, _Kind.LATE_GRASP)
            if rng.random() < given.late_grasp_probability:
                self._late_ticks = round(rng.uniform(*given.late_grasp_s) / config.task.timing.tick_seconds)

    def run(self, paths: Sequence[JointPath], *, until_success: bool = False) -> None:
        """Execute a motion of all arms, disturbed; `until_success` as in `Episode.run_commands`."""
        actions, episode = self._to_actions(paths), self._episode
        if self._config is None:
            episode.run_commands(actions, until_success=until_success)
            return
        self._intended.append(actions.ctrl)
        late = self._to_actions(self._delay_first_grasp(paths)) if self._late_ticks else actions
        ctrl = late.ctrl.copy()
        ctrl[:, self._columns] += self._sample_noise(len(ctrl), paths[0].tick)
        before = {push.thing: episode.world.pose(push.thing)[:3, 3] for push in self.pushes}
        held = {thing for thing in before if episode.world.holding_sides(thing)}
        acted = run_with_pushes(
            episode, replace(actions, ctrl=ctrl, magnet=late.magnet), self.pushes, until_success=until_success
        )
        self._moved = {push.thing: before[push.thing] for push in acted if push.thing not in held}

    def with_replanning(
        self, motions: Generator[Segment, None, None], error: Callable[[FailureCause, str], Exception]
    ) -> Iterator[Segment]:
        """Yield segments of a program, which the caller gives to `run`.

        If a push has moved an object that no hand holds, the program gets an `error` of the cause `KNOCKED` at the end
        of the segment.
        """
        try:
            segment = next(motions)
            while True:
                yield segment
                fault = self._describe_motion()
                segment = next(motions) if fault is None else motions.throw(error(FailureCause.KNOCKED, fault))
        except StopIteration:
            return

    def with_intended_commands(self, states: Sequence[StepState]) -> tuple[StepState, ...]:
        """Return recorded states with the commands of the expert before the disturbances."""
        if self._config is None:
            return tuple(states)
        intended, tick, found = np.concatenate(self._intended), 0, []
        for state in states:
            found.append(replace(state, intended=intended[tick]))
            tick += len(state.actions.ctrl)
        return tuple(found)

    def _describe_motion(self) -> str | None:
        moved, self._moved = self._moved, {}
        for thing, position in moved.items():
            distance = float(np.linalg.norm(self._episode.world.pose(thing)[:3, 3] - position))
            if distance > MIN_NOTICED_MOTION and not self._episode.world.holding_sides(thing):
                return f"the {thing} was pushed and has moved {1000 * distance:.0f} mm"
        return None

    def _sample_noise(self, ticks: int, tick_seconds: float) -> Array:
        """Return the noise (ticks, joints) of the next control ticks, rad: a first-order autoregressive process."""
        assert self._config is not None
        stdev, seconds = self._config.noise_rad, self._config.noise_correlation_s
        kept = math.exp(-tick_seconds / seconds) if seconds else 0.0
        fresh = self._rng.normal(0.0, stdev * math.sqrt(1 - kept**2), (ticks, len(self._columns)))
        noise = np.empty_like(fresh)
        for k, row in enumerate(fresh):
            self._noise = noise[k] = kept * self._noise + row
        return noise

    def _delay_first_grasp(self, paths: Sequence[JointPath]) -> list[JointPath]:
        """Return the paths with the first grasp of the attempt late: it begins with a grip force, or with a weld."""
        found = list(paths)
        grasping = [(path.grip_force > 0) | np.array(path.weld_on) for path in paths]
        begin = 0
        if self._late_arm is None:
            self._late_arm = next((k for k, grasps in enumerate(grasping) if grasps.any()), None)
            if self._late_arm is None:
                return found
            begin = int(grasping[self._late_arm].argmax())
            self._waiting_opening = float(paths[self._late_arm].gripper[max(begin - 1, 0)])
        path, grasps = paths[self._late_arm], grasping[self._late_arm]
        late = grasps & (np.arange(len(grasps)) < begin + self._late_ticks)
        # The delay ends early if the expert gives the grasp up.
        self._late_ticks = max(self._late_ticks - len(grasps) + begin, 0) if grasps[-1] else 0
        # With a weld, fingers close to the object's width without force, and hold nothing.
        found[self._late_arm] = replace(
            path,
            gripper=np.where(late & (path.grip_force > 0), self._waiting_opening, path.gripper),
            grip_force=np.where(late, 0.0, path.grip_force),
            weld_on=tuple((np.array(path.weld_on) & ~late).tolist()),
        )
        return found
