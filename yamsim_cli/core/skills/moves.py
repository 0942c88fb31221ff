"""Motions that several skills are made of."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress

from ..geometry.se3 import Array, inverse, pose
from ..planning.joint_motion import clear
from .bench import Bench, Fingers, Segment, SkillFailedError
from .grips import Grip
from .hand import PASSING, Hand

# Control ticks in which fingers close on something, or open; and in which what was let go comes to rest.
GRIP_TICKS = 10
_OPEN_TICKS = 8
_REST_TICKS = 4

# m, how far a hand draws back from what it let go; and where joints come too near to their stops on that
_RETREAT, _SHORT_RETREAT = 0.07, 0.04


def take_hold(bench: Bench, hand: Hand, grip: Grip) -> Iterator[Segment]:
    """Close the fingers on a thing between them, and let everything come to rest.

    Fingers close to a force; a hand with a weld closes them only as far as the thing is opening, and switches its magnet
    on.
    """
    closing = Fingers(grip.opening, 0.0 if hand.welds else grip.force)
    yield bench.segment({hand: bench.still(hand, GRIP_TICKS)}, {hand: closing})
    hand.magnet = hand.welds
    yield rest(bench)


def let_go(bench: Bench, hand: Hand, clearance: float) -> Iterator[Segment]:
    """Open the fingers by so much a finger, and draw the hand back the way it points, or up."""
    opening = min(hand.opening + clearance, hand.max_opening)
    hand.magnet = False
    yield bench.segment({hand: bench.still(hand, _OPEN_TICKS)}, {hand: Fingers(opening)}, arrives=False)
    thing, hand.held = None if hand.held is None else hand.held.thing, None
    # Fingers that were around something start near to it. Where no path is free, the first one has to do.
    retreat: Array | None = None
    for path in _retreats(bench, hand):
        if clear(path, lambda joints: bench.touched(hand, joints, opening, between=thing)):
            retreat = path
            break
        retreat = path if retreat is None else retreat
    if retreat is not None:
        yield bench.segment({hand: retreat}, arrives=False)


def _retreats(bench: Bench, hand: Hand) -> Iterator[Array]:
    """Yield straight paths (n + 1, dof) by which a hand leaves what it let go: those that end away from stops first."""
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
    """A motion (n + 1, dof) that takes what a hand holds straight to a pose (4, 4) in `world`, at a speed, m/s.

    Raises:
        SkillFailedError: the hand holds nothing any more, or the line leaves the arm's reach.
    """
    held = bench.update_held(hand)
    # The arm sags a little under its load: what it was told lies so far off what it does.
    T_commanded_in_pinch = inverse(bench.T_pinch(hand)) @ hand.pinch_at(hand.joints)
    return bench.line(hand, T_thing @ inverse(held.T_thing_in_pinch) @ T_commanded_in_pinch, speed)


def park(bench: Bench, hand: Hand) -> Iterator[Segment]:
    """Bring a hand that holds nothing out of the way."""
    if not _parked(hand):
        yield bench.segment({hand: bench.free_path(hand, hand.ready)}, arrives=False)


def idle(bench: Bench) -> list[Hand]:
    """The hands that hold nothing, and are not out of the way."""
    return [hand for hand in bench.free_hands("any") if not _parked(hand)]


def _parked(hand: Hand) -> bool:
    return bool(abs(hand.joints - hand.ready).max() <= 1e-6)


def park_free(bench: Bench, but: Hand | None = None) -> Iterator[Segment]:
    """Bring the hands that hold nothing out of the way, except one."""
    for hand in bench.hands:
        if hand is not but and hand.held is None:
            yield from park(bench, hand)


def rest(bench: Bench) -> Segment:
    """Let everything come to rest."""
    return bench.wait(_REST_TICKS)


def recover(bench: Bench) -> Iterator[Segment]:
    """Bring hands that hold nothing out of the way, their fingers open. Where one is in another one's way, that goes
    first.

    Raises:
        SkillFailedError: there is no free way for any of those that are left.
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
