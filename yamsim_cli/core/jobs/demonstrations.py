"""What a person or a leader arm did, judged and drawn by a worker, and put into the dataset in order."""

from __future__ import annotations

import functools
import threading
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Protocol

from ..config.record import RecordConfig
from ..dataset.records import AttemptRecord, attempt_record
from ..geometry.se3 import Array
from ..resources import Locations
from ..types import Actions, EpisodeJob, EpisodePayload
from .collect import Sink, episode_record
from .episode import EpisodeRunner
from .executor import Executor
from .workers import WorkerPool

SOURCE = "teleop"

# How often a waiting desk looks whether it is still open.
_POLL_SECONDS = 0.1


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
        outcome, rollout = self._runner.demonstrate(demonstration.job, demonstration.start, demonstration.actions)
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
    """Has demonstrations judged one after the other, and writes them in that order, in a thread of its own.

    Flushing an episode to a disk can take longer than a control tick. A context manager: at its end, what is not judged
    yet is given up. While it is open, nobody else may use the sink or the executor.

    Args:
        written: called with an attempt's number once it is in the sink.
    """

    def __init__(
        self,
        config: RecordConfig,
        sink: Sink,
        executor: DemonstrationExecutor,
        written: Callable[[int], None] = lambda attempt: None,
    ) -> None:
        self._config, self._sink, self._executor, self._written = config, sink, executor, written
        self._first = len(sink.attempts)
        self._handed_in = 0
        self._ended = threading.Event()
        self._thread = ThreadPoolExecutor(1, "yamsim-desk")
        self._futures: deque[Future[AttemptRecord | None]] = deque()
        self.trials: list[AttemptRecord] = []
        self.episodes = sink.episodes

    @property
    def waiting(self) -> int:
        """How many are not judged yet, or not told of yet."""
        return len(self._futures)

    @property
    def next_attempt(self) -> int:
        """The number of the attempt that comes next."""
        return self._first + self._handed_in

    def hand_in(self, demonstration: Demonstration) -> None:
        """Take one, to be judged."""
        self._handed_in += 1
        self._futures.append(self._thread.submit(self._judge, demonstration))

    def news(self, timeout: float = 0.0) -> AttemptRecord | None:
        """The next one that is judged and written, waited for at most `timeout` seconds.

        Raises:
            OSError: the disk refused something.
            PartialJobError: the worker does not last.
            ResourceError: nothing can be drawn here.
        """
        if not self._futures:
            return None
        # Not by its own time limit: a network disk's is the same error.
        if not wait(list(self._futures)[:1], timeout).done:
            return None
        attempt = self._futures.popleft().result()
        assert attempt is not None  # nobody asks once it is closed
        self.trials.append(attempt)
        self.episodes += attempt.episode is not None
        return attempt

    def _judge(self, demonstration: Demonstration) -> AttemptRecord | None:
        try:
            if self._ended.is_set():
                return None
            self._executor.submit(demonstration)
            payload = self._payload()
            return None if payload is None else self._write(payload)
        except BaseException:
            # The ones after it would leave a gap in the ledger.
            self._ended.set()
            raise

    def _payload(self) -> EpisodePayload | None:
        """What the worker makes of it; None where nobody waits for it any more."""
        while not self._ended.is_set():
            try:
                return self._executor.result(_POLL_SECONDS)[1]
            except TimeoutError:
                continue
        return None

    def _write(self, payload: EpisodePayload) -> AttemptRecord:
        number = self._sink.episodes if payload.outcome.success else None
        if number is not None:
            record = episode_record(self._config, payload, number).model_copy(update={"source": SOURCE})
            self._sink.publish(record, dict(payload.files))
        attempt = attempt_record(payload, number)
        self._sink.log(attempt)
        self._written(attempt.attempt)
        return attempt

    def __enter__(self) -> Desk:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        # What is being written is written: never half an episode.
        self._thread.shutdown(wait=True, cancel_futures=True)
