from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from ..attempt_data import FailureCause

MAX_WELD_DISTANCE = 0.06  # m, from a hand's pinch point to an object's surface: farther objects are not welded


class EndRule(StrEnum):
    """Who ends an episode that neither fails nor runs out of time.

    `SUCCESS`: the first control tick at which the goal has held for its hold time. `ACTOR`: the actor, and the goal has
    to hold at that moment.
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
    """Which events end an episode, and which of them fail it.

    Attributes:
        strict: whether an arm that touches the table or another arm, or exceeds a joint limit, fails the episode.
            Demonstrations are strict. The arms of a person or a policy may touch the table.
        max_ticks: time limit in control ticks.
        weld_reach: largest distance at which a weld holds an object, m; None for any, which replays need.
    """

    end: EndRule = EndRule.ACTOR
    strict: bool = False
    max_ticks: int | None = None
    weld_reach: float | None = MAX_WELD_DISTANCE


# Demonstrations and their replays.
EXPERT_RULES = EpisodeRules(EndRule.ACTOR, strict=True, weld_reach=None)

# Replays of a person's recorded actions.
REPLAY_RULES = EpisodeRules(EndRule.ACTOR, weld_reach=None)


@dataclass(frozen=True)
class EpisodeEnd:
    """How an episode ended, after how many control ticks, and why it failed, if it did."""

    reason: EndReason
    tick: int
    cause: FailureCause | None = None
    detail: str = ""
