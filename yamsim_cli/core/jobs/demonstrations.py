"""What a person or a leader arm did, judged and drawn by a worker, and put into the dataset in order."""

from __future__ import annotations

import functools
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Protocol

from ..config.record import RecordConfig
from ..dataset.records import AttemptRecord, attempt_record
from ..geometry.se3 import Array
from ..resources import Locations
from ..types import Actions, EpisodeJob, EpisodePayload, Outcome
from .collect import Sink, episode_record
from .episode import EpisodeRunner
from .executor import Executor
from .workers import WorkerPool

SOURCE = "teleop"


@dataclass(frozen=True)
class Demonstration:
    """An attempt that was driven from outside.

    Attributes:
        job: its number, and the seed that its layout came from.
        layout: object -> start pose `[x, y, z, yaw]` in `world`, m and rad.
        start: MuJoCo's positions (nq,) at the beginning.
        actions: what acted since.
    """

    job: EpisodeJob
    layout: Mapping[str, tuple[float, float, float, float]]
    start: Array
    actions: Actions


class DemonstrationRunner:
    """Judges a demonstration by its actions, as `verify` will, and draws it if it succeeded; a context manager."""

    def __init__(
        self, config: RecordConfig, locations: Locations, meshes: Mapping[str, Path | None], *, draw: bool = True
    ) -> None:
        self._runner = EpisodeRunner(config, locations, meshes, draw=draw)

    def run(self, demonstration: Demonstration) -> EpisodePayload:
        """The attempt's payload; there was no plan whose errors could be told."""
        outcome, rollout = self._runner.repeat(demonstration.start, demonstration.actions, 0.0, 0.0)
        outcome = replace(outcome, position_error=None, tilt=None)
        return self._runner.payload(demonstration.job, demonstration.layout, outcome, rollout)

    def __enter__(self) -> DemonstrationRunner:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._runner.close()


DemonstrationExecutor = Executor[Demonstration, EpisodePayload]


def open_worker(
    config: RecordConfig, locations: Locations, meshes: Mapping[str, Path | None]
) -> WorkerPool[Demonstration, EpisodePayload]:
    """A process beside this one, so that neither judging nor drawing holds the arm up."""
    return WorkerPool(functools.partial(DemonstrationRunner, config, locations, dict(meshes)), 1)


class Inbox(Protocol):
    """Takes demonstrations."""

    @property
    def next_attempt(self) -> int:
        """The number of the attempt that comes next."""
        ...

    def hand_in(self, demonstration: Demonstration) -> None:
        """Take one, to be judged."""
        ...


class Desk:
    """Has demonstrations judged one after the other, and writes them as they come back.

    Attributes:
        outcomes: of all that were judged here, in order, each with its episode's number or None.
    """

    def __init__(self, config: RecordConfig, sink: Sink, executor: DemonstrationExecutor) -> None:
        self._config, self._sink, self._executor = config, sink, executor
        self._waiting: deque[Demonstration] = deque()
        self.outcomes: list[tuple[AttemptRecord, Outcome]] = []

    @property
    def waiting(self) -> int:
        """How many are not judged yet."""
        return len(self._waiting) + self._executor.in_flight

    @property
    def next_attempt(self) -> int:
        """The number of the attempt that comes next."""
        return len(self._sink.attempts) + self.waiting

    @property
    def episodes(self) -> int:
        """How many the dataset holds."""
        return self._sink.episodes

    def hand_in(self, demonstration: Demonstration) -> None:
        """Take one, to be judged."""
        self._waiting.append(demonstration)

    def poll(self, timeout: float) -> Outcome | None:
        """Go on with what is waiting, for at most `timeout` seconds; the outcome of one that was written meanwhile.

        Raises:
            OSError: the disk refused something.
            PartialJobError: the worker does not last.
            ResourceError: nothing can be drawn here.
        """
        if self._waiting and not self._executor.in_flight:
            self._executor.submit(self._waiting.popleft())
        if not self._executor.in_flight:
            return None
        try:
            _, payload = self._executor.result(timeout)
        except TimeoutError:
            return None
        self._write(payload)
        return payload.outcome

    def _write(self, payload: EpisodePayload) -> None:
        number = self._sink.episodes if payload.outcome.success else None
        if number is not None:
            record = episode_record(self._config, payload, number).model_copy(update={"source": SOURCE})
            self._sink.publish(record, dict(payload.files))
        attempt = attempt_record(payload, number)
        self._sink.log(attempt)
        self.outcomes.append((attempt, payload.outcome))
