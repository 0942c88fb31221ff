"""Whose column is whose in a table of a motion: `command_joint1`, `position_gripper`, `position_left_joint3`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..config.rig import RigConfig
from ..errors import DatasetError
from ..geometry.se3 import Array
from ..motion import ArmMotion

TIME = "t"
_COMMAND, _POSITION, _VELOCITY = "command", "position", "velocity"
_GRIPPER = "gripper"


def sides(rig: RigConfig) -> tuple[str, ...]:
    """What a rig's arms are called in columns, the left one first; a lone arm has no name."""
    return tuple(rig.arms[k].side for k in rig.recorded) if len(rig.arms) > 1 else ("",)


def column(kind: str, side: str, joint: str) -> str:
    """A column's name."""
    return "_".join(part for part in (kind, side, joint) if part)


def header(rig: RigConfig) -> list[str]:
    """The columns of a motion's table, in the order in which they are written."""
    arms = [rig.arms[k].robot for k in rig.recorded]
    named = list(zip(sides(rig), arms, strict=True))
    return [
        TIME,
        *(
            column(kind, side, joint)
            for kind in (_COMMAND, _POSITION)
            for side, robot in named
            for joint in (*robot.joint_names, *([_GRIPPER] if robot.fingers else []))
        ),
    ]


def arm_motions(columns: Mapping[str, Array], rig: RigConfig, source: str) -> tuple[ArmMotion, ...]:
    """The arms' motions in a table's columns, the left arm's first.

    Args:
        columns: name -> values (n,); those of nobody are left alone.
        source: the table's name, for messages.

    Raises:
        DatasetError: a joint has no position, or some joints have a command and others none.
    """
    columns = {_usual(name, sides(rig)): values for name, values in columns.items()}
    motions = []
    for side, k in zip(sides(rig), rig.recorded, strict=True):
        joints = rig.arms[k].robot.joint_names
        measured = _together(columns, _POSITION, side, joints, source)
        if measured is None:
            raise DatasetError(
                f"{source}: has no column {column(_POSITION, side, joints[0])!r}; its columns are "
                f"{', '.join(columns)}; rig {rig.name!r} needs {', '.join(header(rig))}"
            )
        motions.append(
            ArmMotion(
                side,
                measured,
                _together(columns, _COMMAND, side, joints, source),
                columns.get(column(_POSITION, side, _GRIPPER)),
                columns.get(column(_COMMAND, side, _GRIPPER)),
                _together(columns, _VELOCITY, side, joints, source),
            )
        )
    return tuple(motions)


def _usual(name: str, arms: Sequence[str]) -> str:
    """`left_command_joint1` as `command_left_joint1`, which it means."""
    side, _, rest = name.partition("_")
    kind, _, joint = rest.partition("_")
    return column(kind, side, joint) if side in arms and kind in (_COMMAND, _POSITION, _VELOCITY) else name


def _together(columns: Mapping[str, Array], kind: str, side: str, joints: Sequence[str], source: str) -> Array | None:
    """The joints' columns side by side (n, dof); None if there is none of them."""
    names = [column(kind, side, joint) for joint in joints]
    lacking = [name for name in names if name not in columns]
    if len(lacking) == len(names):
        return None
    if lacking:
        raise DatasetError(f"{source}: has no column {lacking[0]!r}, but others such as it; give all of {names}")
    return np.column_stack([columns[name] for name in names])
