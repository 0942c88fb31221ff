"""What acts at each control tick, of chunks of actions that may overlap, come late, or run out."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from ..errors import UsageError
from ..geometry.se3 import Array
from ..types import Holds
from .base import Chunk

# So much of a tick is rounding, and no part of the next one.
_ROUNDING = 1e-6
# The longest latency that is modelled, s.
_LONGEST = 60.0


@dataclass(frozen=True)
class Chunking:
    """How chunks of actions are used.

    Attributes:
        execute: after how many actions of a chunk the next one is asked for; None for all of them.
        ensemble: chunks that overlap are averaged, each weighing exp(-ensemble) as much as the one that was asked for
            before it; None where the newest acts alone.
        latency: simulated seconds from a question to when its answer acts, in which the arm goes on with what it has;
            None for as long as the answer really took.
    """

    execute: int | None = None
    ensemble: float | None = None
    latency: float | None = 0.0


def read_latency(text: str) -> float | None:
    """Seconds of a time such as `80ms` or `0.08s`; None for `measured`.

    Raises:
        UsageError: it is none, or beyond a minute.
    """
    if text == "measured":
        return None
    found = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+) ?(ms|s)", text)
    seconds = float(found[1]) * (1e-3 if found[2] == "ms" else 1) if found else math.inf
    if seconds > _LONGEST:
        raise UsageError(f"--latency {text!r} is not valid: give a time such as 80ms or 0.08s, up to 60s, or measured")
    return seconds


@dataclass(frozen=True)
class ChunkCount:
    """What became of a trial's actions.

    Attributes:
        chunks, actions: how many were received.
        stale: actions whose time had passed when they arrived.
        waited: control ticks on which no action was for then: the last one that there was stayed.
    """

    chunks: int = 0
    actions: int = 0
    stale: int = 0
    waited: int = 0


@dataclass(frozen=True)
class _Timed:
    chunk: Chunk
    asked: int  # tick
    arrives: int  # tick
    per_action: float  # ticks

    def index(self, now: int) -> int:
        """Number of the action that is for a tick; as many as there are, or more, once they have run out."""
        return math.floor((now - self.asked) / self.per_action + _ROUNDING)

    @property
    def actions(self) -> int:
        return len(self.chunk.ctrl)

    @property
    def ends(self) -> int:
        """The first tick for which there is no action."""
        return self.asked + _ticks(self.actions * self.per_action)


class ChunkPlayer:
    """Says when a policy is to be asked, and what acts meanwhile.

    An action is for a time, counted from when its chunk was asked for. One that comes late is not made up for: the arm
    takes up the chunk where it would be by then. Of a chunk that comes later than all of its actions, the last acts.

    Args:
        tick: length of a control tick, s.
        hold: control ticks an action lasts, where its chunk does not say how long.
        rest: what each arm's drives are told before anything has come (arms, drives).
    """

    def __init__(self, chunking: Chunking, tick: float, hold: int, rest: Array) -> None:
        self._chunking, self._tick, self._hold, self._rest = chunking, tick, hold, rest
        self._chunks: list[_Timed] = []
        self._next = 0
        self.count = ChunkCount()

    def is_due(self, now: int) -> bool:
        """Whether the policy is to be asked at a tick."""
        return now >= self._next and not self._last_words

    def is_over(self, now: int) -> bool:
        """Whether a chunk after which nothing comes has been played by a tick."""
        return self._last_words and now >= max(self._chunks[-1].ends, self._chunks[-1].arrives)

    @property
    def has_ended(self) -> bool:
        """Whether the policy said that nothing comes after its last chunk."""
        return self._last_words

    def take(self, chunk: Chunk, now: int, seconds: float) -> None:
        """Take the answer to a question asked at a tick; `seconds` is how long it really took."""
        chunking = self._chunking
        per_action = float(self._hold) if chunk.period is None else chunk.period / self._tick
        late = _ticks((seconds if chunking.latency is None else chunking.latency) / self._tick)
        timed = _Timed(chunk, now, now + late, per_action)
        execute = min(chunking.execute or timed.actions, timed.actions)
        # At least a tick passes between two questions, and one is asked only when the last is answered.
        self._next = max(timed.arrives, now + max(1, _ticks(execute * per_action)))
        self._chunks.append(timed)
        count = self.count
        stale = min(timed.actions, timed.index(timed.arrives))
        self.count = ChunkCount(count.chunks + 1, count.actions + timed.actions, count.stale + stale, count.waited)

    def act(self, now: int) -> tuple[Array, Holds]:
        """What the drives (arms, drives) and welds (arms,) are told at a tick; ask for each tick once, in order."""
        self._forget(now)
        here = [timed for timed in self._chunks if timed.arrives <= now]
        acting = [timed for timed in here if timed.index(now) < timed.actions]
        if not acting:
            count = self.count
            self.count = ChunkCount(count.chunks, count.actions, count.stale, count.waited + 1)
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

    @property
    def _last_words(self) -> bool:
        return bool(self._chunks) and self._chunks[-1].chunk.done

    def _forget(self, now: int) -> None:
        """Drop chunks that will not act any more; the newest one that is here stays, for its last action.

        Without averaging, a chunk acts no more once a newer one is here that lasts as long.
        """
        kept: list[_Timed] = []
        covered = -1
        for timed in reversed(self._chunks):
            here = timed.arrives <= now
            if not here or covered < 0 or timed.ends > max(now, covered):
                kept.append(timed)
            if here:
                covered = max(covered, timed.ends if self._chunking.ensemble is None else now)
        self._chunks = kept[::-1]


def _ticks(amount: float) -> int:
    """Whole ticks that cover so many."""
    return math.ceil(amount - _ROUNDING)
