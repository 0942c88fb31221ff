"""What a person or a leader arm did, rendered by a worker, and put into the dataset in order."""

from __future__ import annotations

import functools
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import replace
from typing import Protocol

from ..attempt.engine import Simulated, with_distractors
from ..attempt.payload import payload, result
from ..attempt.runner import require_meshes
from ..attempt.simulators import Simulators
from ..closing import Closing
from ..config.recording import RecordConfig
from ..dataset.records import AttemptRecord, attempt_record
from ..record.collect import Sink, episode_record
from ..session import Session
from ..types import EpisodeJob, EpisodePayload
from ..workers.executor import Executor
from ..workers.processes import WorkerPool

SOURCE = "teleop"

# How often a waiting desk looks whether it is still open.
_POLL_SECONDS = 0.1


class DrivenRunner(Closing):
    """Renders driven attempts that succeeded; they were judged while they were driven.

    Args:
        render: whether successes become files.
    """

    def __init__(self, session: Session, *, render: bool = True) -> None:
        self._render = render
        if render:
            require_meshes(session)
        self._simulators = Simulators(session)
        # Now, since the files that it is made from need not be there any more when the first attempt comes.
        self._simulators.of(EpisodeJob(session.config.seed, 0))

    def run(self, driven: Simulated) -> EpisodePayload:
        """What is recorded of an attempt."""
        simulator, done = self._simulators.of(driven.attempt.job), driven
        if done.outcome.success:
            done = replace(done, attempt=with_distractors(simulator, done.attempt, done.states))
        return payload(simulator, done) if self._render else result(done)

    def close(self) -> None:
        """Free the renderers."""
        self._simulators.close()


DrivenExecutor = Executor[Simulated, EpisodePayload]


def open_worker(session: Session) -> WorkerPool[Simulated, EpisodePayload]:
    """A process beside this one, so that rendering does not hold the arm up."""
    return WorkerPool(functools.partial(DrivenRunner, session), 1)


class Inbox(Protocol):
    """Takes driven attempts."""

    @property
    def next_attempt(self) -> int:
        """The number of the attempt that comes next."""
        ...

    def hand_in(self, driven: Simulated) -> None:
        """Take one, to be judged."""
        ...


class Desk(Closing):
    """Has driven attempts judged one after the other, and writes them in that order, in a thread of its own.

    Flushing an episode to a disk can take longer than a control tick. A context manager: at its end, what is not judged
    yet is given up. While it is open, nobody else may use the sink or the executor.

    Args:
        written: called with an attempt's number once it is in the sink.
    """

    def __init__(
        self,
        config: RecordConfig,
        sink: Sink,
        executor: DrivenExecutor,
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

    def hand_in(self, driven: Simulated) -> None:
        """Take one, to be judged."""
        self._handed_in += 1
        self._futures.append(self._thread.submit(self._judge, driven))

    def news(self, timeout: float = 0.0) -> AttemptRecord | None:
        """The next one that is judged and written, waited for at most `timeout` seconds.

        Raises:
            OSError: the disk refused something.
            PartialJobError: the worker does not last.
            ResourceError: nothing can be rendered here.
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

    def _judge(self, driven: Simulated) -> AttemptRecord | None:
        try:
            if self._ended.is_set():
                return None
            self._executor.submit(driven)
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

    def close(self) -> None:
        """Give up what is not judged yet."""
        self._ended.set()
        # What is being written is written: never half an episode.
        self._thread.shutdown(wait=True, cancel_futures=True)
