"""Let arms be driven: by a stream, or on a page by a person."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..config.recording import RecordConfig
from ..dataset.disk_faults import explain
from ..dataset.layout import episode_name
from ..dataset.records import AttemptRecord
from ..dataset.writing.opening import OpenMode
from ..dataset.writing.writer import DatasetWriter
from ..errors import PartialJobError
from ..record.destination import config_as_stated
from ..scene.build import noting_meshes
from ..session import Session
from ..show.view import require_page, task_viewpoint
from ..viewers.address import PageAddress
from ..workers.stop import Stop
from .desk import Desk, open_worker
from .driven_scene import TIME_LIMIT, DrivenScene
from .journal import Journal
from .stream import Command, Player

# A loop that fell behind by more goes on from where it is instead of racing, s.
_LONGEST_CATCH_UP = 0.25
# How long the end of a session waits for news at a time, s.
_PATIENCE = 0.5


@dataclass(frozen=True)
class Jitter:
    """How far the time between two control ticks was from what it should be, ms.

    Attributes:
        rate_hz: how many ticks there should be in a second.
        ticks: how many there were.
        p50, p95, max: median, 95 % and most.
        late: how many began more than half a tick after they were due.
        lost: time that the clock ran on without the simulation, when the loop was too far behind to catch up, ms. What
            is recorded lacks no tick by it; for whoever drives, it stood still.
    """

    rate_hz: float
    ticks: int
    p50: float
    p95: float
    max: float
    late: int
    lost: float


class Pace:
    """Keeps a loop at one turn a period, on a steady clock, and measures how well."""

    def __init__(self, period: float) -> None:
        self._period = period
        self._due = time.monotonic()
        self._began: list[float] = []
        self._late = 0
        self._lost = 0.0

    def wait(self) -> None:
        """Until the next turn is due."""
        now = time.monotonic()
        due = self._due
        if now - self._due > _LONGEST_CATCH_UP:
            self._lost += now - self._due
            self._due = now
        time.sleep(max(0.0, self._due - now))
        self._began.append(time.monotonic())
        self._late += self._began[-1] - due > self._period / 2
        self._due += self._period

    @property
    def jitter(self) -> Jitter | None:
        """None before the second turn."""
        if len(self._began) < 2:
            return None
        off = 1000 * np.abs(np.diff(self._began) - self._period)
        p50, p95 = np.percentile(off, (50, 95))
        rate, ticks, most = 1 / self._period, len(self._began), float(off.max())
        return Jitter(rate, ticks, float(p50), float(p95), most, self._late, 1000 * self._lost)


@dataclass(frozen=True)
class TeleopReport:
    """What a session did.

    Attributes:
        episodes, attempts: in the dataset now.
        trials: of this session, in order.
        jitter: of the control ticks; None where they were not held to the clock.
    """

    path: Path
    episodes: int
    attempts: int
    discarded: int
    trials: tuple[AttemptRecord, ...]
    jitter: Jitter | None


@dataclass(frozen=True)
class Seat:
    """All that whoever drives needs: the arms in their scene, and the desk that takes what was done with them."""

    scene: DrivenScene
    desk: Desk
    writer: DatasetWriter

    def look(self, timeout: float = 0.0) -> None:
        """Let the scene know what came of its attempts; raises as `Desk.news`."""
        scene, desk = self.scene, self.desk
        news = desk.news(timeout)
        scene.episodes, scene.waiting = desk.episodes, desk.waiting
        if news is not None:
            scene.failures += news.episode is None
            end = f"failed: {news.outcome.detail}" if news.episode is None else episode_name(news.episode)
            scene.message = f"attempt {news.attempt}: {end}"

    def finish(self, jitter: Jitter | None) -> TeleopReport:
        """Wait for what is not judged yet."""
        while self.desk.waiting:
            self.look(_PATIENCE)
        self.writer.finish()
        writer, trials = self.writer, tuple(self.desk.trials)
        return TeleopReport(writer.path, writer.episodes, len(writer.attempts), self.scene.discarded, trials, jitter)


def check_page(address: PageAddress) -> None:
    """Make sure that a page can be served, before a dataset is begun for it.

    Raises:
        UsageError: the address cannot be had.
        ResourceError: the viewer library is not installed.
    """
    require_page()
    from ..viewers.bodies_page import check_free

    check_free(address)


@contextlib.contextmanager
def open_seat(
    session: Session,
    out: Path,
    mode: OpenMode,
    warn: Callable[[str], None],
    *,
    time_limit: float = TIME_LIMIT,
) -> Iterator[Seat]:
    """Open a dataset and an arm to fill it with; what a killed session left in it is judged first.

    Args:
        time_limit: of a recording, s; then it is stopped and judged.

    Raises:
        UsageError, ConfigError, DatasetError, ResourceError: see `DatasetWriter`.
        PartialJobError: the disk refused something.
    """
    session = noting_meshes(session)
    config = session.config
    with DatasetWriter(out, config.data_config(), mode) as writer:
        if writer.moved_aside:
            warn(f"What was in {out} is now in {writer.moved_aside}.")
        for repair in writer.repairs:
            warn(repair.removesuffix(", and made again"))
        for number in sorted(writer.lost_lines):
            # A demonstration cannot be made again; this says so in the ledger too.
            writer.log(writer.attempts[number])
        for lost in writer.missing:
            warn(f"{episode_name(lost.episode or 0)} is gone, and a demonstration cannot be made again.")
        try:
            journal = Journal(writer.path)
            with (
                open_worker(session) as worker,
                Desk(config_as_stated(config, writer), writer, worker, journal.drop) as desk,
            ):
                scene = DrivenScene(session, desk, journal, time_limit)
                _take_up(scene, desk, journal, warn)
                yield Seat(scene, desk, writer)
        except OSError as error:
            raise PartialJobError(
                f"{explain(error, out)}: {writer.episodes} episodes are whole in {out}; continue with --resume"
            ) from error
        except BaseException:
            with contextlib.suppress(OSError):
                writer.finish()
            raise


def _take_up(scene: DrivenScene, desk: Desk, journal: Journal, warn: Callable[[str], None]) -> None:
    """Have what killed sessions left judged, as far as it still fits the dataset."""
    for left in journal.unfinished():
        attempt = left.job.attempt
        if attempt < desk.next_attempt or not left.ticks:
            # It was written before the session was killed, or nothing ever happened in it.
            journal.drop(attempt)
        elif attempt > desk.next_attempt:
            warn(f"{left.path} is a recording that attempts are missing before; it stays as it is.")
        else:
            seconds = len(left.ticks) * scene.tick_seconds
            warn(f"Attempt {attempt}, {seconds:.1f} s long, was left by a session that was killed: it is judged now.")
            scene.take_up(left)


def run_stream(seat: Seat, commands: Sequence[Command], stop: Stop, *, realtime: bool) -> TeleopReport:
    """Let a stream drive the arm; a recording that is still going on at its end is stopped, and
    discarded where the user ends it.

    Args:
        realtime: hold the ticks to the clock; else they follow each other as fast as they can, with the same result.
    """
    scene, player = seat.scene, Player(commands)
    pace = Pace(scene.tick_seconds) if realtime else None
    while not stop.asked:
        if pace is not None:
            pace.wait()
        player.act(scene, scene.time)
        if player.done:
            break
        scene.tick()
        seat.look()
    if scene.recording and not stop.asked:
        scene.stop()
    _leave(scene)
    return seat.finish(pace.jitter if pace else None)


def _leave(scene: DrivenScene) -> None:
    """What was stopped is handed in; what was not is discarded."""
    scene.settle()
    if scene.recording:
        scene.discard()


def run_page(
    seat: Seat, config: RecordConfig, address: PageAddress, ready: Callable[[str], None], stop: Stop
) -> TeleopReport:
    """Serve a page until `stop` says so; a recording that is going on then is discarded.

    Args:
        address: see `check_page`.
        ready: called with the page's URL once it is up, unless it is no longer wanted.

    Raises:
        UsageError: the address cannot be had.
    """
    from ..viewers.teleop_page import TeleopPage

    page = TeleopPage(seat.scene, task_viewpoint(config), address)
    pace = Pace(seat.scene.tick_seconds)
    try:
        if not stop.asked:
            ready(page.url)
        while not stop.asked:
            pace.wait()
            seat.scene.tick()
            page.update()
            seat.look()
    finally:
        page.close()
    _leave(seat.scene)
    return seat.finish(pace.jitter)
