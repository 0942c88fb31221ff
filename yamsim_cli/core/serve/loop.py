"""Simulated time kept to the clock, and frames answered as they come."""

from __future__ import annotations

import heapq
import itertools
import select
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from ..motors.frames import Frame
from .plant import Plant
from .sockets import KernelBus, UnixBus

# Behind by more, the simulation goes on from where it is instead of racing, s.
_LONGEST_CATCH_UP = 0.1
# A program that was late may have so many of its answers sooner, to be back at its rate.
_EARLY_ANSWERS = 7
# Answers that wait on a bus at a time; what is asked beyond gets lost, as where an adapter's buffer is full.
_MOST_WAITING = 64


class Port(Protocol):
    """What is served beside the buses. None of it may ever wait for anybody."""

    @property
    def readers(self) -> Sequence[Any]:
        """What to wait for until there may be something to read."""

    @property
    def writers(self) -> Sequence[Any]:
        """What to wait for until something that waits can be sent."""

    def handle(self, ready: set[Any]) -> None:
        """Take what has come, of the readers where there is something."""

    def flush(self) -> None:
        """Do what does not depend on what came, such as to send what waits; called at least once a step."""


@dataclass(frozen=True)
class Pace:
    """How well the simulation kept to the clock.

    Attributes:
        seconds: that it ran, by the clock.
        steps: of physics.
        late_ms: the largest lateness of a step, ms.
        late_steps: how many began more than a step after they were due.
        lost_ms: time that the clock ran on without the simulation, when it was too far behind to catch up.
        frames: that the motors heard.
        dropped: that got lost, by a fault or because a bus was full.
    """

    seconds: float
    steps: int
    late_ms: float
    late_steps: int
    lost_ms: float
    frames: int
    dropped: int


class ServeLoop:
    """Lets a plant run in real time, with each of its buses on a socket.

    Args:
        sockets: of the plant's buses, in their order.
        gap: time between two answers on a bus, s, as long as a program is not late.
        ports: that are served beside them.
        tick: called before every physics step.
    """

    def __init__(
        self,
        plant: Plant,
        sockets: Sequence[UnixBus | KernelBus],
        gap: float = 0.0,
        ports: Sequence[Port] = (),
        tick: Callable[[], None] = lambda: None,
    ) -> None:
        self._plant, self._sockets, self._gap, self._tick = plant, tuple(sockets), gap, tick
        self._ports = tuple(ports)
        # When the next answer may come, of each bus.
        self._free = [0.0] * len(self._sockets)
        self._waiting = [0] * len(self._sockets)
        self._lost_frames = 0
        # When an answer is due, the order in which they were given, the bus, and the answer.
        self._answers: list[tuple[float, int, int, Frame]] = []
        self._count = itertools.count()
        self._late = self._lost = 0.0
        self._late_steps = 0
        self._began = time.monotonic()

    @property
    def pace(self) -> Pace:
        """How well it went so far."""
        buses = self._plant.buses
        return Pace(
            seconds=time.monotonic() - self._began,
            steps=self._plant.steps,
            late_ms=1000 * self._late,
            late_steps=self._late_steps,
            lost_ms=1000 * self._lost,
            frames=sum(bus.heard for bus in buses),
            dropped=sum(bus.dropped for bus in buses) + self._lost_frames,
        )

    def run(self, stop: Callable[[], bool], seconds: float = float("inf")) -> None:
        """Go on until it is told to stop, or for so long.

        Raises:
            SimulationError: physics broke down.
        """
        plant, step = self._plant, self._plant.timestep
        due = self._began = time.monotonic()
        end = due + seconds
        while not stop() and due < end:
            now = time.monotonic()
            if now >= due:
                late = now - due
                self._late = max(self._late, late)
                self._late_steps += late > step
                if late > _LONGEST_CATCH_UP:
                    self._lost += late
                    due = now
                self._tick()
                plant.step()
                due += step
            self._exchange(due)

    def _exchange(self, until: float) -> None:
        """Answer what comes, at least once, until a time of the clock's."""
        while True:
            now = time.monotonic()
            while self._answers and self._answers[0][0] <= now:
                _, _, k, frame = heapq.heappop(self._answers)
                self._waiting[k] -= 1
                self._sockets[k].send(frame)
            for one in (*self._sockets, *self._ports):
                one.flush()
            wake = min(until, self._answers[0][0]) if self._answers else until
            # Asked for anew: a program may have been hung up on meanwhile.
            writers = [writer for port in self._ports for writer in port.writers]
            ready = set(select.select(self._readers(), writers, [], max(0.0, wake - time.monotonic()))[0])
            if ready:
                self._receive(ready)
            if time.monotonic() >= until:
                return

    def _readers(self) -> list[Any]:
        return [reader for one in (*self._sockets, *self._ports) for reader in one.readers]

    def _receive(self, ready: set[Any]) -> None:
        for k, one in enumerate(self._sockets):
            for frame in one.receive(ready):
                if self._waiting[k] >= _MOST_WAITING:
                    self._lost_frames += 1
                    continue
                for answer in self._plant.buses[k].send(frame, self._plant.now):
                    self._waiting[k] += 1
                    now = time.monotonic()
                    due = max(now, self._free[k])
                    self._free[k] = max(self._free[k], now - _EARLY_ANSWERS * self._gap) + self._gap
                    heapq.heappush(self._answers, (due, next(self._count), k, answer))
        for port in self._ports:
            port.handle(ready)
