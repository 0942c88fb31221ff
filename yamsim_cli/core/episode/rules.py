"""What ends an episode, and which events fail it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from ..types import Cause

MAGNET_REACH = 0.06  # m, from a hand's pinch point to a thing's surface; a magnet takes nothing that is farther away


class EndRule(StrEnum):
    """Who ends an episode that neither fails nor runs out of time.

    With `SUCCESS`, the episode ends at the first control tick at which the goal has held for its hold time. With
    `ACTOR`, whoever acts ends it, and the goal has to hold at that moment.
    """

    SUCCESS = "success"
    ACTOR = "actor"


class EndReason(StrEnum):
    """What ended an episode."""

    SUCCESS = "success"
    FORBIDDEN = "forbidden"
    UNSTABLE = "unstable"
    TIME_LIMIT = "time_limit"
    ACTOR = "actor"


@dataclass(frozen=True)
class EpisodeRules:
    """The rules of an episode.

    Attributes:
        end: who ends it.
        strict: whether a forbidden contact or an exceeded joint limit ends it as a failure. Demonstrations are strict.
            The arms of a person or a policy may touch the table.
        max_ticks: control ticks after which it ends; None for no time limit.
        magnet_reach: largest distance at which a magnet takes a thing, m; None for any, as recorded actions need it.
    """

    end: EndRule = EndRule.ACTOR
    strict: bool = False
    max_ticks: int | None = None
    magnet_reach: float | None = MAGNET_REACH


#: The rules of demonstrations by a task's expert, and of recorded demonstrations that are repeated.
EXPERT_RULES = EpisodeRules(EndRule.ACTOR, strict=True, magnet_reach=None)

#: The rules of recorded actions of a person, repeated.
REPEATED_RULES = EpisodeRules(EndRule.ACTOR, magnet_reach=None)


@dataclass(frozen=True)
class End:
    """How an episode ended.

    Attributes:
        reason: what ended it.
        tick: number of control ticks that had passed.
        cause: why it is no success, as far as the ending itself says so.
        detail: the figures behind the cause, for a person.
    """

    reason: EndReason
    tick: int
    cause: Cause | None = None
    detail: str = ""
