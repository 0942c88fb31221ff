"""Which events end an episode, and which of them fail it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from ..attempt_data import FailureCause

WELD_REACH = 0.06  # m, largest distance from a hand's pinch point to an object's surface at which a weld holds it


class EndRule(StrEnum):
    """Who ends an episode that neither fails nor runs out of time.

    With `SUCCESS`, the episode ends at the first control tick at which the goal has held for its hold time. With
    `ACTOR`, the actor ends the episode, and the goal has to hold at that moment.
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
        end: who ends the episode.
        strict: whether an arm that touches the table or another arm, or exceeds a joint limit, fails the episode.
            Demonstrations are strict. The arms of a person or a policy may touch the table.
        max_ticks: control ticks after which the episode ends; None for no time limit.
        weld_reach: largest distance at which a weld holds an object, m; None for any, which replays need.
    """

    end: EndRule = EndRule.ACTOR
    strict: bool = False
    max_ticks: int | None = None
    weld_reach: float | None = WELD_REACH


#: The rules of demonstrations by a task's expert and of their replays.
EXPERT_RULES = EpisodeRules(EndRule.ACTOR, strict=True, weld_reach=None)

#: The rules of replays of a person's recorded actions.
REPLAY_RULES = EpisodeRules(EndRule.ACTOR, weld_reach=None)


@dataclass(frozen=True)
class EpisodeEnd:
    """How an episode ended.

    Attributes:
        reason: the event that ended the episode.
        tick: number of control ticks that had passed.
        cause: why the episode counts as failed; None if it does not.
        detail: the figures behind the cause, as text.
    """

    reason: EndReason
    tick: int
    cause: FailureCause | None = None
    detail: str = ""
