"""What was identified of an arm, in figures: values with intervals, and what the logs cannot tell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import DatasetError
from .fit import Fitted, Parameter, value
from .intervals import half_widths
from .plant import TIMESTEP, ArmPlant

# Field of `Values` -> what it is called in results.
NAMES = {
    "delay": "delay_s",
    "friction": "friction_nm",
    "damping": "damping_nms",
    "armature": "armature",
    "offset": "offset_rad",
    "gravity": "gravity_factor",
}
# An interval is no narrower than what other physics would make of the same log: a controller's own step, s; another law
# of friction, which shows as friction, and a share of it as damping and inertia; an encoder's step, rad.
_DELAY, _FRICTION, _DAMPING, _ARMATURE, _OFFSET, _GRAVITY = 0.0006, 0.03, 0.02, 0.05, 0.0004, 0.003
_OTHER_LAW = 0.05
# A log tells nothing of what stays as it was believed before: an interval more than this share of that.
_TOLD = 0.7
# A joint is badly excited if these are not known to within this share of their size.
_REFUSED = {"friction": 0.5, "damping": 0.6}


@dataclass(frozen=True)
class Estimate:
    """A parameter's value, and the interval in which it lies at 95 %.

    Attributes:
        joint: whose; empty of what all joints have in common.
        name: as in `NAMES`' values, which say the unit.
        before: in the model.
        told: whether the log says anything of it.
    """

    joint: str
    name: str
    value: float
    low: float
    high: float
    before: float
    told: bool

    def plain(self) -> dict[str, Any]:
        """As JSON has it."""
        return {"value": self.value, "low": self.low, "high": self.high, "model": self.before, "told": self.told}


def estimates(plant: ArmPlant, fitted: Fitted) -> list[Estimate]:
    """All that was fitted, the delay first, then joint by joint."""
    found = []
    for parameter, half in zip(fitted.parameters, half_widths(fitted), strict=True):
        if parameter.name not in NAMES:
            continue
        number = value(fitted.values, parameter)
        whole = float(half) + _least_half(plant, fitted, parameter)
        low = max(number - whole, 0.0) if parameter.name in ("delay", "friction", "armature") else number - whole
        joint = "" if parameter.joint is None else plant.robot.joint_names[parameter.joint]
        before = value(plant.values, parameter)
        told = bool(half < _TOLD * 1.96 * parameter.spread)
        found.append(Estimate(joint, NAMES[parameter.name], number, low, number + whole, before, told))
    return found


def _least_half(plant: ArmPlant, fitted: Fitted, parameter: Parameter) -> float:
    """Half of how narrow an interval may be at least."""
    size, k = value(fitted.values, parameter), 0 if parameter.joint is None else parameter.joint
    damped = float(plant.kv[k] + fitted.values.damping[k])
    match parameter.name:
        case "delay":
            return _DELAY
        case "friction":
            return _FRICTION * size
        case "damping":
            return _DAMPING * damped
        case "armature":
            # Where in its step a controller damps shows as inertia.
            law = _OTHER_LAW * float(fitted.values.friction[k]) / max(float(fitted.accelerations[k]), 1e-3)
            return _ARMATURE * size + damped * TIMESTEP / 4 + law
        case "offset":
            return _OFFSET
    return _GRAVITY


def check_told(plant: ArmPlant, found: list[Estimate], name: str) -> None:
    """Refuse logs that leave a joint's friction or damping open.

    Raises:
        DatasetError: the message names the joint and what to record.
    """
    for number, joint in enumerate(plant.robot.joint_names):
        of = {each.name: each for each in found if each.joint == joint}
        damping, friction = of[NAMES["damping"]], of[NAMES["friction"]]
        sizes = {
            "friction": max(friction.value, 0.01 * plant.most_torque[number]),
            "damping": plant.kv[number] + damping.value,
        }
        for key, share in _REFUSED.items():
            each = of[NAMES[key]]
            half = (each.high - each.low) / 2
            if half > share * sizes[key]:
                raise DatasetError(
                    f"{name}: {joint} is badly excited: its {key} may be anything from {each.low:.3g} to "
                    f"{each.high:.3g} {'N m' if key == 'friction' else 'N m s/rad'}; record it turning at several "
                    "speeds, with turns back; `yamsim excite` writes such a motion"
                )


def cannot_tell(found: list[Estimate], gripper: bool) -> list[str]:
    """What the logs do not say, and what no such log can, a sentence each.

    Args:
        gripper: whether they say how far it was open, where the arm has one.
    """
    said = [
        f"{each.joint or 'the arm'}: {each.name} stays near the model's {each.before:.3g}: the log holds it to "
        f"{each.low:.3g}..{each.high:.3g} only"
        for each in found
        if not each.told
    ]
    if not gripper:
        said.append(
            "nobody recorded the gripper, and it counts as closed: if it was open, its fingers' inertia shows in the "
            "last joint's armature"
        )
    return [
        *said,
        "damping_nms is what the joint has beside the model's kv, which is held: the log tells only their sum",
        "kp is held at the model's: friction, damping and armature are in proportion to it",
        "delay_s is that of commands and sensors together",
        "a mass at the tip would show as gravity factors of the joints that carry it",
    ]


def rms(errors: np.ndarray) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(errors))))
