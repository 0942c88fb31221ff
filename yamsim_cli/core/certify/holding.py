"""Whether the skill `pick` takes a thing from a table, and whether the hand then holds it: turned and shaken."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..attempt.alone import Taken, take
from ..geometry.se3 import Array, inverse, pose, rotation_from_vector
from ..scene.breakdown import breakdown
from ..skills.errors import SkillFailedError
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


def grasp(looked: Subject) -> Outcome:
    """Whether the skill `pick` takes it from a table with its own choice of a grip, and two pads then hold it so."""
    item = looked.item
    if item.links or item.base == "fixed":
        return unchecked("it is opened rather than lifted: its handles are for that")
    if item.grasp is None or item.grasp.friction is None:
        return unchecked("it says nowhere how friction could hold it")
    friction = item.grasp.friction
    if friction.hands > 1:
        return unchecked("it takes two hands, and one alone was to try")
    widest = full_opening(looked.locations)
    if all(point.opening >= widest for point in friction.points):
        return unchecked(f"{2000 * item.grasp.opening:.4g} mm wide: more than the hand opens, {2000 * widest:.4g} mm")
    try:
        taken = take(item, replace(looked.locations, meshes=looked.meshes))
    except SkillFailedError as error:
        return Outcome(False, {"force_n": short(friction.force, 3)}, f"the skill `pick` fails: {error}")
    return _held(Hand.of(looked), taken, item.grasp.clearance)


def _held(hand: Hand, taken: Taken, clearance: float) -> Outcome:
    """Whether a thing stays in the pads that have taken it."""
    T = inverse(taken.T_thing_in_pinch)
    gravity = hand.model.opt.gravity.copy()
    # Without weight nothing falls before the pads press.
    hand.model.opt.gravity[:] = 0.0
    hand.reach(T, min(taken.opening + clearance, full_opening(hand.looked.locations)))
    for share in np.linspace(0, 1, round(_CLOSE / 2 / _STEP)):
        hand.squeeze(taken.opening + clearance * (1 - share))
        hand.run(_STEP)
    hand.squeeze(taken.opening - 2 * taken.force / hand.drive_gain)
    hand.run(_CLOSE / 2)
    hand.model.opt.gravity[:] = gravity
    held = hand.T_thing_in_pinch
    far = [_go(hand, T, held, np.linspace(0, 1, round(_HOLD / _STEP)), _lifted)]
    views = [View(hand.model, hand.data.qpos.copy(), "lifted")]
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
    figures = {
        "force_n": short(taken.force, 3),
        "lean_deg": short(np.degrees(np.arccos(np.clip(-T[2, 2], -1, 1))), 3),
        "slip_mm": short(moved * 1000, 3),
        "turn_deg": short(np.degrees(turned), 3),
    }
    return Outcome(not fault, figures, fault, tuple(views))


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
