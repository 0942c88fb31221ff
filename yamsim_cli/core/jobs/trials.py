"""One trial of a policy: from the start that `pickplace batch` makes of the same numbers, and judged as there."""

from __future__ import annotations

import contextlib
import signal
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, TypeVar

from ..config.record import RecordConfig
from ..dataset.records import OutcomeRecord
from ..errors import UsageError, suggest
from ..geometry.se3 import Array
from ..policies.base import SCENE, WRIST, Action, InvalidActionError, Observation, read_action
from ..policies.loading import reset_policy, wanted_images
from ..resources import Locations
from ..scene.build import SCENE_CAMERA
from ..sim.closed_loop import ClosedLoop
from ..sim.replica import Replica
from ..tasks.kinds import kind_of
from ..types import Actions, EpisodeJob, Outcome
from .builtin_policies import Privileged, Scripted, Trial, make_policy
from .episode import EpisodeRunner, start_poses

T = TypeVar("T")


class Ended(StrEnum):
    """What ended a trial. From `RAISED` on it is the policy's fault, and no success whatever the object does."""

    NOT_STARTED = "not_started"
    DONE = "done"
    TIME_LIMIT = "time_limit"
    RAISED = "policy_raised"
    INVALID = "policy_invalid"
    SLOW = "policy_slow"
    LOST = "policy_lost"


FAULTS = (Ended.RAISED, Ended.INVALID, Ended.SLOW, Ended.LOST)


@dataclass(frozen=True)
class PolicyChoice:
    """Which policy, and how much time it has.

    Attributes:
        name, folder: see `make_policy`.
        call_seconds: for one answer, or a reset, of real time.
        time_limit: for a trial, of simulated time, s; None for twice what the plan takes.
    """

    name: str
    folder: Path
    call_seconds: float = 30.0
    time_limit: float | None = None


@dataclass(frozen=True)
class TrialResult:
    """How a trial went.

    Attributes:
        ended: what ended it.
        error: what the policy did wrong, for a person; empty if nothing.
        ticks: control ticks that passed.
        seconds: how long each of the policy's answers took.
        start: MuJoCo's positions (nq,) at the beginning; None if it was never begun.
        actions: what acted; None if nothing did.
    """

    job: EpisodeJob
    outcome: OutcomeRecord
    layout: Mapping[str, tuple[float, float, float, float]]
    ended: Ended
    error: str = ""
    ticks: int = 0
    seconds: tuple[float, ...] = ()
    start: Array | None = field(default=None, repr=False)
    actions: Actions | None = field(default=None, repr=False)


def trial_ticks(config: RecordConfig, choice: PolicyChoice) -> int:
    """How many control ticks a trial may take."""
    timing = config.task.timing
    if choice.time_limit is not None:
        return max(1, round(choice.time_limit / timing.tick))
    return 2 * kind_of(config.task).ticks(config)


def policy_cameras(config: RecordConfig, images: Iterable[str]) -> dict[str, str]:
    """Key in a policy's observation -> camera, of the images that it asks for.

    Raises:
        UsageError: there is no such camera on this rig, in this task.
    """
    if len(config.rig.arms) == 1:
        there = {WRIST: {"wrist_rgb": config.rig.arms[0].wrist_camera_name}}
    else:
        sides = {f"{arm.side}_wrist": {f"{arm.side}_wrist_rgb": arm.wrist_camera_name} for arm in config.wrist_arms}
        there = sides | {WRIST: {key: camera for one in sides.values() for key, camera in one.items()}}
    there[SCENE] = {"scene_rgb": SCENE_CAMERA}
    cameras: dict[str, str] = {}
    for name in images:
        if name not in there:
            raise UsageError(
                f"the policy asks for the image {name!r}, which rig {config.rig.name!r} with task {config.task.name!r} "
                f"does not have; {suggest(name, there)}"
            )
        cameras |= there[name]
    return cameras


class TrialRunner:
    """Runs trials of one policy; a context manager, since it may own a renderer.

    Raises:
        UsageError, ResourceError: the policy cannot be made, see `make_policy`.
    """

    def __init__(
        self,
        config: RecordConfig,
        locations: Locations,
        meshes: Mapping[str, Path | None],
        choice: PolicyChoice,
    ) -> None:
        self._config, self._choice = config, choice
        with _talking_on_stderr():
            self._policy = make_policy(choice.name, choice.folder, choice.call_seconds)
        self._runner = EpisodeRunner(config, locations, meshes, draw=False)
        self._replica = Replica(self._runner.scene)
        self._cameras = policy_cameras(config, wanted_images(self._policy))

    def run(self, job: EpisodeJob) -> TrialResult:
        """One trial."""
        layout, planned, rollout = self._runner.simulate(job)
        scene = self._runner.scene
        scripted = isinstance(self._policy, Scripted)
        if layout is None or (rollout is None and scripted):
            return TrialResult(job, OutcomeRecord.of(planned), start_poses(layout), Ended.NOT_STARTED)
        start = self._runner.start(layout, rollout)
        if isinstance(self._policy, Privileged):
            self._policy.begin(Trial(job, rollout, scene))
        loop = ClosedLoop(scene, start, self._config.task.object.name, self._config.task.timing)
        seconds: list[float] = []
        ended, error = self._drive(loop, job, seconds)
        if not loop.ticks:
            outcome = OutcomeRecord.of(Outcome(False))
            actions = None
        else:
            actions = loop.actions
            plan = (planned.position_error or 0.0, planned.tilt or 0.0)
            judged, _ = self._runner.repeat(start, actions, *plan, planned=scripted)
            outcome = OutcomeRecord.of(judged)
        if not scripted:
            outcome = outcome.model_copy(update={"plan_error_m": None, "tilt_rad": None})
        if ended in FAULTS:
            outcome = outcome.model_copy(update={"success": False, "cause": ended.value, "detail": error})
        return TrialResult(job, outcome, start_poses(layout), ended, error, loop.ticks, tuple(seconds), start, actions)

    def _drive(self, loop: ClosedLoop, job: EpisodeJob, seconds: list[float]) -> tuple[Ended, str]:
        """Let the policy act until it is done, fails or has no time left."""
        limit = trial_ticks(self._config, self._choice)
        hold = int(getattr(self._policy, "ticks", 1))
        action: Action | None = None
        ended = Ended.TIME_LIMIT
        try:
            self._asked(lambda: reset_policy(self._policy, _policy_seed(job)))
            while loop.ticks < limit:
                observation = self._observe(loop)
                began = time.monotonic()
                answer = self._asked(lambda seen=observation: self._policy(seen))  # type: ignore[misc]
                seconds.append(time.monotonic() - began)
                action = read_action(answer, len(self._runner.scene.arms))
                for _ in range(min(hold, limit - loop.ticks)):
                    loop.step(action.ctrl, action.magnet)
                if action.done:
                    ended = Ended.DONE
                    break
        except InvalidActionError as error:
            return Ended.INVALID, str(error)
        except _TooSlowError:
            return Ended.SLOW, f"no answer within {self._choice.call_seconds:g} s, after {loop.ticks} ticks"
        except _PolicyFailedError as error:
            return Ended.RAISED, f"{error}, after {loop.ticks} ticks"
        if loop.holds and action is not None:
            # What is still held was not put down: it is let go, and has the time to fall that a plan's object has.
            for _ in range(self._config.task.timing.settle_ticks):
                loop.step(action.ctrl, False)
        return ended, ""

    def _asked(self, question: Callable[[], T]) -> T:
        """The policy's answer; whatever it raises is its failure."""
        try:
            with _talking_on_stderr(), _time_limit(self._choice.call_seconds):
                return question()
        except (_TooSlowError, TimeoutError) as error:
            raise _TooSlowError from error
        # Code of others may raise anything; it costs this trial alone.
        except Exception as error:
            raise _PolicyFailedError(f"{type(error).__name__}: {error}") from error

    def _observe(self, loop: ClosedLoop) -> Observation:
        scene, replica = self._runner.scene, self._replica
        replica.show(loop.data.qpos)
        T_base = scene.T_base_in_world
        joints = replica.joints()
        seen: dict[str, Any] = {
            "joints": joints,
            "gripper": joints[6::7] if len(scene.arms) > 1 else float(joints[6]),
            "ee_pose_world": T_base @ replica.T_grasp_in_base(),
            "K_scene": replica.intrinsics(SCENE_CAMERA, self._config.image.size_px).K,
            "T_cam_in_world": T_base @ replica.T_cam_in_base(SCENE_CAMERA),
            "time": loop.ticks * self._config.task.timing.tick,
            "prompt": self._config.task.language_prompt,
        }
        if self._cameras:
            drawn = self._runner.draw(loop.data.qpos, tuple(self._cameras.values()))
            seen |= {key: drawn[camera] for key, camera in self._cameras.items()}
        return seen

    def __enter__(self) -> TrialRunner:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        close = getattr(self._policy, "close", None)
        if callable(close):
            with contextlib.suppress(_PolicyFailedError, _TooSlowError):
                self._asked(close)
        self._runner.close()


class _PolicyFailedError(Exception):
    """The policy raised; the text says what."""


class _TooSlowError(Exception):
    """The policy did not answer in time."""


@contextlib.contextmanager
def _time_limit(seconds: float) -> Iterator[None]:
    """Raise in the block when it takes longer; what does not come back to Python at all is left to the worker pool."""

    def ring(number: int, frame: FrameType | None) -> None:
        raise _TooSlowError

    before = signal.signal(signal.SIGALRM, ring)
    # Workers are born deaf to it.
    mask = signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGALRM})
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        signal.signal(signal.SIGALRM, before)


def _policy_seed(job: EpisodeJob) -> int:
    """A seed of its own for every trial, of 32 bits, which every library takes."""
    return (job.seed * 1_000_003 + job.attempt) % 2**32


def _talking_on_stderr() -> contextlib.AbstractContextManager[Any]:
    """What a policy prints must not get into a report on stdout."""
    return contextlib.redirect_stdout(sys.stderr)
