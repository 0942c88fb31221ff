"""Pick up a thing."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...config.goals.cast import Cast
from ...config.goals.world import TABLE
from ...files.documents.units import Distance
from ...geometry.se3 import Array, inverse, pose
from ...types import Cause
from ..planning.obstacles import Load
from .base import Side, Skill, holder_of, preferences
from .bench import Bench, Fingers, Segment, SkillFailedError
from .grips import Grip, can_point
from .hand import PASSING, RESERVE, Hand, Held
from .moves import let_go, park_free, take_hold

# m, lengths of the straight approach; the shorter one is for tight places
_APPROACHES = (0.09, 0.05)

# Arguments of `Bench.reserve` in the order tried.
_REACHES = ((RESERVE, False), (0.0, False), (0.0, True))


@dataclass(frozen=True)
class Reach:
    """A grip that a hand can take now.

    Attributes:
        grip: the grip.
        before: joints (dof,) before the straight approach, rad.
        at: joints (dof,) at the grip, rad.
        opening: of each finger during the approach, m.
    """

    grip: Grip
    before: Array
    at: Array
    opening: float


class Pick(Skill):
    """Grasp a thing and lift it, with an arm and a grip that leave the skills ahead possible.

    Attributes:
        thing: a role.
        arm: which arm.
        lift: how high, m.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    NEEDS_HELD: ClassVar[bool | None] = False
    LEAVES_HELD: ClassVar[bool | None] = True
    # Whether each motion waits until the arm has reached the end of the previous motion.
    WAITS: ClassVar[bool] = True
    thing: str
    arm: Side = "any"
    lift: Distance = 0.06

    def run(self, bench: Bench, cast: Cast, ahead: Sequence[Skill]) -> Iterator[Segment]:
        """See `Skill`."""
        thing = cast.one(self.thing)
        if holder_of(bench, thing) is not None:
            return
        places = ahead[0].places(bench, cast, thing) if ahead else ()
        reasons: dict[str, int] = {}
        for following, (reserve, leans) in itertools.product(preferences(ahead, bench, cast), _REACHES):
            reasons.clear()
            for hand in self._hands(bench, thing, places):
                with bench.reserve(reserve, leans):
                    found = self._reached(bench, cast, hand, thing, following, reasons)
                if found is not None:
                    yield from park_free(bench, hand)
                    yield from self._take(bench, hand, thing, found)
                    return
        if not reasons:
            low, high = bench.world.block(thing)
            stroke = f"{2000 * max(hand.max_opening for hand in bench.acting):.0f} mm"
            size = " x ".join(f"{1000 * length:.0f}" for length in high - low)
            reasons[
                f"it is {size} mm and has no two opposite faces less than {stroke} apart, as wide as a hand opens"
            ] = 1
        summary = "; ".join(
            f"{why} ({number})" for why, number in sorted(reasons.items(), key=lambda item: -item[1])[:3]
        )
        raise SkillFailedError(Cause.UNREACHABLE, f"no way to take the {thing}: {summary}")

    def _hands(self, bench: Bench, thing: str, goals: Sequence[Array]) -> list[Hand]:
        """Return the hands that may pick, those nearest to the thing and to its goals first."""
        places = [bench.world.pose(thing)[:2, 3], *goals]
        hands = bench.free_hands(self.arm)

        def distance(hand: Hand) -> float:
            base = hand.arm.T_base_in_world[:2, 3]
            return max(float(np.linalg.norm(place - base)) for place in places)

        return sorted(hands, key=distance)

    def _take(self, bench: Bench, hand: Hand, thing: str, found: Reach) -> Iterator[Segment]:
        grip = found.grip
        path = bench.free_path(hand, found.before, found.opening)
        yield bench.segment({hand: path}, {hand: Fingers(found.opening)}, arrives=self.WAITS)
        path = bench.line(hand, bench.world.pose(thing) @ grip.T_pinch_in_thing)
        yield bench.segment({hand: path}, arrives=self.WAITS)
        yield from take_hold(bench, hand, grip)
        if hand.side not in bench.world.holders(thing):
            yield from let_go(bench, hand, grip.clearance)
            raise SkillFailedError(Cause.SLIPPED, f"the {thing} is not between the {hand.side} hand's fingers")
        hand.held = Held(thing, inverse(bench.T_pinch(hand)) @ bench.world.pose(thing))
        T_up = hand.pinch_at(hand.joints)
        T_up[2, 3] += self.lift
        yield bench.segment({hand: bench.line(hand, T_up)}, arrives=self.WAITS)
        try:
            bench.update_held(hand)
        except SkillFailedError:
            yield from let_go(bench, hand, grip.clearance)
            raise

    def _reached(
        self, bench: Bench, cast: Cast, hand: Hand, thing: str, ahead: Sequence[Skill], reasons: dict[str, int]
    ) -> Reach | None:
        """Return the first grip that a hand can take now and that leaves the skills ahead possible; else None."""
        for grip in bench.grips(thing, hand.max_opening):
            found = self.reach(bench, hand, thing, grip)
            if isinstance(found, Reach):
                T = inverse(grip.T_pinch_in_thing)
                fault = ahead[0].fault(bench, cast, hand, thing, T, found.at, ahead[1:]) if ahead else None
                if fault is None:
                    return found
                found = fault
            if found is not None:
                reasons[found] = reasons.get(found, 0) + 1
        return None

    def reach(self, bench: Bench, hand: Hand, thing: str, grip: Grip) -> Reach | str | None:
        """Return how a hand can take a thing by a grip now; else why not, for a person.

        Returns:
            None if the grip is no candidate: a similar grasp failed before, or no hand can point there.
        """
        if grip.opening > hand.max_opening:
            return (
                f"it is {2000 * grip.opening:.1f} mm wide where it can be held, and the {hand.side} hand opens "
                f"{2000 * hand.max_opening:.1f} mm"
            )
        T_at = bench.world.pose(thing) @ grip.T_pinch_in_thing
        if hand.failed_with(thing, grip.T_pinch_in_thing) or not can_point(T_at, hand.arm.T_base_in_world):
            return None
        at = hand.reach(T_at, (hand.joints, hand.ready))
        if at is None:
            return f"the {hand.side} arm does not reach it so"
        opening = min(grip.opening + grip.clearance, hand.max_opening)
        before, why = _before(bench, hand, thing, T_at, at, opening, grip.finger_distance)
        if before is None:
            return why
        return self._blocked(bench, hand, thing, grip, T_at, at) or Reach(grip, before, at, opening)

    def _blocked(self, bench: Bench, hand: Hand, thing: str, grip: Grip, T_at: Array, at: Array) -> str | None:
        """Return what prevents a hand from lifting a thing grasped at joints `at` (dof,); None if nothing."""
        T_up = T_at.copy()
        T_up[2, 3] += self.lift
        up = hand.reach(T_up, (at,))
        if up is None:
            return f"the {hand.side} arm cannot lift it so"
        load = Load(thing, inverse(grip.T_pinch_in_thing), (TABLE, *bench.world.things))
        return bench.touched(hand, up, grip.opening, load)


def _before(
    bench: Bench, hand: Hand, thing: str, T_at: Array, at: Array, opening: float, finger_distance: float | None
) -> tuple[Array | None, str]:
    """Return joints (dof,) before the straight approach to a thing; else None, and why there are none."""
    why = bench.touched(hand, at, opening, between=thing, beside=finger_distance)
    if why is not None:
        return None, why
    why = f"the {hand.side} arm does not reach the place before it"
    for distance in _APPROACHES:
        before = hand.reach(T_at @ pose((0.0, 0.0, -distance)), (at,), PASSING)
        if before is not None:
            blocked = bench.touched(hand, before, opening)
            if blocked is None:
                return before, ""
            why = blocked
    return None, why
