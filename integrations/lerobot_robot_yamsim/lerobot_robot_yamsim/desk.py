"""Where a robot and its expert meet: LeRobot makes each of them by itself, in one process."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass
class Desk:
    """What they leave for each other.

    Attributes:
        keys: names of the robot's joints and grippers, with `.pos`.
        expert: whether an expert is connected, so that episodes have to be such that it can do them.
        action: what the expert does now, key -> rad, or a share; None where no robot is connected.
    """

    keys: tuple[str, ...] = ()
    expert: bool = False
    action: Mapping[str, float] | None = None


_DESKS: dict[str | None, Desk] = {}


def desk_of(robot: str | None) -> Desk:
    """The desk of the robot with an id."""
    return _DESKS.setdefault(robot, Desk())
