"""Select each control tick's action from action chunks that can overlap, arrive late, or run out."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from ..core.attempt_data import WeldStates
from ..core.errors import UsageError
from ..core.geometry.se3 import Array
from .policy_protocol import ActionChunk

_ROUNDING_TICKS = 1e-6  # ticks; smaller fractions are rounding errors
_MAX_LATENCY = 60.0  # s, largest simulated latency


@dataclass(frozen=True)
class ChunkSettings:
    """Which actions of a policy's action chunks are executed, and when.

    Attributes:
        execute: executed actions of a chunk before the next inference; None for all.
        ensemble: weight each overlapping chunk exp(-ensemble) times as much as the previous one; None uses the newest
            chunk alone.
        latency: simulated time from a request until its chunk acts, s; None for the measured time of the answer.
        lead: for real-time chunking: number of remaining actions at which the next inference is requested, whose chunk
            begins when this one is over; None if a chunk's times count from its request.
    """

    execute: int | None = None
    ensemble: float | None = None
    latency: float | None = 0.0
    lead: int | None = None


def read_latency(text: str) -> float | None:
    """Parse a latency such as `80ms` or `0.08s` to s. Return None for the text `measured`."""
    if text == "measured":
        return None
    found = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+) ?(ms|s)", text)
    seconds = float(found[1]) * (1e-3 if found[2] == "ms" else 1) if found else math.inf
    if seconds > _MAX_LATENCY:
        raise UsageError(f"--latency {text!r} is not valid: give a time such as 80ms or 0.08s, up to 60s, or measured")
    return seconds


@dataclass(frozen=True)
class ChunkStats:
    """Counts of a trial's action chunks.

    Attributes:
        stale: skipped actions, whose time had passed when their chunk arrived.
        waited: control ticks without an action, during which the last command was held.
    """

    chunks: int = 0
    actions: int = 0
    stale: int = 0
    waited: int = 0


@dataclass(frozen=True)
class _TimedChunk:
    chunk: ActionChunk
    begin: float  # control tick from which the times of the actions count
    arrival_tick: int  # control tick from which the chunk acts
    ticks_per_action: float  # duration of an action, ticks

    def action_index(self, now: int) -> int:
        """Return the index of the action at tick `now`; `action_count` or more after the last."""
        return math.floor((now - self.begin) / self.ticks_per_action + _ROUNDING_TICKS)

    @property
    def action_count(self) -> int:
        return len(self.chunk.ctrl)

    @property
    def end_tick(self) -> int:
        """Control tick at which the last action is over."""
        return _round_up_to_ticks(self.begin + self.action_count * self.ticks_per_action)


class ChunkScheduler:
    """Decides when to request the next inference, and which action to execute at each tick.

    A chunk's times count from the request. Actions of a late chunk whose time has passed are skipped. After the last
    action of all chunks, that action is held. With `ChunkSettings.lead`, a chunk's times count from the end of the
    previous chunk, or from its arrival if that is later.

    Args:
        tick: length of a control tick, s.
        hold: duration of an action in control ticks, if its chunk has no period.
        rest: commands to each arm's drives (arms, drives) until the first chunk arrives.
    """

    def __init__(self, chunking: ChunkSettings, tick: float, hold: int, rest: Array) -> None:
        self._chunking, self._tick, self._hold, self._rest = chunking, tick, hold, rest
        self._chunks: list[_TimedChunk] = []
        self._next = 0
        self.chunk_stats = ChunkStats()

    def is_due(self, now: int) -> bool:
        """Whether to request the next chunk at tick `now`."""
        return now >= self._next and not self.has_ended

    def last_chunk_is_over(self, now: int) -> bool:
        """Whether the policy is finished (`done`), and its last action is over."""
        return self.has_ended and now >= max(self._chunks[-1].end_tick, self._chunks[-1].arrival_tick)

    @property
    def has_ended(self) -> bool:
        """Whether the policy declared itself finished (`done`) with its newest chunk."""
        return bool(self._chunks) and self._chunks[-1].chunk.done

    def add_chunk(self, chunk: ActionChunk, now: int, seconds: float) -> None:
        """Add the chunk that was requested at tick `now`, and took `seconds` s of real time."""
        chunking = self._chunking
        ticks_per_action = float(self._hold) if chunk.period is None else chunk.period / self._tick
        late = _round_up_to_ticks((seconds if chunking.latency is None else chunking.latency) / self._tick)
        if chunking.lead is None:
            timed = _TimedChunk(chunk, now, now + late, ticks_per_action)
            execute = min(chunking.execute or timed.action_count, timed.action_count)
            following = now + _round_up_to_ticks(execute * ticks_per_action)
        else:
            before = self._chunks[-1] if self._chunks else None
            begin = float(now + late)
            if before is not None:
                begin = max(begin, before.begin + before.action_count * before.ticks_per_action)
            timed = _TimedChunk(chunk, begin, _round_up_to_ticks(begin), ticks_per_action)
            # With the observation at the start of the action after which `lead` are left.
            following = _round_up_to_ticks(begin + max(0, timed.action_count - chunking.lead - 1) * ticks_per_action)
        # At least a tick passes between two requests, and a request waits for the previous answer.
        self._next = max(timed.arrival_tick, now + 1, following)
        self._chunks.append(timed)
        count = self.chunk_stats
        stale = min(timed.action_count, timed.action_index(timed.arrival_tick))
        self.chunk_stats = ChunkStats(
            count.chunks + 1, count.actions + timed.action_count, count.stale + stale, count.waited
        )

    def command_at(self, now: int) -> tuple[Array, WeldStates]:
        """Return commands to drives (arms, drives) and welds (arms,). Call once per tick, in order."""
        self._drop_chunks(now)
        here = [timed for timed in self._chunks if timed.arrival_tick <= now]
        acting = [timed for timed in here if timed.action_index(now) < timed.action_count]
        if not acting:
            count = self.chunk_stats
            self.chunk_stats = ChunkStats(count.chunks, count.actions, count.stale, count.waited + 1)
            if not here:
                return self._rest, np.zeros(len(self._rest), dtype=bool)
        if self._chunking.ensemble is None or len(acting) < 2:
            newest = (acting or here)[-1]
            k = min(newest.action_index(now), newest.action_count - 1)
            return newest.chunk.ctrl[k], newest.chunk.magnet[k]
        weights = np.exp(-self._chunking.ensemble * np.arange(len(acting)))
        weights /= weights.sum()
        rows = [
            (timed.chunk.ctrl[timed.action_index(now)], timed.chunk.magnet[timed.action_index(now)]) for timed in acting
        ]
        ctrl = np.einsum("c,cad->ad", weights, np.array([ctrl for ctrl, _ in rows]))
        return ctrl, weights @ np.array([magnet for _, magnet in rows], dtype=float) >= 0.5

    def _drop_chunks(self, now: int) -> None:
        """Drop chunks that no longer act. Keep the newest that has arrived, whose last action may be held.

        Without averaging, a newer chunk that lasts as long replaces a chunk when it arrives.
        """
        kept: list[_TimedChunk] = []
        covered = -1
        for timed in reversed(self._chunks):
            here = timed.arrival_tick <= now
            if not here or covered < 0 or timed.end_tick > max(now, covered):
                kept.append(timed)
            if here:
                covered = max(covered, timed.end_tick if self._chunking.ensemble is None else now)
        self._chunks = kept[::-1]


def _round_up_to_ticks(amount: float) -> int:
    return math.ceil(amount - _ROUNDING_TICKS)
