"""Estimates of identified parameters with 95 % intervals, and the parameters that the logs do not determine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.geometry.se3 import Array

from .parameter_fit import FitParameter, FitResult, parameter_value
from .plant_model import TIMESTEP, ParametricArm

# Field of `PlantParameters` -> its name in results, which has the unit.
NAMES = {
    "delay": "delay_s",
    "friction": "friction_nm",
    "damping": "damping_nms",
    "armature": "armature",
    "offset": "offset_rad",
    "gravity": "gravity_factor",
}
# Half width that is added to each parameter's interval, because real physics differs from the model.
_DELAY = 0.0006  # s, timestep of a controller
_FRICTION, _DAMPING, _ARMATURE = 0.03, 0.02, 0.05  # shares of the value: real friction may obey another law
_FRICTION_AS_INERTIA = 0.05  # share of the friction torque that appears as inertia if real friction obeys another law
_OFFSET = 0.0004  # rad, resolution of an encoder
_GRAVITY = 0.003  # of the gravity factor, which has no unit
_DETERMINED_SHARE = 0.7  # a parameter is determined if its interval is narrower than this share of the prior's
# Half widths of the intervals, as shares of the value, above which an identification is refused.
_MAX_HALF_WIDTHS = {"friction": 0.5, "damping": 0.6}

# s, length of a block of the logs. Errors within a block are correlated, because friction holds a joint beside its
# target until the joint reverses.
_BLOCK = 2.5
_MIN_BLOCKS = 6  # least number of blocks into which the logs are divided


@dataclass(frozen=True)
class Estimate:
    """A parameter's value and its 95 % interval.

    Attributes:
        joint: name of the joint; empty for parameters of the whole arm.
        name: name of the parameter with its unit, such as `friction_nm`; a value of `NAMES`.
        value: estimated value, in the unit of its name.
        low, high: bounds of the 95 % interval.
        model_value: value in the arm's model before the identification.
        is_determined: whether the logs determine the parameter.
    """

    joint: str
    name: str
    value: float
    low: float
    high: float
    model_value: float
    is_determined: bool

    def to_json_data(self) -> dict[str, Any]:
        """Return the estimate as JSON data."""
        return {
            "value": self.value,
            "low": self.low,
            "high": self.high,
            "model": self.model_value,
            "told": self.is_determined,
        }


def estimate_parameters(plant: ParametricArm, fitted: FitResult) -> list[Estimate]:
    """Return the value and the interval of each fitted parameter in `NAMES`, the delay first, then joint by joint."""
    found = []
    for parameter, half in zip(fitted.parameters, half_widths(fitted), strict=True):
        if parameter.name not in NAMES:
            continue
        number = parameter_value(fitted.values, parameter)
        whole = float(half) + _min_half_width(plant, fitted, parameter)
        low = max(number - whole, 0.0) if parameter.name in ("delay", "friction", "armature") else number - whole
        joint = "" if parameter.joint is None else plant.robot.joint_names[parameter.joint]
        before = parameter_value(plant.values, parameter)
        told = bool(half < _DETERMINED_SHARE * 1.96 * parameter.prior_sigma)
        found.append(Estimate(joint, NAMES[parameter.name], number, low, number + whole, before, told))
    return found


def half_widths(fitted: FitResult) -> Array:
    """Return half the width of each parameter's 95 % interval (k,), in the parameter's unit.

    The widths are the Huber-White estimate for clusters: errors within a block of the logs may be correlated, and
    errors of different blocks are independent. Errors that the model cannot explain, such as those of another friction
    law, differ between blocks and widen the interval as noise does.
    """
    weighted = fitted.slopes * fitted.weights[None, :, None]
    errors = fitted.errors * fitted.weights
    scale = np.array([each.scale for each in fitted.parameters])
    precision = np.diag((scale / np.array([each.prior_sigma for each in fitted.parameters])) ** 2)
    flat = weighted.reshape(-1, weighted.shape[-1])
    inverse = np.linalg.inv(flat.T @ flat + precision)
    span = fitted.times[-1] - fitted.times[0]
    blocks = max(_MIN_BLOCKS, round(span / _BLOCK))
    number = np.clip(((fitted.times - fitted.times[0]) / span * blocks).astype(int), 0, blocks - 1)
    scores = np.array([np.einsum("ijk,ij->k", weighted[number == k], errors[number == k]) for k in range(blocks)])
    # The prior counts as one additional block.
    spread = scores.T @ scores * blocks / (blocks - 1) + precision
    deviation = np.sqrt(np.diag(inverse @ spread @ inverse)) * scale
    found: Array = _student(blocks - 1) * deviation
    return found


def _student(freedom: int) -> float:
    """Return the 97.5 % quantile of Student's t distribution, for 5 degrees of freedom and more.

    Source: the first terms of the Cornish-Fisher expansion, Abramowitz and Stegun 26.7.5.
    """
    z = 1.959964
    terms = (z**3 + z) / 4, (5 * z**5 + 16 * z**3 + 3 * z) / 96, (3 * z**7 + 19 * z**5 + 17 * z**3 - 15 * z) / 384
    return z + float(sum(term / freedom ** (k + 1) for k, term in enumerate(terms)))


def _min_half_width(plant: ParametricArm, fitted: FitResult, parameter: FitParameter) -> float:
    size, k = parameter_value(fitted.values, parameter), 0 if parameter.joint is None else parameter.joint
    damped = float(plant.kv[k] + fitted.values.damping[k])
    match parameter.name:
        case "delay":
            return _DELAY
        case "friction":
            return _FRICTION * size
        case "damping":
            return _DAMPING * damped
        case "armature":
            # The instant within a timestep at which the real controller applies damping is unknown. An error of this
            # instant appears as inertia.
            law = _FRICTION_AS_INERTIA * float(fitted.values.friction[k]) / max(float(fitted.accelerations[k]), 1e-3)
            return _ARMATURE * size + damped * TIMESTEP / 4 + law
        case "offset":
            return _OFFSET
    return _GRAVITY


def require_determined(plant: ParametricArm, found: list[Estimate], name: str) -> None:
    """Refuse logs that do not determine a joint's friction or damping.

    Raises:
        DatasetError: a joint is badly excited; the message gives advice on the recording.
    """
    for number, joint in enumerate(plant.robot.joint_names):
        of_joint = {each.name: each for each in found if each.joint == joint}
        sizes = {
            "friction": max(of_joint[NAMES["friction"]].value, 0.01 * plant.max_torque[number]),
            "damping": plant.kv[number] + of_joint[NAMES["damping"]].value,
        }
        for key, share in _MAX_HALF_WIDTHS.items():
            each = of_joint[NAMES[key]]
            if (each.high - each.low) / 2 > share * sizes[key]:
                raise DatasetError(
                    f"{name}: {joint} moves too little to determine its {key} (from {each.low:.3g} to "
                    f"{each.high:.3g} {'N m' if key == 'friction' else 'N m s/rad'}); record it moving back and forth "
                    "at several speeds; `yamsim excite` writes such a motion"
                )


def describe_undetermined(found: list[Estimate], gripper: bool) -> list[str]:
    """Return one sentence for each quantity that these logs do not determine, or that no such log can determine.

    Args:
        gripper: whether the logs hold the gripper's opening, or the arm has no gripper.
    """
    lines = [
        f"{each.joint or 'the arm'}: {each.name} stays near the model's {each.model_value:.3g}: the log only limits it "
        f"to {each.low:.3g}..{each.high:.3g}"
        for each in found
        if not each.is_determined
    ]
    if not gripper:
        lines.append(
            "the gripper was not recorded and is assumed closed: if it was open, the inertia of its fingers adds to "
            "the last joint's armature"
        )
    return [
        *lines,
        "damping_nms adds to the model's kv, which is kept: the log determines only their sum",
        "kp is the model's: friction, damping and armature are in proportion to it",
        "delay_s is the delay of commands and sensors together",
        "a mass at the tip changes the gravity factors of the joints that carry it",
    ]
