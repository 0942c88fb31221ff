"""What the writers of calibration files of other programs share."""

from __future__ import annotations

from dataclasses import dataclass

from ...core.errors import UsageError, suggest_similar
from ...core.geometry.se3 import Array
from ..calibration_file import CalibratedArm, Calibration
from ..uncertainty import is_base_measured


@dataclass(frozen=True)
class FormatFiles:
    """Files of one format.

    Attributes:
        files: relative name -> text; empty if the calibration does not fit the format.
        left_out: one line for each thing that the files do not contain, with the reason.
    """

    files: dict[str, str]
    left_out: tuple[str, ...] = ()


def second_arm(calibration: Calibration) -> CalibratedArm | None:
    """Return the right arm; None if there is a single arm."""
    return next((arm for arm in calibration.arms if arm.name != calibration.reference), None)


def measured_right_base(calibration: Calibration) -> tuple[Array | None, str]:
    """Return the pose (4, 4) of the right arm's base in the left one's, m, or None and the reason."""
    arm = second_arm(calibration)
    if arm is None:
        return None, "the calibration has a single arm"
    if not is_base_measured(arm.position_95_mm, arm.rotation_95_deg):
        return None, (
            f"the base of {arm.name} is not measured (95 % interval {max(arm.position_95_mm):.1f} mm, "
            f"{max(arm.rotation_95_deg):.2f} degrees): calibrate with a camera that sees both arms"
        )
    return arm.T_base_in_reference, ""


def require_known_arm(name: str, known: list[str], source: str) -> None:
    """Raise UsageError if an arm's name of the calibration is unknown to `source`."""
    if name not in known:
        raise UsageError(f"the calibration's arm {name!r} is not in {source}; {suggest_similar(name, known)}")
