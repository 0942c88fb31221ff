from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.dataset_paths import episode_name
from yamsim_cli.core.dataset.disk_errors import explain_disk_error
from yamsim_cli.core.dataset.records import AttemptRecord
from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode
from yamsim_cli.core.dataset.writing.writer import DatasetWriter, config_for_new_episodes
from yamsim_cli.core.errors import PartialJobError
from yamsim_cli.core.scene.build import with_mesh_descriptions
from yamsim_cli.core.workers.stop_request import StopRequest

from ..page_address import PageAddress
from ..show.viewer import require_viser, task_viewpoint
from .attempt_writer import AttemptWriter, open_worker
from .command_stream import StreamPlayer, TeleopCommand
from .recording_journal import RecordingJournal
from .teleop_scene import TIME_LIMIT, TeleopScene

_MAX_CATCH_UP = 0.25  # s, largest delay that the loop catches up with; the rest is skipped
_POLL_SECONDS = 0.5  # s, longest single wait at the end of a session


@dataclass(frozen=True)
class TickJitter:
    """Deviations of the time between control ticks from its nominal value, ms.

    Attributes:
        p50, p95, max: median, 95th percentile and maximum.
        late: ticks that began more than half a tick late.
        lost: time that the loop skipped because its delay was too large, ms. The recording still has every tick.
    """

    rate_hz: float
    ticks: int
    p50: float
    p95: float
    max: float
    late: int
    lost: float


class TickClock:
    """Paces a loop at a fixed period (s), and measures the jitter."""

    def __init__(self, period: float) -> None:
        self._period = period
        self._due = time.monotonic()
        self._began: list[float] = []
        self._late = 0
        self._lost = 0.0

    def wait(self) -> None:
        """Sleep until the next tick is due."""
        now = time.monotonic()
        due = self._due
        if now - self._due > _MAX_CATCH_UP:
            self._lost += now - self._due
            self._due = now
        time.sleep(max(0.0, self._due - now))
        self._began.append(time.monotonic())
        self._late += self._began[-1] - due > self._period / 2
        self._due += self._period

    @property
    def jitter(self) -> TickJitter | None:
        """Jitter of the ticks so far; None before the second tick."""
        if len(self._began) < 2:
            return None
        off = 1000 * np.abs(np.diff(self._began) - self._period)
        p50, p95 = np.percentile(off, (50, 95))
        rate, ticks, most = 1 / self._period, len(self._began), float(off.max())
        return TickJitter(rate, ticks, float(p50), float(p95), most, self._late, 1000 * self._lost)


@dataclass(frozen=True)
class TeleopReport:
    """Result of a teleoperation session.

    Attributes:
        episodes, attempts: in the whole dataset; `trials` are of this session.
        jitter: None if ticks did not follow the clock.
    """

    path: Path
    episodes: int
    attempts: int
    discarded: int
    trials: tuple[AttemptRecord, ...]
    jitter: TickJitter | None


@dataclass(frozen=True)
class TeleopSession:
    """Scene, writer of attempts, and dataset of an open session."""

    scene: TeleopScene
    attempts: AttemptWriter
    dataset: DatasetWriter

    def update_scene_status(self, timeout: float = 0.0) -> None:
        """Update the scene's counts and message from the next attempt that is written within `timeout` s."""
        scene, attempts = self.scene, self.attempts
        attempt = attempts.next_written(timeout)
        scene.episodes, scene.waiting = attempts.episodes, attempts.waiting_count
        if attempt is not None:
            scene.failures += attempt.episode is None
            end = f"failed: {attempt.outcome.detail}" if attempt.episode is None else episode_name(attempt.episode)
            scene.message = f"attempt {attempt.attempt}: {end}"

    def finish(self, jitter: TickJitter | None) -> TeleopReport:
        """Wait until all attempts are written, and return the report."""
        while self.attempts.waiting_count:
            self.update_scene_status(_POLL_SECONDS)
        data, trials = self.dataset, tuple(self.attempts.trials)
        data.write_manifest()
        return TeleopReport(data.path, data.episodes, len(data.attempts), self.scene.discarded, trials, jitter)


def check_page(address: PageAddress) -> None:
    """Raise unless a page can be served."""
    require_viser()
    from ..scene_page import require_free_address

    require_free_address(address)


@contextlib.contextmanager
def open_teleop(
    session: Session,
    out: Path,
    mode: ExistingDatasetMode,
    warn: Callable[[str], None],
    *,
    time_limit: float = TIME_LIMIT,
) -> Iterator[TeleopSession]:
    """Open a dataset and a scene for teleoperation. Recordings of killed sessions are judged first.

    At `time_limit`, s, a recording is stopped and judged.
    """
    session = with_mesh_descriptions(session)
    config = session.config
    with DatasetWriter(out, config.data_config(), mode) as writer:
        if writer.moved_aside:
            warn(f"What was in {out} is now in {writer.moved_aside}.")
        for repair in writer.repairs:
            warn(repair.removesuffix(", to be recorded again"))
        for number in sorted(writer.lost_lines):
            # A demonstration cannot be repeated, so write a placeholder record to the ledger.
            writer.log_attempt(writer.attempts[number])
        for lost in writer.attempts_without_episode:
            warn(f"{episode_name(lost.episode or 0)} is missing, and a teleoperated episode cannot be recorded again.")
        try:
            journal = RecordingJournal(writer.path)
            with (
                open_worker(session) as worker,
                AttemptWriter(
                    config_for_new_episodes(config, writer), writer, worker, journal.delete_recording
                ) as attempts,
            ):
                scene = TeleopScene(session, attempts, journal, time_limit)
                _submit_unfinished(scene, attempts, journal, warn)
                yield TeleopSession(scene, attempts, writer)
        except OSError as error:
            raise PartialJobError(
                f"{explain_disk_error(error, out)}: {writer.episodes} complete episodes are in {out}; "
                "continue with --resume"
            ) from error
        except BaseException:
            with contextlib.suppress(OSError):
                writer.write_manifest()
            raise


def _submit_unfinished(
    scene: TeleopScene, attempts: AttemptWriter, journal: RecordingJournal, warn: Callable[[str], None]
) -> None:
    """Submit recordings of killed sessions that continue the dataset without a gap."""
    for left in journal.unfinished_recordings():
        attempt = left.job.attempt
        if attempt < attempts.next_attempt or not left.ticks:
            # The attempt is in the dataset already, or has no tick.
            journal.delete_recording(attempt)
        elif attempt > attempts.next_attempt:
            warn(f"{left.path} is kept, because attempts before this recording are missing.")
        else:
            seconds = len(left.ticks) * scene.tick_seconds
            warn(f"A killed session left attempt {attempt} ({seconds:.1f} s), which is judged now.")
            scene.submit_unfinished(left)


def run_stream(
    session: TeleopSession, commands: Sequence[TeleopCommand], stop: StopRequest, *, realtime: bool
) -> TeleopReport:
    """Teleoperate by a command stream. Its end stops a recording; a stop request discards it.

    Without `realtime`, ticks run as fast as possible, with the same result.
    """
    scene, player = session.scene, StreamPlayer(commands)
    clock = TickClock(scene.tick_seconds) if realtime else None
    while not stop.is_requested:
        if clock is not None:
            clock.wait()
        player.apply_due_commands(scene, scene.simulated_seconds)
        if player.is_done:
            break
        scene.advance_tick()
        session.update_scene_status()
    if scene.is_recording and not stop.is_requested:
        scene.stop_recording()
    _end_recording(scene)
    return session.finish(clock.jitter if clock else None)


def _end_recording(scene: TeleopScene) -> None:
    scene.settle()
    if scene.is_recording:
        scene.discard_recording()


def run_page(
    session: TeleopSession, config: RecordConfig, address: PageAddress, ready: Callable[[str], None], stop: StopRequest
) -> TeleopReport:
    """Serve a page until the user ends the session, then discard an unfinished recording.

    `ready` is called with the URL.
    """
    from ..teleop_page import TeleopPage

    page = TeleopPage(session.scene, task_viewpoint(config), address)
    clock = TickClock(session.scene.tick_seconds)
    try:
        if not stop.is_requested:
            ready(page.url)
        while not stop.is_requested:
            clock.wait()
            session.scene.advance_tick()
            page.update()
            session.update_scene_status()
    finally:
        page.close()
    _end_recording(session.scene)
    return session.finish(clock.jitter)
