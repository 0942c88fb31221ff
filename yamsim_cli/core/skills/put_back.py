"""Put down what a hand cannot bring where it is to go, as it holds it."""

from __future__ import annotations

from collections.abc import Iterator

from ..goals.cast import Cast
from ..goals.world import TABLE
from .base import hand_with
from .bench import Bench, Segment
from .errors import SkillFailedError
from .hand import Hand
from .moves import let_go
from .put_aside import PutAside


def put_back(bench: Bench, cast: Cast, role: str) -> Iterator[Segment]:
    """Put a thing down where there is room, else straight below, and note that to hold it so is of no use.

    Raises:
        SkillFailedError: no hand holds it any more, or there is no way down.
    """
    hand = hand_with(bench, cast.one(role), "taken another way")
    hand.in_vain.append(bench.look_at(hand))
    try:
        yield from PutAside(thing=role).run(bench, cast, ())
    except SkillFailedError:
        if hand.held is None:
            raise
        yield from _straight_down(bench, hand, hand.held.thing)


def _straight_down(bench: Bench, hand: Hand, thing: str) -> Iterator[Segment]:
    T, T_pinch = bench.world.pose(thing), hand.pinch_at(hand.joints)
    table = float(bench.world.bounds(TABLE)[0][2])
    T_pinch[2, 3] -= T[2, 3] - bench.obstacles.rest_height(bench.qpos, thing, T, table)
    yield bench.segment({hand: bench.line(hand, T_pinch)})
    yield from let_go(bench, hand, bench.clearance(thing))
