"""Where the arms that do a task start: as their models say, or as the task does."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..documents.base import ConflictError
from ..robots.stops import beyond_stops
from .rig import ArmConfig, RigConfig


def common_start(task: str, arms: Sequence[ArmConfig]) -> tuple[float, ...]:
    """The joints in which all arms of a task start by their models, rad.

    Args:
        task: its name, for the message.

    Raises:
        ConflictError: they would start differently; its paths are where, from a recording's config.
    """
    robots = [arm.robot for arm in arms]
    starts = {robot.start for robot in robots}
    if len(starts) > 1:
        raise ConflictError(
            f"task {task!r} has no start_joints, and its arms {', '.join(r.model for r in robots)} "
            "would start differently; give start_joints that suit both",
            ("task", "start_joints"),
            ("task",),
            ("rig",),
        )
    return starts.pop()


def check_start(
    task: str, rig: RigConfig, arms: Sequence[ArmConfig], given: Sequence[float], *, recorded: bool
) -> None:
    """Make sure that arms can start in the joints that a task gives them, rad.

    Args:
        task: its name, for the message.
        recorded: whether a dataset says so: then what lies beyond a stop was there.

    Raises:
        ConflictError: an arm has other joints, or they lie beyond its stops; its paths are as `common_start`'s.
    """
    for arm in arms:
        robot = arm.robot
        if len(given) != robot.dof:
            raise ConflictError(
                f"task {task!r} has {len(given)} start_joints, and {arm.name} of rig {rig.name!r} "
                f"({robot.model}) has {robot.dof} joints; give one for each of {', '.join(robot.joint_names)}, or "
                "leave start_joints out",
                ("task", "start_joints"),
                ("task",),
                ("rig",),
            )
        fault = beyond_stops(arm.name, robot, np.array(given), 0.0)
        if fault and not recorded:
            raise ConflictError(f"task {task!r}: start_joints: {fault}", ("task", "start_joints"), ("task",), ("rig",))
