"""Whether the hands that do a task can take hold of what it moves, and hold it by friction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from ..documents.base import ConflictError
from .rig import ArmConfig, RigConfig
from .things.thing import ObjectConfig

# Rigs whose grippers have pads, to name where a rig's have none: of one arm, and of two.
_WITH_PADS = ("single_linear", "yam_station_linear_4310_d405")


def check_fingers(
    rig: RigConfig, arms: Sequence[ArmConfig], items: Mapping[tuple[str | int, ...], ObjectConfig]
) -> None:
    """Make sure that the arms that do a task have fingers, and that what they pick up fits between them.

    Args:
        items: what is picked up, by where a recording's config has it.

    Raises:
        ConflictError: they cannot take hold of it; its paths are where, from a recording's config.
    """
    for arm in arms:
        fingers = arm.gripper.fingers
        if fingers is None:
            raise ConflictError(
                f"{arm.name} of rig {rig.name!r} has the gripper {arm.gripper.name}, which has no fingers to "
                "pick anything up with; use another gripper, or another arm",
                ("rig",),
                ("arm",),
            )
        for path, item in items.items():
            if item.grasp is None:
                raise ConflictError(
                    f"object {item.name!r} has no `grasp`, so it cannot be picked up by a weld",
                    path,
                    ("grasp",),
                    ("task",),
                )
            if item.grasp.opening > fingers.full_opening:
                raise ConflictError(
                    f"object {item.name!r} is too wide to be picked up: {2000 * item.grasp.opening:.0f} mm, and "
                    f"gripper {arm.gripper.name} of rig {rig.name!r} opens {2000 * fingers.full_opening:.0f} mm; "
                    "it can still be a target or a distractor",
                    path,
                    ("rig",),
                    ("task",),
                )


def check_friction(kind: str, rig: RigConfig, arms: Sequence[ArmConfig]) -> None:
    """Make sure that the arms that do a task have pads.

    Args:
        kind: the grasp that was asked for, for messages.

    Raises:
        ConflictError: they have none; its paths are where, from a recording's config.
    """
    for arm in arms:
        if arm.gripper.fingers is None or not arm.gripper.fingers.pads:
            raise ConflictError(
                f"grasp {kind!r} needs a gripper with pads, and {arm.name} of rig {rig.name!r} has "
                f"{arm.gripper.name}; use --rig {_WITH_PADS[len(rig.arms) > 1]}, or grasp: weld",
                ("grasp",),
                ("rig",),
            )
