"""Hang a held thing on a peg."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np

from ...config.goals.cast import Cast
from ...config.goals.predicates import Hung
from ...geometry.se3 import Array, inverse, pose, rotation_z
from ...types import Cause
from ..planning.joint_motion import clear, straight
from ..planning.obstacles import Load
from .base import Skill, require_holder
from .bench import Bench, Segment, SkillFailedError
from .hand import PASSING, Hand
from .moves import bring, let_go, park_free, rest

_DEPTHS = (0.045, 0.055, 0.035)  # m, of the eye behind the peg's tip, in the order tried
_APPROACH = 0.04  # m, of the thing before the peg's tip when the straight approach starts

# rad, of the thing about the peg, since it may turn when released; the smallest first
_LEANS = tuple(math.radians(angle) for angle in (0, 20, -20, 40, -40))

# Motion onto the peg and down.
_SPEED = 0.10  # m/s
_RELEASE_GAP = 0.001  # m, of the eye over the peg at the release
_SWING_TICKS = 40  # control ticks in which the thing swings to rest


class Hang(Skill):
    """Move the eye of a thing over a peg, and release the thing.

    Attributes:
        thing: a role; it is in a hand, and has a handle called `eye`, which points through an opening.
        onto: a role; it has a handle called `peg`, which points from the peg's tip to its root.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "onto")
    NEEDS_HELD: ClassVar[bool | None] = True
    LEAVES_HELD: ClassVar[bool | None] = False
    thing: str
    onto: str

    def places(self, bench: Bench, cast: Cast, thing: str) -> Sequence[Array]:
        """See `Skill`."""
        return [bench.world.mark(cast.one(self.onto), "peg")[:2, 3]]

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
        fault = f"the {hand.side} arm does not reach the peg with it"
        load = Load(thing, T_thing_in_pinch)
        for before, T_on in self._candidates(bench, cast, hand, thing, T_thing_in_pinch, (joints, hand.ready)):
            at_peg = hand.reach(T_on @ inverse(T_thing_in_pinch), (before,), PASSING)
            if at_peg is None:
                continue
            blocked = bench.touched(hand, at_peg, hand.opening, load) or bench.touched(hand, before, hand.opening, load)
            if blocked is None:
                return None
            fault = f"{blocked} at the peg"
        return fault

    def run(self, bench: Bench, cast: Cast, ahead: Sequence[Skill]) -> Iterator[Segment]:
        """See `Skill`."""
        thing = cast.one(self.thing)
        hand = require_holder(bench, thing, "hung up")
        held = bench.update_held(hand)
        yield from park_free(bench, hand)
        load = Load(thing, held.T_thing_in_pinch)
        fault = f"the {hand.side} arm does not reach the peg with the {thing}"
        candidates = self._candidates(bench, cast, hand, thing, held.T_thing_in_pinch, (hand.joints, hand.ready))
        for before, T_on in candidates:
            onto = straight(hand.ik, before, T_on @ inverse(held.T_thing_in_pinch), bench.tick, _SPEED)
            if onto is None or not clear(onto, lambda joints: bench.touched(hand, joints, hand.opening, load)):
                continue
            try:
                path = bench.free_path(hand, before, load=load)
            except SkillFailedError as error:
                fault = str(error)
                continue
            yield bench.segment({hand: path})
            yield bench.segment({hand: bring(bench, hand, T_on, _SPEED)})
            T_down = bench.world.pose(thing)
            T_down[2, 3] = (
                bench.obstacles.rest_height(bench.qpos, thing, T_down, T_down[2, 3] - _APPROACH) + _RELEASE_GAP
            )
            yield bench.segment({hand: bring(bench, hand, T_down, _SPEED)})
            yield from let_go(bench, hand, bench.clearance(thing))
            yield bench.wait(_SWING_TICKS)
            yield rest(bench)
            self._check(bench, cast)
            return
        raise SkillFailedError(Cause.UNREACHABLE, fault)

    def _candidates(
        self, bench: Bench, cast: Cast, hand: Hand, thing: str, T_thing_in_pinch: Array, seeds: Sequence[Array]
    ) -> Iterator[tuple[Array, Array]]:
        """Yield joints (dof,) of a hand that holds a thing before the peg, with the thing's pose (4, 4) on the peg."""
        T_peg = bench.world.mark(cast.one(self.onto), "peg")
        T_eye_in_thing = inverse(bench.world.pose(thing)) @ bench.world.mark(thing, "eye")
        for T_eye in _eyes(T_peg):
            T_on = T_eye @ inverse(T_eye_in_thing)
            T_before = T_on.copy()
            T_before[:3, 3] -= T_peg[:3, 2] * (_APPROACH + float((T_eye - T_peg)[:3, 3] @ T_peg[:3, 2]))
            before = hand.reach(T_before @ inverse(T_thing_in_pinch), seeds, PASSING)
            if before is not None:
                yield before, T_on

    def _check(self, bench: Bench, cast: Cast) -> None:
        for measure in Hung(thing=self.thing, onto=self.onto).measures(bench.world, cast):
            if not measure.holds:
                raise SkillFailedError(Cause.OFF_TARGET, f"{measure.what}: {measure.detail}")


def _eyes(T_peg: Array) -> Iterator[Array]:
    """Yield candidate poses (4, 4) of an eye on a peg, in `world`, y up; those that lean least first."""
    along = T_peg[:3, 2]
    level = np.array((along[0], along[1], 0.0)) / math.hypot(along[0], along[1])
    for lean in _LEANS:
        for depth in _DEPTHS:
            for z in (level, -level):
                R = np.column_stack([np.cross((0.0, 0.0, 1.0), z), (0.0, 0.0, 1.0), z]) @ rotation_z(lean)
                yield pose(T_peg[:3, 3] + depth * along, R)
