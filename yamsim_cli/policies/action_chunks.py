"""The action at each control tick, from chunks of actions that can overlap, arrive late, or run out."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from ..core.attempt_data import WeldStates
from ..core.errors import UsageError
from ..core.geometry.se3 import Array
from .policy_protocol import ActionChunk

_ROUNDING = 1e-6  # ticks: a smaller part of a tick is a rounding error
_MAX_LATENCY = 60.0  # s, that is simulated


@dataclass(frozen=True)
class ChunkSettings:
    """How chunks of actions are used.

    Attributes:
        execute: actions of a chunk that act before the next chunk is requested; None for all.
        ensemble: overlapping chunks are averaged, each with exp(-ensemble) times the weight of the chunk requested
            before it; None for the newest chunk alone.
        latency: simulated time from a request until the answer acts, s; meanwhile earlier chunks act. None for the
            time that the answer really took.
    """

    execute: int | None = None
    ensemble: float | None = None
    latency: float | None = 0.0


def read_latency(text: str) -> float | None:
    """Seconds of a time such as `80ms` or `0.08s`; None for `measured`.

    Raises:
        UsageError: the text is no such time, or the time is more than a minute.
    """
    if text == "measured":
        return None
    found = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+) ?(ms|s)", text)
    seconds = float(found[1]) * (1e-3 if found[2] == "ms" else 1) if found else math.inf
    if seconds > _MAX_LATENCY:
        raise UsageError(f"--latency {text!r} is not valid: give a time such as 80ms or 0.08s, up to 60s, or measured")
    return seconds


@dataclass(frozen=True)
class ChunkStats:
    """Counts of a trial's actions.

    Attributes:
        chunks, actions: how many were received.
        stale: actions whose time had passed when they arrived.
        waited: control ticks for which there was no action, so that the last command stayed.
    """

    chunks: int = 0
    actions: int = 0
    stale: int = 0
    waited: int = 0


@dataclass(frozen=True)
class _TimedChunk:
    chunk: ActionChunk
    requested: int  # tick
    arrival_tick: int  # tick
    per_action: float  # ticks

    def index(self, now: int) -> int:
        """Index of the action for a tick; at least `actions` once they have run out."""
        return math.floor((now - self.requested) / self.per_action + _ROUNDING)

    @property
    def actions(self) -> int:
        return len(self.chunk.ctrl)

    @property
    def ends(self) -> int:
        """The first tick for which there is no action."""
        return self.requested + _ticks(self.actions * self.per_action)


class ChunkScheduler:
    """Decides when a policy's next answer is requested, and which action acts at each tick.

    The times of a chunk's actions count from the request. Of a chunk that arrives late, the actions whose time has
    passed are skipped. If the time of all actions has passed, the last action acts.

    Args:
        tick: length of a control tick, s.
        hold: control ticks that an action lasts, where its chunk has no period.
        rest: commands to each arm's drives before the first chunk arrives (arms, drives).
    """

    def __init__(self, chunking: ChunkSettings, tick: float, hold: int, rest: Array) -> None:
        self._chunking, self._tick, self._hold, self._rest = chunking, tick, hold, rest
        self._chunks: list[_TimedChunk] = []
        self._next = 0
        self.count = ChunkStats()

    def is_due(self, now: int) -> bool:
        """Whether the next answer is to be requested at a tick."""
        return now >= self._next and not self.has_ended

    def last_chunk_is_over(self, now: int) -> bool:
        """Whether the policy's last chunk has acted to its end by a tick."""
        return self.has_ended and now >= max(self._chunks[-1].ends, self._chunks[-1].arrival_tick)

    @property
    def has_ended(self) -> bool:
        """Whether the policy is finished after its last chunk."""
        return bool(self._chunks) and self._chunks[-1].chunk.done

    def add_chunk(self, chunk: ActionChunk, now: int, seconds: float) -> None:
        """Add the answer to a request of a tick; `seconds` is the time that the answer really took."""
        chunking = self._chunking
        per_action = float(self._hold) if chunk.period is None else chunk.period / self._tick
        late = _ticks((seconds if chunking.latency is None else chunking.latency) / self._tick)
        timed = _TimedChunk(chunk, now, now + late, per_action)
        execute = min(chunking.execute or timed.actions, timed.actions)
        # At least a tick passes between two requests, and a request waits for the answer to the one before.
        self._next = max(timed.arrival_tick, now + max(1, _ticks(execute * per_action)))
        self._chunks.append(timed)
        count = self.count
        stale = min(timed.actions, timed.index(timed.arrival_tick))
        self.count = ChunkStats(count.chunks + 1, count.actions + timed.actions, count.stale + stale, count.waited)

    def next_command(self, now: int) -> tuple[Array, WeldStates]:
        """Commands to the drives (arms, drives) and welds (arms,) at a tick; call once for each tick, in order."""
        self._drop_chunks(now)
        here = [timed for timed in self._chunks if timed.arrival_tick <= now]
        acting = [timed for timed in here if timed.index(now) < timed.actions]
        if not acting:
            count = self.count
            self.count = ChunkStats(count.chunks, count.actions, count.stale, count.waited + 1)
            if not here:
                return self._rest, np.zeros(len(self._rest), dtype=bool)
        if self._chunking.ensemble is None or len(acting) < 2:
            newest = (acting or here)[-1]
            k = min(newest.index(now), newest.actions - 1)
            return newest.chunk.ctrl[k], newest.chunk.magnet[k]
        weights = np.exp(-self._chunking.ensemble * np.arange(len(acting)))
        weights /= weights.sum()
        rows = [(timed.chunk.ctrl[timed.index(now)], timed.chunk.magnet[timed.index(now)]) for timed in acting]
        ctrl = np.einsum("c,cad->ad", weights, np.array([ctrl for ctrl, _ in rows]))
        return ctrl, weights @ np.array([magnet for _, magnet in rows], dtype=float) >= 0.5

    def _drop_chunks(self, now: int) -> None:
        """Drop chunks that will not act any more. The newest chunk that has arrived stays, for its last action.

        Without averaging, a chunk acts no more once a newer chunk has arrived that lasts as long.
        """
        kept: list[_TimedChunk] = []
        covered = -1
        for timed in reversed(self._chunks):
            here = timed.arrival_tick <= now
            if not here or covered < 0 or timed.ends > max(now, covered):
                kept.append(timed)
            if here:
                covered = max(covered, timed.ends if self._chunking.ensemble is None else now)
        self._chunks = kept[::-1]


def _ticks(amount: float) -> int:
    """An amount of ticks, rounded up."""
    return math.ceil(amount - _ROUNDING)
