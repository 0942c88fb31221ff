"""Paths for all arms of a scene that do its task: the acting arm's as chosen, the others at rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..config.recording import RecordConfig
from ..geometry.se3 import Array
from ..resources import Locations
from ..scene.compiled import CompiledScene
from ..scene.robot import HOME, arm_spec, bare_arm
from ..tasks.pickplace import OPEN
from ..types import JointPath, Layout
from .choice import PathChooser
from .dynamics import ArmDynamics
from .ik import IkSolver
from .path import stand_still


@dataclass(frozen=True)
class Demonstration:
    """What the arms are to do.

    Attributes:
        paths: of each of the scene's arms.
        position_error, tilt: the worst of the acting arms' paths, m and rad, see `JointPath`.
    """

    paths: tuple[JointPath, ...]
    position_error: float
    tilt: float


class Planner(Protocol):
    """Plans attempts of one task in one scene."""

    def plan(self, layout: Layout) -> Demonstration:
        """The paths for a layout; whether their errors are small enough is for the caller to say."""


@dataclass(frozen=True)
class ArmTools:
    """What planning needs of one arm: its inverse kinematics and its dynamics."""

    ik: IkSolver
    dynamics: ArmDynamics


def arm_tools(config: RecordConfig, scene: CompiledScene, locations: Locations) -> tuple[ArmTools, ...]:
    """The tools of each of the scene's arms."""

    def tools(number: int, T_base_in_world: Array) -> ArmTools:
        arm = config.rig.arms[number]
        ik = IkSolver(bare_arm(arm, locations), T_base_in_world)
        return ArmTools(ik, ArmDynamics(arm_spec(arm, locations, None).compile()))

    return tuple(tools(arm.number, arm.T_base_in_world) for arm in scene.arms)


def start_stand(config: RecordConfig) -> Array:
    """Where the scene's arms stand at the start (arms, 7): those that act over the table, another out of the way at
    home, its hand high and its fingers closed.
    """
    return np.array(
        [
            (*config.task.start_joints, OPEN) if k in config.acting_scene_arms else (*HOME, 0.0)
            for k in range(len(config.rig.arms))
        ]
    )


class OneArmPlanner:
    """One arm picks and places."""

    def __init__(self, config: RecordConfig, scene: CompiledScene, tools: Sequence[ArmTools]) -> None:
        self._acting = config.acting_scene_arms[0]
        self._stand = start_stand(config)
        self._tools = tools
        using = tools[self._acting]
        self._chooser = PathChooser(
            using.ik, using.dynamics, scene, config.task, config.grasp, self._acting, self._stand
        )

    def plan(self, layout: Layout) -> Demonstration:
        """The chosen path, see `PathChooser`."""
        _, chosen = self._chooser.choose(layout)
        paths = tuple(
            chosen
            if k == self._acting
            else stand_still(tools.dynamics, stand[:6], float(stand[6]), len(chosen.gripper), chosen.tick)
            for k, (tools, stand) in enumerate(zip(self._tools, self._stand, strict=True))
        )
        return Demonstration(paths, chosen.position_error, chosen.tilt)
