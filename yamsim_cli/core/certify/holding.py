"""Whether a hand can take a thing from a table where its config says, and hold it: lift it, turn it, shake it."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..config.things.thing import FrictionGrasp, GraspPoint
from ..geometry.se3 import Array, pose, rotation_from_vector
from ..scene.breakdown import breakdown
from .hand import Hand, full_opening, slip
from .outcome import Outcome, View, short, unchecked
from .subject import Subject

# The fingers close for so long, then weight comes, the hand turns and shakes, s.
_CLOSE, _HOLD, _TURN, _SHAKE = 0.8, 0.8, 1.6, 1.0
_STEP = 0.02
# It is lifted, turned about the axis along which the pads close and about the one across, and shaken to and fro: m,
# rad, m, Hz.
_LIFT, _ANGLE, _AMPLITUDE, _RATE = 0.05, np.radians(45), 0.015, 3.0
# How far it may move and turn between the pads in all, m, rad. A person would still call it held.
_MOVED, _TURNED = 0.012, np.radians(20)
# How deep an open hand may reach into what it comes to hold, m.
_OVERLAP = 0.0015
# Of all places that a config names, so many are tried, the best first.
_PLACES = 2


def grasp(looked: Subject) -> Outcome:
    """Whether two pads hold it by friction: the best of its places, and how many others."""
    item = looked.item
    if item.links or item.base == "fixed":
        return unchecked("it is opened rather than lifted: its handles are for that")
    if item.grasp is None or item.grasp.friction is None:
        return unchecked("it says nowhere how friction could hold it")
    friction = item.grasp.friction
    if friction.hands > 1:
        return unchecked("it takes two hands, and one alone was to try")
    widest = full_opening(looked.locations)
    fitting = [point for point in friction.points if point.opening < widest]
    if not fitting:
        return unchecked(f"{2000 * item.grasp.opening:.4g} mm wide: more than the hand opens, {2000 * widest:.4g} mm")
    hand = Hand.of(looked)
    clearance = item.grasp.clearance
    tried = [_try(hand, point, friction, clearance) for point in fitting[:_PLACES]]
    first = tried[0]
    figures = {
        "places": len(tried),
        "held": sum(trial.held for trial in tried),
        "force_n": short(friction.force, 3),
        "slip_mm": short(first.moved * 1000, 3),
        "turn_deg": short(np.degrees(first.turned), 3),
        "overlap_mm": short(first.overlap * 1000, 3),
    }
    note = "" if first.held else first.fault
    return Outcome(first.held, figures, note, first.views)


@dataclass(frozen=True)
class _Trial:
    moved: float
    turned: float
    overlap: float
    fault: str
    views: tuple[View, ...]

    @property
    def held(self) -> bool:
        return not self.fault


def _try(hand: Hand, point: GraspPoint, friction: FrictionGrasp, clearance: float) -> _Trial:
    T = point.T_pinch_in_object(flipped=False)
    hand.reach(T, min(point.opening + clearance, full_opening(hand.looked.locations)))
    overlap, in_table = hand.overlap(table=False), hand.overlap(table=True)
    coming = (View(hand.model, hand.data.qpos.copy(), "the hand comes"),)
    if overlap > _OVERLAP:
        return _Trial(0, 0, overlap, f"the hand reaches {overlap * 1000:.3g} mm into it before it closes", coming)
    if in_table > 0:
        fault = f"the hand reaches {in_table * 1000:.3g} mm into the table that it stands on"
        return _Trial(0, 0, overlap, fault, coming)
    told = point.opening - 2 * friction.force / hand.drive_gain
    for share in np.linspace(0, 1, round(_CLOSE / 2 / _STEP)):
        hand.squeeze(point.opening + clearance * (1 - share))
        hand.run(_STEP)
    hand.squeeze(told)
    hand.run(_CLOSE / 2)
    held = hand.T_thing_in_pinch
    far = [_go(hand, T, held, np.linspace(0, 1, round(_HOLD / _STEP)), _lifted)]
    views = [View(hand.model, hand.data.qpos.copy(), "lifted")]
    hand.remove_table()
    there = np.sin(np.linspace(0, np.pi, round(_TURN / _STEP)))
    far += [_go(hand, T, held, there, functools.partial(_turned, axis=axis)) for axis in (0, 1)]
    times = np.linspace(0, _SHAKE, round(_SHAKE / _STEP))
    far += [_go(hand, T, held, times, functools.partial(_shaken, axis=axis)) for axis in range(3)]
    views.append(View(hand.model, hand.data.qpos.copy(), "after turning and shaking"))
    moved, turned = (max(each[k] for each in far) for k in (0, 1))
    fault = ""
    if breakdown(hand.data) is not None or not np.isfinite(hand.data.qpos).all():
        fault = "physics broke down"
    elif moved > _MOVED or turned > _TURNED:
        when = next(
            word
            for word, (a, b) in zip(("lifted", "turned", "turned", "shaken", "shaken", "shaken"), far, strict=True)
            if a > _MOVED or b > _TURNED
        )
        fault = f"when {when}, it slips {moved * 1000:.3g} mm and turns {np.degrees(turned):.3g} degrees in the pads"
    return _Trial(moved, turned, overlap, fault, tuple(views))


def _go(hand: Hand, T: Array, held: Array, way: Array, at: Callable[[Array, float], Array]) -> tuple[float, float]:
    """Move the hand along a way; the farthest that the thing slips and turns on it."""
    far = (0.0, 0.0)
    for share in way:
        hand.aim(at(T, float(share)))
        hand.run(_STEP)
        moved, turned = slip(held, hand.T_thing_in_pinch)
        far = (max(far[0], moved), max(far[1], turned))
    return far


def _lifted(T: Array, share: float) -> Array:
    return pose((0, 0, _LIFT * share)) @ T


def _turned(T: Array, share: float, axis: int) -> Array:
    """Turned about the pinch's own x or y."""
    return pose((0, 0, _LIFT)) @ T @ pose((0, 0, 0), rotation_from_vector(_ANGLE * share * np.eye(3)[axis]))


def _shaken(T: Array, time: float, axis: int) -> Array:
    by = _AMPLITUDE * np.sin(2 * np.pi * _RATE * time) * np.eye(3)[axis]
    return pose(np.array([0, 0, _LIFT]) + by) @ T
