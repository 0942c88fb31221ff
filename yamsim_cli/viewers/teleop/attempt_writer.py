"""Writes teleoperated attempts into the dataset, in order, after a worker process has rendered them."""

from __future__ import annotations

import functools
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import replace

from yamsim_cli.core.attempt_data import AttemptJob, AttemptPayload
from yamsim_cli.core.closable import Closable
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.records import AttemptRecord, attempt_record, episode_record
from yamsim_cli.core.dataset.writing.staged_writer import EpisodeWriter
from yamsim_cli.core.episode.attempt_payload import build_payload, payload_without_files
from yamsim_cli.core.episode.execution import SimulatedAttempt, with_distractors
from yamsim_cli.core.episode.runner import SessionRunner, require_stated_meshes
from yamsim_cli.core.workers.executors import Executor
from yamsim_cli.core.workers.process_pool import ProcessPool

TELEOP_SOURCE = "teleop"

_POLL_SECONDS = 0.1  # s, between checks for a closed writer


class TeleopAttemptRenderer(SessionRunner):
    """Renders successful teleoperated attempts.

    Args:
        render: whether to make images and files of successful attempts; otherwise only outcomes are returned.
    """

    def __init__(self, session: Session, *, render: bool = True) -> None:
        self._render = render
        if render:
            require_stated_meshes(session)
        super().__init__(session)
        # Compile the scene now, since its files may be gone when the first attempt arrives.
        self._simulators.get(AttemptJob(session.config.seed, 0))

    def run(self, simulated: SimulatedAttempt) -> AttemptPayload:
        """Return an attempt's record and, on success, its rendered files."""
        simulator, done = self._simulators.get(simulated.attempt.job), simulated
        if done.outcome.success:
            done = replace(done, attempt=with_distractors(simulator, done.attempt, done.recorded_states))
        return build_payload(simulator, done) if self._render else payload_without_files(done)


TeleopExecutor = Executor[SimulatedAttempt, AttemptPayload]


def open_worker(session: Session) -> ProcessPool[SimulatedAttempt, AttemptPayload]:
    """Start a worker process, so that rendering does not delay the arm."""
    return ProcessPool(functools.partial(TeleopAttemptRenderer, session), 1)


class AttemptWriter(Closable):
    """Sends teleoperated attempts to the executor, and writes the results in order, in a thread: writing can outlast a
    tick.

    Leaving the context drops attempts that are not written yet. Until then, no other code may use the sink or the
    executor. `written` is called with the number of a written attempt.
    """

    def __init__(
        self,
        config: RecordConfig,
        sink: EpisodeWriter,
        executor: TeleopExecutor,
        written: Callable[[int], None] = lambda attempt: None,
    ) -> None:
        self._config, self._sink, self._executor, self._written = config, sink, executor, written
        self._first = len(sink.attempts)
        self._submitted = 0
        self._ended = threading.Event()
        self._thread = ThreadPoolExecutor(1, "yamsim-writer")
        self._futures: deque[Future[AttemptRecord | None]] = deque()
        self.trials: list[AttemptRecord] = []
        self.episodes = sink.episodes

    @property
    def waiting_count(self) -> int:
        """Submitted attempts that `next_written` has not returned yet."""
        return len(self._futures)

    @property
    def next_attempt(self) -> int:
        """Number of the next attempt."""
        return self._first + self._submitted

    def submit(self, simulated: SimulatedAttempt) -> None:
        """Queue an attempt for rendering and writing."""
        self._submitted += 1
        self._futures.append(self._thread.submit(self._render_and_write, simulated))

    def next_written(self, timeout: float = 0.0) -> AttemptRecord | None:
        """Return the record of the next written attempt, waiting up to `timeout` s; None if none was written.

        Raises errors of the disk, of the worker process, and of rendering.
        """
        if not self._futures:
            return None
        # A TimeoutError of the future could also come from a network disk.
        if not wait(list(self._futures)[:1], timeout).done:
            return None
        attempt = self._futures.popleft().result()
        assert attempt is not None  # None only after `close`
        self.trials.append(attempt)
        self.episodes += attempt.episode is not None
        return attempt

    def _render_and_write(self, simulated: SimulatedAttempt) -> AttemptRecord | None:
        try:
            if self._ended.is_set():
                return None
            self._executor.submit(simulated)
            payload = self._wait_for_payload()
            return None if payload is None else self._write_attempt(payload)
        except BaseException:
            # Later attempts would leave a gap in the ledger.
            self._ended.set()
            raise

    def _wait_for_payload(self) -> AttemptPayload | None:
        while not self._ended.is_set():
            try:
                return self._executor.next_result(_POLL_SECONDS)[1]
            except TimeoutError:
                continue
        return None

    def _write_attempt(self, payload: AttemptPayload) -> AttemptRecord:
        number = self._sink.episodes if payload.outcome.success else None
        if number is not None:
            record = episode_record(self._config, payload, number).model_copy(update={"source": TELEOP_SOURCE})
            self._sink.publish_episode(record, dict(payload.files))
        attempt = attempt_record(payload, number)
        self._sink.log_attempt(attempt)
        self._written(attempt.attempt)
        return attempt

    def close(self) -> None:
        """Stop the thread. Attempts that are not written yet are lost."""
        self._ended.set()
        # Wait until an episode that is being written is complete.
        self._thread.shutdown(wait=True, cancel_futures=True)
