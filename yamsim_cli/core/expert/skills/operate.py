"""Open or close a part of an articulated thing by its handle."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field, FiniteFloat

from ...config.goals.cast import Cast
from ...config.things.articulation import Link
from ...geometry.se3 import Array, inverse, pose, rotation_from_vector
from ...types import Cause
from .base import Side, Skill
from .bench import Bench, Fingers, Segment, SkillFailedError
from .grips import CLEARANCE
from .hand import PASSING, Hand
from .moves import GRIP_TICKS, let_go, park_free, rest

_APPROACH = 0.08  # m, length of the straight approach to a handle
_FORCE = 25.0  # N, of each finger on a handle
_SPEED = 0.12  # m/s, of the hand while it moves a part

_TOLERANCE = 0.1  # share of the joint's range; a joint this near to its goal is there


class Operate(Skill):
    """Grasp a handle, move it along the path of its joint, and release it.

    Attributes:
        thing: a role.
        joint: the name of the part that moves, such as `drawer`.
        to: goal as a share of the joint's range: 1 is open, 0 is closed.
        arm: which arm.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    thing: str
    joint: str
    to: Annotated[FiniteFloat, Field(ge=0, le=1)]
    arm: Side = "any"

    def run(self, bench: Bench, cast: Cast, ahead: Sequence[Skill]) -> Iterator[Segment]:
        """See `Skill`."""
        thing = cast.one(self.thing)
        link = next((link for link in bench.items[thing].links if link.name == self.joint), None)
        if link is None or not link.handles:
            raise SkillFailedError(Cause.UNREACHABLE, f"the {thing} has no part {self.joint!r} with a handle")
        if abs(bench.world.opening(thing, self.joint) - self.to) <= _TOLERANCE:
            return
        yield from self._move(bench, thing, link)
        yield rest(bench)
        if abs((share := bench.world.opening(thing, self.joint)) - self.to) > _TOLERANCE:
            raise SkillFailedError(Cause.OFF_TARGET, f"the {self.joint} of the {thing} is open by {share:.0%}")

    def _move(self, bench: Bench, thing: str, link: Link) -> Iterator[Segment]:
        T_part = bench.world.part_pose(thing, link.name)
        fault = f"no arm reaches a handle of the {link.name}"
        for hand in bench.free_hands(self.arm):
            for handle in link.handles:
                for turn in (0.0, math.pi):
                    T_in_part = handle.T_pinch_in_part @ pose(rotation=rotation_from_vector([0.0, 0.0, turn]))
                    opening = min(handle.opening + CLEARANCE, hand.max_opening)
                    before = self._before(bench, hand, thing, T_part @ T_in_part, opening)
                    pose_at = self._pinch_path(bench, thing, link, T_part, T_in_part)
                    if before is None or not _reaches(hand, before, pose_at):
                        continue
                    yield from park_free(bench, hand)
                    try:
                        path = bench.free_path(hand, before, opening)
                    except SkillFailedError as error:
                        fault = str(error)
                        continue
                    yield bench.segment({hand: path}, {hand: Fingers(opening)})
                    yield bench.segment({hand: bench.line(hand, T_part @ T_in_part)})
                    closing = Fingers(handle.opening, _FORCE)
                    yield bench.segment({hand: bench.still(hand, GRIP_TICKS)}, {hand: closing})
                    seconds = float(np.linalg.norm(pose_at(1.0)[:3, 3] - pose_at(0.0)[:3, 3])) / _SPEED
                    yield bench.segment({hand: bench.curve(hand, pose_at, seconds)})
                    yield rest(bench)
                    yield from let_go(bench, hand, CLEARANCE)
                    return
        raise SkillFailedError(Cause.UNREACHABLE, fault)

    def _before(self, bench: Bench, hand: Hand, thing: str, T_at: Array, opening: float) -> Array | None:
        """Return joints (dof,) before the straight approach to a handle; None if it is out of reach or blocked."""
        at = hand.reach(T_at, (hand.joints, hand.ready))
        if at is None or bench.touched(hand, at, opening, between=thing):
            return None
        before = hand.reach(T_at @ pose((0.0, 0.0, -_APPROACH)), (at,), PASSING)
        return None if before is None or bench.touched(hand, before, opening) else before

    def _pinch_path(
        self, bench: Bench, thing: str, link: Link, T_part: Array, T_in_part: Array
    ) -> Callable[[float], Array]:
        """Return a function from a share of the joint's motion to the pose (4, 4) of the pinch frame in `world`."""
        joint = link.joint
        low, high = (joint.si(end) for end in joint.range)
        start = low + bench.world.opening(thing, link.name) * (high - low)
        goal = low + self.to * (high - low)
        axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
        T_axis = pose(joint.position)

        def pose_at(share: float) -> Array:
            change = share * (goal - start)
            if joint.turns:
                return (
                    T_part @ T_axis @ pose(rotation=rotation_from_vector(axis * change)) @ inverse(T_axis) @ T_in_part
                )
            return T_part @ pose(axis * change) @ T_in_part

        return pose_at


def _reaches(hand: Hand, start: Array, pose_at: Callable[[float], Array]) -> bool:
    """Return whether a hand can follow a path of its pinch frame, tested at five poses."""
    joints: Array | None = start
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        joints = None if joints is None else hand.reach(pose_at(share), (joints,), PASSING)
    return joints is not None
