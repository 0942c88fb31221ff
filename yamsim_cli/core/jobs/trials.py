"""One trial of a policy: from the start that `pickplace batch` makes of the same numbers, and judged as there."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from types import TracebackType

from ..config.record import RecordConfig
from ..dataset.records import OutcomeRecord
from ..geometry.se3 import Array
from ..policies.base import Action, InvalidActionError, Observation, read_action
from ..policies.faults import Fault
from ..policies.loading import reset_policy, wanted_images, wanted_state
from ..resources import Locations
from ..sim.closed_loop import ClosedLoop
from ..stray_forks import forks_end_here
from ..tasks.kinds import kind_of
from ..types import Actions, EpisodeJob, Outcome
from ..vision.renderer import Image
from .asking import Asker, PolicyFailedError, TooSlowError, talking_on_stderr
from .builtin_policies import Privileged, Scripted, Trial, make_policy
from .episode import EpisodeRunner, start_poses
from .observation import Observer, Pictures


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
# The policy had its say to the end.
MEASURED = (Ended.DONE, Ended.TIME_LIMIT)

_NO_FAULT = Fault("")


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
        traceback: of what it raised; empty if it raised nothing.
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
    traceback: str = ""
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
        with talking_on_stderr(), forks_end_here():
            self._policy = make_policy(choice.name, choice.folder, choice.call_seconds)
        self._asker = Asker(choice.call_seconds, choice.folder)
        self._runner = EpisodeRunner(config, locations, meshes, draw=False)
        wanted = wanted_images(self._policy), wanted_state(self._policy)
        self._observer = Observer(config, self._runner.scene, *wanted)

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
        ended, fault = self._drive(loop, job, seconds)
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
            outcome = outcome.model_copy(update={"success": False, "cause": ended.value, "detail": fault.text})
        told = (fault.text, fault.traceback, loop.ticks, tuple(seconds))
        return TrialResult(job, outcome, start_poses(layout), ended, *told, start, actions)

    def _drive(self, loop: ClosedLoop, job: EpisodeJob, seconds: list[float]) -> tuple[Ended, Fault]:
        """Let the policy act until it is done, fails or has no time left."""
        limit = trial_ticks(self._config, self._choice)
        hold = int(getattr(self._policy, "ticks", 1))
        action: Action | None = None
        ended = Ended.TIME_LIMIT
        pictures = Pictures(self._draw)
        try:
            self._asker.ask(lambda: reset_policy(self._policy, _policy_seed(job)))
            while loop.ticks < limit:
                answer = self._ask(self._observer.observe(loop, pictures), pictures)
                seconds.append(self._asker.seconds)
                action = read_action(answer, len(self._runner.scene.arms))
                for _ in range(min(hold, limit - loop.ticks)):
                    loop.step(action.ctrl, action.magnet)
                if action.done:
                    ended = Ended.DONE
                    break
        except InvalidActionError as error:
            return Ended.INVALID, Fault(str(error))
        except TooSlowError:
            return Ended.SLOW, Fault(f"no answer within {self._choice.call_seconds:g} s, after {loop.ticks} ticks")
        except PolicyFailedError as error:
            return Ended.RAISED, Fault(f"{error}, after {loop.ticks} ticks", error.fault.traceback)
        finally:
            pictures.end()
        if loop.holds and action is not None:
            # What is still held was not put down: it is let go, and has the time to fall that a plan's object has.
            for _ in range(self._config.task.timing.settle_ticks):
                loop.step(action.ctrl, False)
        return ended, _NO_FAULT

    def _ask(self, observation: Observation, pictures: Pictures) -> object:
        """The policy's answer to an observation."""
        try:
            return self._asker.ask(lambda: self._policy(observation))
        finally:
            if pictures.failure is not None:
                raise pictures.failure

    def _draw(self, qpos: Array, camera: str) -> Image:
        with self._asker.waits():
            return self._runner.draw(qpos, (camera,))[camera]

    def __enter__(self) -> TrialRunner:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        close = getattr(self._policy, "close", None)
        if callable(close):
            with contextlib.suppress(PolicyFailedError, TooSlowError):
                self._asker.ask(close)
        self._runner.close()


def _policy_seed(job: EpisodeJob) -> int:
    """A seed of its own for every trial, of 32 bits, which every library takes."""
    return (job.seed * 1_000_003 + job.attempt) % 2**32
