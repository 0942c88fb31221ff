"""A simulated station in real time, for programs of real ones."""

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

_MAX_CATCH_UP = 0.1  # s; when it is farther behind, the simulation continues from the present time


class LiveStation(Closable):
    """A station that moves in a thread of its own while it is open. Only one thread may use it, in which it renders.

    Attributes:
        form: names and shapes of its rows and pictures.
        lost_s: time that the simulation skipped because it was too far behind to catch up, s.

    Args:
        by_clock: whether time passes by the clock; otherwise only `advance` lets time pass.

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
        self._thread = threading.Thread(target=self._run, name="yamsim station", daemon=True) if by_clock else None
        if self._thread is not None:
            self._thread.start()

    @property
    def trial(self) -> int:
        """Number of the trial."""
        return self._station.trial

    @property
    def time(self) -> float:
        """Simulated time since the trial's start, s."""
        return self._station.time

    def begin(self, seed: int = 0, trial: int = 0) -> int:
        """Put everything to the start of a trial, see `Station.begin`; time is paused meanwhile."""
        with self._pause():
            begun = self._station.begin(seed, trial)
            self._station.pictures()  # The first picture sets up the renderer, which takes a second.
        return begun

    def begin_demonstrated(self, seed: int = 0, trial: int = 0) -> NDArray[np.float32]:
        """Put everything to the start of a recorded episode, see `Station.begin_demonstrated`; time is paused."""
        with self._pause():
            rows = self._station.begin_demonstrated(seed, trial)
            self._station.pictures()
        return rows

    def command(self, row: NDArray[np.floating]) -> None:
        """Set the command that acts from now on, see `Station.command`."""
        with self._lock:
            self._station.command(row)

    def advance(self) -> None:
        """Let a frame's time pass, unless time passes by the clock."""
        if self._thread is None:
            self._station.advance()

    def observe(self) -> tuple[Row, dict[str, Image]]:
        """Joints and grippers (numbers of a state,), and camera -> picture (height, width, 3), of the same state.

        Raises:
            Exception: the exception that stopped the simulation.
        """
        with self._lock:
            if self._failure is not None:
                raise self._failure
            state, positions = self._station.state(), self._station.positions()
        return state, self._station.pictures(positions=positions)

    def judge(self) -> str:
        """Why the trial is no success at present; empty if it is a success. Time is paused meanwhile."""
        with self._pause():
            return self._station.judge()

    def close(self) -> None:
        """Stop the simulation, and free the renderers."""
        self._over.set()
        if self._thread is not None:
            self._thread.join()
        self._station.close()

    @contextmanager
    def _pause(self) -> Iterator[None]:
        """Pause time in the block, and after an exception in it."""
        with self._lock:
            self._paused = True
            yield
            self._paused, self._resumed = False, True

    def _run(self) -> None:
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
        # `observe` raises the exception in the caller's thread.
        except Exception as error:  # noqa: BLE001
            self._failure, self._paused = error, True
