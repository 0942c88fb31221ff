"""Plans the paths of all arms of a scene: that of the acting arm does the task, and the others rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..config.recording import RecordConfig
from ..geometry.se3 import Array
from ..scene.compiled import CompiledScene
from ..scene.robot import arm_spec, bare_arm
from ..types import JointPath, Layout, Stand
from .choice import PathChooser
from .dynamics import ArmDynamics
from .ik import IkSolver
from .path import stand_still


@dataclass(frozen=True)
class Demonstration:
    """The paths of an attempt.

    Attributes:
        paths: the path of each of the scene's arms.
        position_error, tilt: the largest of the acting arms' paths, m and rad, see `JointPath`.
    """

    paths: tuple[JointPath, ...]
    position_error: float
    tilt: float


class Planner(Protocol):
    """Plans attempts of one task in one scene."""

    def plan(self, layout: Layout) -> Demonstration:
        """The paths for a layout; the caller decides whether their errors are small enough."""


@dataclass(frozen=True)
class ArmTools:
    """An arm's inverse kinematics and dynamics, which planning needs."""

    ik: IkSolver
    dynamics: ArmDynamics


def arm_tools(config: RecordConfig, scene: CompiledScene) -> tuple[ArmTools, ...]:
    """The tools of each of the scene's arms."""

    def tools(number: int, T_base_in_world: Array) -> ArmTools:
        arm = config.rig.arms[number]
        ik = IkSolver(bare_arm(arm), T_base_in_world)
        return ArmTools(ik, ArmDynamics(arm_spec(arm, None).compile(), arm.robot))

    return tuple(tools(arm.number, arm.T_base_in_world) for arm in scene.arms)


def start_stands(config: RecordConfig) -> tuple[Stand, ...]:
    """Where the scene's arms stand at the start: those that act over the table, another out of the way at home, its
    hand high and its fingers closed.
    """
    robots = [config.rig.arms[number].robot for number in config.rig.recorded]
    return tuple(
        Stand(np.array(config.start_joints), robot.fingers.opened if robot.fingers else 0.0)
        if k in config.acting_scene_arms
        else Stand(np.array(robot.home), 0.0)
        for k, robot in enumerate(robots)
    )


class OneArmPlanner:
    """Plans tasks that one arm does."""

    def __init__(self, config: RecordConfig, scene: CompiledScene, tools: Sequence[ArmTools]) -> None:
        self._acting = config.acting_scene_arms[0]
        self._stands = start_stands(config)
        self._tools = tools
        using = tools[self._acting]
        self._chooser = PathChooser(
            using.ik, using.dynamics, scene, config.pair, config.grasp, self._acting, self._stands
        )

    def plan(self, layout: Layout) -> Demonstration:
        """The acting arm's path by `PathChooser`, and the others' at rest."""
        _, chosen = self._chooser.choose(layout)
        paths = tuple(
            chosen if k == self._acting else stand_still(tools.dynamics, stand, len(chosen.gripper), chosen.tick)
            for k, (tools, stand) in enumerate(zip(self._tools, self._stands, strict=True))
        )
        return Demonstration(paths, chosen.position_error, chosen.tilt)
