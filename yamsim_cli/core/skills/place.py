"""Put what a hand holds down: onto something, into something, or at a place."""

from __future__ import annotations

import itertools
import math
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from ..documents.units import Reach, Within
from ..geometry.se3 import Array, inverse, pose, rotation_z, yaw
from ..goals.cast import Cast
from ..goals.world import TABLE
from ..planning.obstacles import Load
from ..types import Cause
from .base import Skill, require_holder
from .bench import Bench, CachedIterable, Segment, SkillFailedError
from .grips import can_point
from .hand import PASSING, Hand
from .moves import bring, let_go, rest

# From so high a thing comes straight down, and is let go so much above where it will lie, m.
HOVER_HEIGHT = 0.07
_RELEASE_GAP = 0.002

# A thing farther than this from where it was to lie has not been placed, m.
_MAX_OFFSET = 0.03

# A hand that puts a thing down on a face beside points no farther up than this, as the sine of the angle.
_MAX_UPWARD = 0.1

# Headings that are tried, as turns from the present one: small ones first.
_TURNS = tuple(math.radians(angle) for angle in (0, 30, -30, 60, -60, 90, -90, 120, -120, 150, -150, 180))


class Placing(Skill):
    """Base of the skills that put down what a hand holds: they differ in where.

    Attributes:
        thing: a role; it is in a hand.
        drop: it falls the last bit, m: where fingers around it would touch what it is put onto.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    NEEDS_HELD: ClassVar[bool | None] = True
    LEAVES_HELD: ClassVar[bool | None] = False
    # How fast a thing comes down, m/s.
    LOWERING: ClassVar[float] = 0.15
    thing: str
    drop: Annotated[FiniteFloat, Within("m", 0, 0.05)] = 0.0

    def support(self, cast: Cast) -> str:
        """What the thing is put onto, or into: a thing or `table`."""
        return TABLE

    @abstractmethod
    def goals(self, bench: Bench, cast: Cast, thing: str) -> Iterable[Array]:
        """Where the thing may come to lie: poses (4, 4) in `world`, the best first."""

    def _goals_once(self, bench: Bench, cast: Cast, thing: str) -> Iterable[Array]:
        """The same, each looked for but once while nothing moves: every grip that is tried asks for them."""
        return bench.cached((self, thing), lambda: CachedIterable(self.goals(bench, cast, thing)))

    def relaxed(self, bench: Bench, cast: Cast) -> Placing:
        """See `Skill`."""
        return self

    def _ordered_goals(self, bench: Bench, cast: Cast, thing: str, T_thing_in_pinch: Array) -> Iterable[Array]:
        """The same for a hand that holds the thing so, in the order in which they are tried."""
        return self._goals_once(bench, cast, thing)

    def places(self, bench: Bench, cast: Cast, thing: str) -> Sequence[Array]:
        """See `Skill`."""
        return [T[:2, 3] for T in itertools.islice(self._goals_once(bench, cast, thing), 1)]

    def fault(
        self,
        bench: Bench,
        cast: Cast,
        hand: Hand,
        thing: str,
        T_thing_in_pinch: Array,
        joints: Array,
        ahead: Sequence[Skill] = (),
    ) -> str | None:
        """See `Skill`."""
        fault = None
        load = Load(thing, T_thing_in_pinch, (TABLE, *bench.world.things))
        for T_lying in self._ordered_goals(bench, cast, thing, T_thing_in_pinch):
            T_goal = raised(T_lying, self.drop)
            T_pinch = T_goal @ inverse(T_thing_in_pinch)
            can_point_there = can_point(T_pinch, hand.arm.T_base_in_world)
            there = hand.reach(T_pinch, (joints, hand.ready)) if can_point_there else None
            if there is None:
                fault = f"the {hand.side} arm does not reach its goal with it"
                continue
            over = hand.reach(raised(T_goal, HOVER_HEIGHT) @ inverse(T_thing_in_pinch), (there,), PASSING)
            if over is None:
                fault = f"the {hand.side} arm does not reach over its goal with it"
            elif blocked := bench.touched(hand, there, hand.opening, load):
                fault = f"{blocked} at its goal"
            elif blocked := bench.touched(hand, over, hand.opening, Load(thing, T_thing_in_pinch)):
                fault = f"{blocked} over its goal"
            else:
                return None
        return fault

    def run(self, bench: Bench, cast: Cast, ahead: Sequence[Skill]) -> Iterator[Segment]:
        """See `Skill`."""
        thing = cast.one(self.thing)
        hand = require_holder(bench, thing, "put down")
        held = bench.update_held(hand)
        fault = f"the {hand.side} arm does not reach over its goal with the {thing}"
        for T_lying in self.relaxed(bench, cast)._ordered_goals(bench, cast, thing, held.T_thing_in_pinch):
            T_goal = raised(T_lying, self.drop)
            joints = self._over(hand, T_goal @ inverse(held.T_thing_in_pinch))
            if joints is None or hand.reach(T_goal @ inverse(held.T_thing_in_pinch), (joints,), PASSING) is None:
                continue
            try:
                path = bench.free_path(hand, joints, load=Load(thing, held.T_thing_in_pinch))
            except SkillFailedError as error:
                fault = str(error)
                continue
            yield bench.segment({hand: path})
            yield from self._lower(bench, hand, thing, T_goal)
            self._check(bench, thing, self.support(cast), T_lying)
            return
        raise SkillFailedError(Cause.UNREACHABLE, fault)

    def _over(self, hand: Hand, T_pinch: Array) -> Array | None:
        """Joints (dof,) of a hand over where its pinch frame is to go (4, 4)."""
        return hand.reach(raised(T_pinch, HOVER_HEIGHT), (hand.joints, hand.ready), PASSING)

    def _lower(self, bench: Bench, hand: Hand, thing: str, T_goal: Array) -> Iterator[Segment]:
        yield bench.segment({hand: bring(bench, hand, raised(T_goal, _RELEASE_GAP), self.LOWERING)})
        yield rest(bench)
        yield from let_go(bench, hand, bench.clearance(thing))
        yield rest(bench)

    def _check(self, bench: Bench, thing: str, onto: str, T_goal: Array) -> None:
        T = bench.world.pose(thing)
        offset = float(np.linalg.norm(T[:2, 3] - T_goal[:2, 3]))
        if offset > _MAX_OFFSET or T[2, 3] < T_goal[2, 3] - _MAX_OFFSET:
            raise SkillFailedError(
                Cause.OFF_TARGET, f"the {thing} lies {offset * 1000:.0f} mm beside its place on the {onto}"
            )


class Place(Placing):
    """Put a thing down, its heading as suits the arm: upright, or where no hand that takes it reaches that, in another
    way in which the thing lies steadily, if it is one that may lie so (`rests` of its config).

    Attributes:
        thing: a role; it is in a hand.
        on: a role, or `table`; the thing comes to lie over the middle of what plays it, on it or in it.
        at: where on it: x and y in its frame, or in `world` for the table, m.
        start_of: rather, a role: where its thing started.
        step, number: so far beside it, m, and so many times.
        heading_deg: of the thing in the frame of what it is put on; without, any. With it, the thing stands upright.
        upright: it has to stand upright.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "on", "start_of")
    ANY_MATERIAL: ClassVar[tuple[str, ...]] = ("on",)
    on: str
    at: tuple[Reach, Reach] | None = None
    start_of: str | None = None
    step: tuple[FiniteFloat, FiniteFloat] = (0.0, 0.0)
    number: Annotated[int, Field(ge=0)] = 0
    heading_deg: Annotated[FiniteFloat, Field(ge=-360, le=360)] | None = None
    upright: bool = False

    @model_validator(mode="after")
    def _somewhere(self) -> Place:
        if self.on == TABLE and self.at is None and self.start_of is None:
            raise ValueError("`on: table` needs `at` or `start_of`: where on it")
        return self

    def support(self, cast: Cast) -> str:
        """See `Placing`."""
        return TABLE if self.on == TABLE else cast.one(self.on)

    def goals(self, bench: Bench, cast: Cast, thing: str) -> Iterator[Array]:
        """See `Placing`."""
        onto = self.support(cast)
        place, T_onto = self._place(bench, cast)
        if self.heading_deg is not None:
            headings = [yaw(T_onto) + math.radians(self.heading_deg)]
        else:
            headings = [yaw(bench.world.pose(thing)) + turn for turn in _TURNS]
        for heading in headings:
            yield pose((*place, bench.height_on(thing, place, onto, heading)), rotation_z(heading))

    def relaxed(self, bench: Bench, cast: Cast) -> Place:
        """See `Skill`: it may lie otherwise than upright."""
        fixed = self.upright or self.heading_deg is not None
        if fixed or not bench.items[cast.one(self.thing)].rests_any_way:
            return self
        return _PlaceInAnyAttitude.model_construct(**dict(self))

    def _place(self, bench: Bench, cast: Cast) -> tuple[Array, Array]:
        """Where the thing is to lie (2,), and the pose (4, 4) of what it is to lie on, in `world`."""
        onto = self.support(cast)
        T_onto = pose() if onto == TABLE else bench.world.pose(onto)
        x, y = np.array(self.at or (0.0, 0.0)) + self.number * np.array(self.step)
        if self.start_of is not None:
            return bench.world.start(cast.one(self.start_of))[:2, 3], T_onto
        return (T_onto @ (x, y, 0.0, 1.0))[:2], T_onto


class _PlaceInAnyAttitude(Place):
    """Put a thing down in any way in which it lies steadily: upright if the hand reaches that."""

    def relaxed(self, bench: Bench, cast: Cast) -> Place:
        """See `Skill`."""
        return self

    def _ordered_goals(self, bench: Bench, cast: Cast, thing: str, T_thing_in_pinch: Array) -> Iterator[Array]:
        """See `Placing`. Of the other ways to lie, those where the hand comes from above come first."""
        yield from self._goals_once(bench, cast, thing)
        lying = bench.cached((self, "others", thing), lambda: self._lying_goals(bench, cast, thing))
        T_pinch_in_thing = inverse(T_thing_in_pinch)

        def forward(T: Array) -> Array:
            direction: Array = (T @ T_pinch_in_thing)[:3, 2]
            return direction

        reachable = [T for T in lying if forward(T)[2] < _MAX_UPWARD]
        yield from sorted(reachable, key=lambda T: float(forward(T)[2]))

    def _lying_goals(self, bench: Bench, cast: Cast, thing: str) -> list[Array]:
        """Where the thing may lie otherwise than upright, its centre of mass over the place."""
        place, _ = self._place(bench, cast)
        centre = np.array(bench.items[thing].inertia.centre)
        heading = yaw(bench.world.pose(thing))
        found = []
        for R in bench.steady_rotations(thing)[1:]:
            for turn in _TURNS:
                turned = rotation_z(heading + turn) @ R
                T = pose((*(place - (turned @ centre)[:2]), 0.0), turned)
                T[2, 3] = bench.height_of(thing, T, self.support(cast))
                found.append(T)
        return found


def raised(T: Array, height: float) -> Array:
    """A pose (4, 4) so much higher, m."""
    higher = T.copy()
    higher[2, 3] += height
    return higher
