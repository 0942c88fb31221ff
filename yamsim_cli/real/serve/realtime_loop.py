"""Step the simulation in real time, and answer CAN frames on arrival."""

from __future__ import annotations

import heapq
import itertools
import select
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from ..motors.can_frames import CanFrame
from .can_bus import KernelBus, UnixBus
from .motor_simulation import MotorSimulation

_MAX_CATCH_UP = 0.1  # s; a simulation that is further behind real time skips the lost time
_MAX_EARLY_ANSWERS = 7  # without gaps, so that a late program regains its rate
_MAX_QUEUED = 64  # answers of a bus; further frames are lost, as in a full adapter


class PolledServer(Protocol):
    """A server that the loop polls besides the CAN buses. No method may block."""

    @property
    def readers(self) -> Sequence[Any]:
        """Objects to select for reading."""

    @property
    def writers(self) -> Sequence[Any]:
        """Objects to select for writing."""

    def handle(self, ready: set[Any]) -> None:
        """Receive from ready readers."""

    def flush(self) -> None:
        """Do work without new input, such as sending bytes, at least once per step."""


@dataclass(frozen=True)
class RealtimeStats:
    """Timing of the simulation relative to the clock.

    Attributes:
        seconds: run time.
        late_ms: largest lateness of a step.
        late_steps: begun more than a timestep late.
        lost_ms: skipped, because the simulation was too late to catch up.
        frames: received by the buses.
        dropped: by a fault or a full bus.
    """

    seconds: float
    steps: int
    late_ms: float
    late_steps: int
    lost_ms: float
    frames: int
    dropped: int


class RealtimeLoop:
    """Runs a motor simulation in real time, each bus on a socket.

    Attributes:
        sockets: sockets of the buses.
        answers: heap of (time at which the answer is due, number of the answer, index of the bus, answer).

    Args:
        sockets: in the order of `plant.buses`.
        gap: s between answers on a bus, while no program is late.
        ports: further servers, such as for camera images.
        tick: called before every physics step.
    """

    def __init__(
        self,
        plant: MotorSimulation,
        sockets: Sequence[UnixBus | KernelBus],
        gap: float = 0.0,
        ports: Sequence[PolledServer] = (),
        tick: Callable[[], None] = lambda: None,
    ) -> None:
        self._plant, self.sockets, self._gap, self._tick = plant, tuple(sockets), gap, tick
        self._ports = tuple(ports)
        # Time at which each bus may send its next answer.
        self._free = [0.0] * len(self.sockets)
        self._waiting = [0] * len(self.sockets)
        self._lost_frames = 0
        self.answers: list[tuple[float, int, int, CanFrame]] = []
        self._count = itertools.count()
        self._late = self._lost = 0.0
        self._late_steps = 0
        self._began = time.monotonic()

    @property
    def timing_stats(self) -> RealtimeStats:
        """Timing since `run` began."""
        buses = self._plant.buses
        return RealtimeStats(
            seconds=time.monotonic() - self._began,
            steps=self._plant.steps,
            late_ms=1000 * self._late,
            late_steps=self._late_steps,
            lost_ms=1000 * self._lost,
            frames=sum(bus.frames_received for bus in buses),
            dropped=sum(bus.frames_dropped for bus in buses) + self._lost_frames,
        )

    def run(self, stop: Callable[[], bool], seconds: float = float("inf")) -> None:
        """Run until `stop` returns true, or for `seconds`. Raises `SimulationError` if physics broke down."""
        plant, step = self._plant, self._plant.timestep
        due = self._began = time.monotonic()
        end = due + seconds
        while not stop() and due < end:
            now = time.monotonic()
            if now >= due:
                late = now - due
                self._late = max(self._late, late)
                self._late_steps += late > step
                if late > _MAX_CATCH_UP:
                    self._lost += late
                    due = now
                self._tick()
                plant.step()
                due += step
            self._exchange_frames_until(due)

    def _exchange_frames_until(self, until: float) -> None:
        while True:
            now = time.monotonic()
            while self.answers and self.answers[0][0] <= now:
                _, _, k, frame = heapq.heappop(self.answers)
                self._waiting[k] -= 1
                self.sockets[k].send(frame)
            for one in (*self.sockets, *self._ports):
                one.flush()
            wake = min(until, self.answers[0][0]) if self.answers else until
            writers = [writer for port in self._ports for writer in port.writers]
            ready = set(select.select(self._all_readers(), writers, [], max(0.0, wake - time.monotonic()))[0])
            if ready:
                self._receive_ready(ready)
            if time.monotonic() >= until:
                return

    def _all_readers(self) -> list[Any]:
        return [reader for one in (*self.sockets, *self._ports) for reader in one.readers]

    def _receive_ready(self, ready: set[Any]) -> None:
        for k, one in enumerate(self.sockets):
            for frame in one.receive(ready):
                if self._waiting[k] >= _MAX_QUEUED:
                    self._lost_frames += 1
                    continue
                for answer in self._plant.buses[k].send(frame, self._plant.sim_time):
                    self._waiting[k] += 1
                    now = time.monotonic()
                    due = max(now, self._free[k])
                    self._free[k] = max(self._free[k], now - _MAX_EARLY_ANSWERS * self._gap) + self._gap
                    heapq.heappush(self.answers, (due, next(self._count), k, answer))
        for port in self._ports:
            port.handle(ready)
