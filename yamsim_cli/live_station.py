"""A station in simulation whose time passes by the clock, for programs that expect a real one."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.typing import NDArray

from .core.closing import Closing
from .core.images.image import Image
from .station import Row, Station, StationForm, StationSettings

__all__ = ["LiveStation"]

# Behind by more, the simulation goes on from where it is instead of racing, s.
_LONGEST_CATCH_UP = 0.1


class LiveStation(Closing):
    """A station that moves in a thread of its own, as long as it is open. One thread uses it: that which draws.

    Attributes:
        form: what its rows and pictures are.
        lost_s: time that the clock ran on without the simulation, when it was too far behind to catch up.

    Args:
        by_clock: whether time passes by itself; otherwise only when `advance` is called, whatever the clock says.

    Raises:
        ConfigError, UsageError: a setting is not valid.
        ResourceError: nothing can render here.
    """

    def __init__(self, settings: StationSettings, *, by_clock: bool = True) -> None:
        self._station = Station(settings, end="actor")
        self.form: StationForm = self._station.form
        self.lost_s = 0.0
        self._lock, self._over = threading.Lock(), threading.Event()
        self._failure: Exception | None = None
        self._stands, self._goes_on = True, False
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
        """Put everything to the start of a trial, see `Station.begin`; time stands still meanwhile."""
        with self._standing():
            begun = self._station.begin(seed, trial)
            self._draw_once()
        return begun

    def begin_demonstrated(self, seed: int = 0, trial: int = 0) -> NDArray[np.float32]:
        """Put everything to the start of a recorded episode, see `Station.begin_demonstrated`; time stands still."""
        with self._standing():
            rows = self._station.begin_demonstrated(seed, trial)
            self._draw_once()
        return rows

    def command(self, row: NDArray[np.floating]) -> None:
        """Tell the arms what to do from now on, see `Station.command`."""
        with self._lock:
            self._station.command(row)

    def advance(self) -> None:
        """Let a frame's time pass, where it does not pass by itself."""
        if self._thread is None:
            self._station.advance()

    def observe(self) -> tuple[Row, dict[str, Image]]:
        """Joints and grippers (numbers of a state,), and camera -> picture (height, width, 3), of one moment.

        Raises:
            Exception: what stopped the simulation.
        """
        with self._lock:
            if self._failure is not None:
                raise self._failure
            state, positions = self._station.state(), self._station.positions()
        return state, self._station.pictures(positions=positions)

    def judge(self) -> str:
        """Why the trial is no success as it stands; empty if it is one. Time stands still meanwhile."""
        with self._standing():
            return self._station.judge()

    def close(self) -> None:
        """Stop, and free what renders."""
        self._over.set()
        if self._thread is not None:
            self._thread.join()
        self._station.close()

    def _draw_once(self) -> None:
        """What draws is made by the first picture, which takes a second."""
        self._station.pictures()

    @contextmanager
    def _standing(self) -> Iterator[None]:
        """While this lasts no time passes, and nor does it after a failure."""
        with self._lock:
            self._stands = True
            yield
            self._stands, self._goes_on = False, True

    def _run(self) -> None:
        due = time.monotonic()
        while not self._over.wait(max(0.0, due - time.monotonic())):
            with self._lock:
                now = time.monotonic()
                if self._stands or self._goes_on:
                    due, self._goes_on = now, False
                elif now - due > _LONGEST_CATCH_UP:
                    self.lost_s += now - due
                    due = now
                if not self._stands:
                    self._tick()
            due += self._station.tick_s

    def _tick(self) -> None:
        try:
            self._station.tick()
        # Whatever it is, whoever observes is told.
        except Exception as error:  # noqa: BLE001
            self._failure, self._stands = error, True
