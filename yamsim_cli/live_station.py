"""A station (arms, cameras, objects) simulated in real time, for programs that control real stations."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from .core.closable import Closable
from .core.images.image import Image
from .station import Row, Station, StationForm, StationSettings

__all__ = ["LiveStation"]

_MAX_CATCH_UP = 0.1  # s, largest delay that the simulation catches up with; the rest is skipped


class LiveStation(Closable):
    """A station that is simulated in its own thread. Call all methods from one thread, which renders.

    Attributes:
        form: names and shapes of states, commands and pictures.
        lost_s: time that the simulation skipped because its delay was too large, s.

    Args:
        by_clock: whether simulated time follows the clock; otherwise only `advance` steps the simulation.

    Raises:
        ConfigError, UsageError: a setting is not valid.
        ResourceError: nothing can be rendered here.
    """

    def __init__(self, settings: StationSettings, *, by_clock: bool = True) -> None:
        self._station = Station(settings, end="actor")
        self.form: StationForm = self._station.form
        self.lost_s = 0.0
        self._lock, self._over = threading.Lock(), threading.Event()
        self._failure: Exception | None = None
        self._paused, self._resumed = True, False
        self._thread = (
            threading.Thread(target=self._simulate_in_real_time, name="yamsim station", daemon=True)
            if by_clock
            else None
        )
        if self._thread is not None:
            self._thread.start()

    @property
    def trial(self) -> int:
        """Number of the present trial."""
        return self._station.trial

    @property
    def time(self) -> float:
        """Simulated time since the trial's start, s."""
        return self._station.time

    def begin(self, seed: int = 0, trial: int = 0) -> int:
        """Reset to the start of a trial, and return its number. Time is paused meanwhile."""
        with self._paused_time():
            begun = self._station.begin(seed, trial)
            self._station.pictures()  # sets up the renderer, which takes about 1 s
        return begun

    def begin_demonstrated(self, seed: int = 0, trial: int = 0) -> NDArray[np.float32]:
        """Reset to a trial in which the expert succeeds, and return its commands (frames, numbers)."""
        with self._paused_time():
            rows = self._station.begin_demonstrated(seed, trial)
            self._station.pictures()
        return rows

    def command(self, row: NDArray[np.floating]) -> None:
        """Set the command row (one number per name in `form.action`), which acts until the next command."""
        with self._lock:
            self._station.command(row)

    def advance(self) -> None:
        """Simulate one frame, unless simulated time follows the clock."""
        if self._thread is None:
            self._station.advance()

    def observe(self) -> tuple[Row, dict[str, Image]]:
        """Return the state, and camera -> picture (height, width, 3), of the same moment.

        Raises:
            Exception: the exception that stopped the simulation thread, if any.
        """
        with self._lock:
            if self._failure is not None:
                raise self._failure
            state, positions = self._station.state(), self._station.positions()
        return state, self._station.pictures(positions=positions)

    def judge(self) -> str:
        """Return why the trial is not successful at present; "" on success. Time is paused meanwhile."""
        with self._paused_time():
            return self._station.judge()

    def close(self) -> None:
        """Stop the simulation, and free the renderers."""
        self._over.set()
        if self._thread is not None:
            self._thread.join()
        self._station.close()

    @contextmanager
    def _paused_time(self) -> Iterator[None]:
        """Pause time in the block. After an exception in the block, time stays paused."""
        with self._lock:
            self._paused = True
            yield
            self._paused, self._resumed = False, True

    def _simulate_in_real_time(self) -> None:
        due = time.monotonic()
        while not self._over.wait(max(0.0, due - time.monotonic())):
            with self._lock:
                now = time.monotonic()
                if self._paused or self._resumed:
                    due, self._resumed = now, False
                elif now - due > _MAX_CATCH_UP:
                    self.lost_s += now - due
                    due = now
                if not self._paused:
                    self._tick()
            due += self._station.tick_s

    def _tick(self) -> None:
        try:
            self._station.tick()
        # `observe` raises the exception in the thread of the caller.
        except Exception as error:  # noqa: BLE001
            self._failure, self._paused = error, True
