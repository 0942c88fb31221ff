"""Motions that several skills share."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

from ...geometry.se3 import Array, inverse, pose
from ..planning.joint_motion import clear
from .bench import Bench, Fingers, Segment, SkillFailedError
from .grips import Grip
from .hand import PASSING, Hand

GRIP_TICKS = 10  # control ticks in which fingers close
_OPEN_TICKS = 8  # control ticks in which fingers open
_REST_TICKS = 4  # control ticks in which the arms and a released thing come to rest

# m, how far a hand draws back from a released thing; the shorter one if the other ends near a joint's stop
_RETREAT, _SHORT_RETREAT = 0.07, 0.04


def take_hold(bench: Bench, hand: Hand, grip: Grip) -> Iterator[Segment]:
    """Yield segments that close the fingers on the thing between them, and wait until everything rests.

    Fingers close with the grip's force. A hand with a weld closes to the thing's width, and switches its magnet on.
    """
    closing = Fingers(grip.opening, 0.0 if hand.welds else grip.force)
    yield bench.segment({hand: bench.still(hand, GRIP_TICKS)}, {hand: closing})
    hand.magnet = hand.welds
    yield rest(bench)


def let_go(bench: Bench, hand: Hand, clearance: float) -> Iterator[Segment]:
    """Yield segments that open each finger by a clearance (m), and draw the hand back along its axis or up."""
    opening = min(hand.opening + clearance, hand.max_opening)
    hand.magnet = False
    yield bench.segment({hand: bench.still(hand, _OPEN_TICKS)}, {hand: Fingers(opening)}, arrives=False)
    thing, hand.held = None if hand.held is None else hand.held.thing, None
    # Open fingers are still near to the thing. If no path is free of contacts, the first path is used.
    retreat: Array | None = None
    for path in _retreats(bench, hand):
        if clear(path, lambda joints: bench.touched(hand, joints, opening, between=thing)):
            retreat = path
            break
        retreat = path if retreat is None else retreat
    if retreat is not None:
        yield bench.segment({hand: retreat}, arrives=False)


def _retreats(bench: Bench, hand: Hand) -> Iterator[Array]:
    """Yield straight paths (n + 1, dof) away from a released thing, those that end away from stops first."""
    T = hand.pinch_at(hand.joints)
    paths = []
    for distance in (_RETREAT, _SHORT_RETREAT):
        back, up = T @ pose((0.0, 0.0, -distance)), T.copy()
        up[2, 3] += distance
        for T_clear in (back, up):
            with suppress(SkillFailedError):
                path = bench.line(hand, T_clear)
                if hand.ik.at(path[-1]).margin >= PASSING.margin:
                    yield path
                else:
                    paths.append(path)
    yield from paths


def bring(bench: Bench, hand: Hand, T_thing: Array, speed: float) -> Array:
    """Return a motion (n + 1, dof) that moves a held thing straight to a pose (4, 4) in `world`, at a speed in m/s.

    Raises:
        SkillFailedError: the hand no longer holds anything, or the line leaves the arm's reach.
    """
    held = bench.update_held(hand)
    # The arm sags under its load, so the measured pose differs from the commanded pose by this transform.
    T_commanded_in_pinch = inverse(bench.T_pinch(hand)) @ hand.pinch_at(hand.joints)
    return bench.line(hand, T_thing @ inverse(held.T_thing_in_pinch) @ T_commanded_in_pinch, speed)


def park(bench: Bench, hand: Hand) -> Iterator[Segment]:
    """Yield the motion of a hand that holds nothing to its ready posture, unless it is there."""
    if not _parked(hand):
        yield bench.segment({hand: bench.free_path(hand, hand.ready)}, arrives=False)


def idle(bench: Bench) -> list[Hand]:
    """Return the hands that hold nothing and are not parked."""
    return [hand for hand in bench.free_hands("any") if not _parked(hand)]


def _parked(hand: Hand) -> bool:
    return bool(abs(hand.joints - hand.ready).max() <= 1e-6)


def park_free(bench: Bench, except_hand: Hand | None = None) -> Iterator[Segment]:
    """Yield the motions that park all hands that hold nothing, except `except_hand`."""
    for hand in bench.hands:
        if hand is not except_hand and hand.held is None:
            yield from park(bench, hand)


def rest(bench: Bench) -> Segment:
    """Return the segment in which everything comes to rest."""
    return bench.wait(_REST_TICKS)


def recover(bench: Bench) -> Iterator[Segment]:
    """Yield motions that open and park all hands that hold nothing; a blocked hand waits until others are parked.

    Raises:
        SkillFailedError: none of the remaining hands has a free path.
    """
    waiting = bench.free_hands("any")
    while waiting:
        before, faults = len(waiting), list[SkillFailedError]()
        for hand in tuple(waiting):
            try:
                if hand.opening < hand.max_opening / 4:
                    yield from let_go(bench, hand, hand.max_opening / 2)
                yield from park(bench, hand)
                waiting.remove(hand)
            except SkillFailedError as fault:
                faults.append(fault)
        if len(waiting) == before:
            raise faults[0]
