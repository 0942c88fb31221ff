"""Estimates of parameters with 95 % intervals, and parameters that the logs do not determine."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.statistics import Z95, student_t_quantile_95

from .parameter_fit import FitParameter, FitResult, parameter_value
from .plant_model import TIMESTEP, ParametricArm

# `PlantParameters` field -> name in results, with unit.
ESTIMATE_NAMES = {
    "delay": "delay_s",
    "friction": "friction_nm",
    "damping": "damping_nms",
    "armature": "armature",
    "offset": "offset_rad",
    "gravity": "gravity_factor",
}
# Added half widths of intervals, because real physics differs from the model.
_MODEL_ERROR_DELAY = 0.0006  # s, a controller's timestep
# Shares of the value, because real friction may obey another law.
_ADDED_FRICTION_SHARE = 0.03
_ADDED_DAMPING_SHARE = 0.02
_ADDED_ARMATURE_SHARE = 0.05
_MODEL_ERROR_INERTIA = 0.05  # share of the friction torque that appears as inertia under another friction law
_MODEL_ERROR_OFFSET = 0.0004  # rad, an encoder's resolution
_MODEL_ERROR_GRAVITY = 0.003
_DETERMINED_SHARE = 0.7  # share of the prior's interval; a determined parameter's interval is narrower
# Shares of the value; wider intervals refuse an identification.
_MAX_INTERVAL_HALF_WIDTHS = {"friction": 0.5, "damping": 0.6}

# s, block of the logs with correlated errors: friction holds a joint beside its target until it reverses.
_BLOCK_SECONDS = 2.5
_MIN_BLOCKS = 6


@dataclass(frozen=True)
class Estimate:
    """A parameter's value, in the unit of its name, and 95 % interval.

    Attributes:
        joint: empty for the whole arm.
        name: with unit, such as `friction_nm`; a value of `ESTIMATE_NAMES`.
        model_value: before the identification.
        is_determined: by the logs.
    """

    joint: str
    name: str
    value: float
    low: float
    high: float
    model_value: float
    is_determined: bool

    def to_json_data(self) -> dict[str, Any]:
        """Return JSON data."""
        return {
            "value": self.value,
            "low": self.low,
            "high": self.high,
            "model": self.model_value,
            "determined": self.is_determined,
        }


def estimate_parameters(plant: ParametricArm, fitted: FitResult) -> list[Estimate]:
    """Return estimates of the fitted parameters in `ESTIMATE_NAMES`, the delay first, then by joint."""
    found = []
    for parameter, half in zip(fitted.parameters, interval_half_widths(fitted), strict=True):
        if parameter.name not in ESTIMATE_NAMES:
            continue
        number = parameter_value(fitted.values, parameter)
        whole = float(half) + _min_half_width(plant, fitted, parameter)
        low = max(number - whole, 0.0) if parameter.name in ("delay", "friction", "armature") else number - whole
        joint = "" if parameter.joint is None else plant.robot.joint_names[parameter.joint]
        before = parameter_value(plant.model_values, parameter)
        determined = bool(half < _DETERMINED_SHARE * Z95 * parameter.prior_sigma)
        found.append(Estimate(joint, ESTIMATE_NAMES[parameter.name], number, low, number + whole, before, determined))
    return found


def interval_half_widths(fitted: FitResult) -> Array:
    """Return half widths of 95 % intervals (k,), in parameter units.

    Huber-White estimate for clusters: errors may be correlated within a block of the logs, not between blocks. Errors
    that the model cannot explain differ between blocks and widen the interval as noise does.
    """
    weighted = fitted.error_jacobian * fitted.weights[None, :, None]
    errors = fitted.errors * fitted.weights
    scale = np.array([each.scale for each in fitted.parameters])
    precision = np.diag((scale / np.array([each.prior_sigma for each in fitted.parameters])) ** 2)
    flat = weighted.reshape(-1, weighted.shape[-1])
    inverse = np.linalg.inv(flat.T @ flat + precision)
    span = fitted.times[-1] - fitted.times[0]
    blocks = max(_MIN_BLOCKS, round(span / _BLOCK_SECONDS))
    number = np.clip(((fitted.times - fitted.times[0]) / span * blocks).astype(int), 0, blocks - 1)
    scores = np.array([np.einsum("ijk,ij->k", weighted[number == k], errors[number == k]) for k in range(blocks)])
    # The prior counts as one block.
    spread = scores.T @ scores * blocks / (blocks - 1) + precision
    deviation = np.sqrt(np.diag(inverse @ spread @ inverse)) * scale
    found: Array = student_t_quantile_95(blocks - 1) * deviation
    return found


def _min_half_width(plant: ParametricArm, fitted: FitResult, parameter: FitParameter) -> float:
    size, k = parameter_value(fitted.values, parameter), 0 if parameter.joint is None else parameter.joint
    damped = float(plant.kv[k] + fitted.values.damping[k])
    match parameter.name:
        case "delay":
            return _MODEL_ERROR_DELAY
        case "friction":
            return _ADDED_FRICTION_SHARE * size
        case "damping":
            return _ADDED_DAMPING_SHARE * damped
        case "armature":
            # When in a timestep the real controller applies damping is unknown; an error appears as inertia.
            law = _MODEL_ERROR_INERTIA * float(fitted.values.friction[k]) / max(float(fitted.accelerations[k]), 1e-3)
            return _ADDED_ARMATURE_SHARE * size + damped * TIMESTEP / 4 + law
        case "offset":
            return _MODEL_ERROR_OFFSET
    return _MODEL_ERROR_GRAVITY


def require_determined(plant: ParametricArm, found: list[Estimate], name: str) -> None:
    """Refuse logs that do not determine a joint's friction or damping.

    Raises:
        DatasetError: a joint is badly excited; the message gives advice.
    """
    for number, joint in enumerate(plant.robot.joint_names):
        of_joint = {each.name: each for each in found if each.joint == joint}
        sizes = {
            "friction": max(of_joint[ESTIMATE_NAMES["friction"]].value, 0.01 * plant.max_torque[number]),
            "damping": plant.kv[number] + of_joint[ESTIMATE_NAMES["damping"]].value,
        }
        for key, share in _MAX_INTERVAL_HALF_WIDTHS.items():
            each = of_joint[ESTIMATE_NAMES[key]]
            if (each.high - each.low) / 2 > share * sizes[key]:
                raise DatasetError(
                    f"{name}: {joint} moves too little to determine its {key} (from {each.low:.3g} to "
                    f"{each.high:.3g} {'N m' if key == 'friction' else 'N m s/rad'}); record it moving back and forth "
                    "at several speeds; `yamsim excite` writes such a motion"
                )


def describe_undetermined(found: list[Estimate], gripper: bool) -> list[str]:
    """Return a sentence per quantity that these logs, or any such logs, do not determine.

    `gripper`: the logs hold its opening, or the arm has none.
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
