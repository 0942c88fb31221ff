"""Lift a thing with both hands at once."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np

from ...config.goals.cast import Cast
from ...files.documents.units import Distance
from ...geometry.se3 import Array, inverse, pose
from ...types import Cause
from .base import Skill
from .bench import Bench, Fingers, Segment, SkillFailedError
from .grips import Grip, can_point
from .hand import PASSING, Hand, Held
from .moves import GRIP_TICKS, let_go, rest

_APPROACH = 0.08  # m, length of the straight approach of each hand
_MIN_APART = 0.12  # m, least distance between the two grasps
_MAX_GRIPS = 24  # count, reachable grips of each hand that are compared

_SPEED = 0.10  # m/s, of both hands while they lift


class Lift(Skill):
    """Grasp a thing at two places, one with each hand, and lift it level.

    Attributes:
        thing: a role.
        by: height of the lift, m.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    NEEDS_HELD: ClassVar[bool | None] = False
    LEAVES_HELD: ClassVar[bool | None] = True
    thing: str
    by: Distance = 0.10

    def run(self, bench: Bench, cast: Cast, ahead: Sequence[Skill]) -> Iterator[Segment]:
        """See `Skill`."""
        thing = cast.one(self.thing)
        hand_a, hand_b = bench.hands[:2]
        found = self._pair(bench, hand_a, hand_b, thing)
        openings = {hand: min(grip.opening + grip.clearance, hand.max_opening) for hand, grip, *_ in found}
        for hand, _, before, _ in found:
            yield bench.segment({hand: bench.free_path(hand, before, openings[hand])}, {hand: Fingers(openings[hand])})
        T_thing = bench.world.pose(thing)
        lines = {hand: bench.line(hand, T_thing @ grip.T_pinch_in_thing) for hand, grip, *_ in found}
        yield bench.segment(lines)
        closing = {hand: Fingers(grip.opening, grip.force) for hand, grip, *_ in found}
        yield bench.segment({hand: bench.still(hand, GRIP_TICKS) for hand in closing}, closing)
        yield rest(bench)
        holders = bench.world.holders(thing)
        if not {hand.side for hand in closing} <= holders:
            for hand, grip, *_ in found:
                yield from let_go(bench, hand, grip.clearance)
            raise SkillFailedError(Cause.SLIPPED, f"the {thing} is not in both hands")
        for hand in closing:
            hand.held = Held(thing, inverse(bench.T_pinch(hand)) @ bench.world.pose(thing))
        up = {}
        for hand in closing:
            T_up = hand.pinch_at(hand.joints)
            T_up[2, 3] += self.by
            up[hand] = bench.line(hand, T_up, _SPEED)
        yield bench.segment(up)
        for hand in closing:
            bench.update_held(hand)

    def _pair(self, bench: Bench, hand_a: Hand, hand_b: Hand, thing: str) -> list[tuple[Hand, Grip, Array, Array]]:
        """Return the most distant free pair of grips: each hand with its grip, and joints (dof,) before and at it."""
        reached = {hand: list(self._reached(bench, hand, thing)) for hand in (hand_a, hand_b)}
        pairs = sorted(
            itertools.product(*reached.values()),
            key=lambda pair: (
                -float(np.linalg.norm(pair[0][1].T_pinch_in_thing[:3, 3] - pair[1][1].T_pinch_in_thing[:3, 3]))
            ),
        )
        for first, second in pairs:
            apart = _position(first[1]) - _position(second[1])
            if float(np.linalg.norm(apart)) < _MIN_APART:
                break
            qpos = bench.posed_qpos(first[0], first[3], first[1].opening, None)
            if bench.obstacles.touched(qpos, second[0].number, second[3], second[1].opening, between=thing) is None:
                return [first, second]
        raise SkillFailedError(Cause.UNREACHABLE, f"no two places at which both hands can take the {thing}")

    def _reached(self, bench: Bench, hand: Hand, thing: str) -> Iterator[tuple[Hand, Grip, Array, Array]]:
        T_thing, number = bench.world.pose(thing), 0
        for grip in bench.grips(thing, hand.max_opening):
            T_at = T_thing @ grip.T_pinch_in_thing
            if not can_point(T_at, hand.arm.T_base_in_world):
                continue
            at = hand.reach(T_at, (hand.ready,))
            before = None if at is None else hand.reach(T_at @ pose((0.0, 0.0, -_APPROACH)), (at,), PASSING)
            if at is None or before is None:
                continue
            opening = min(grip.opening + grip.clearance, hand.max_opening)
            if bench.touched(hand, at, opening, between=thing) or bench.touched(hand, before, opening):
                continue
            T_up = T_at.copy()
            T_up[2, 3] += self.by
            if hand.reach(T_up, (at,)) is None:
                continue
            number += 1
            yield hand, grip, before, at
            if number == _MAX_GRIPS:
                return


def _position(grip: Grip) -> Array:
    position: Array = grip.T_pinch_in_thing[:3, 3]
    return position
