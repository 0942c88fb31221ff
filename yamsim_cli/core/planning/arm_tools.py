"""What planning needs of a scene's arms: inverse kinematics, dynamics, and where they stand at the start."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..config.recording import RecordConfig
from ..geometry.se3 import Array
from ..scene.compiled import CompiledScene
from ..scene.robot import arm_spec, bare_arm
from ..types import Stand
from .dynamics import ArmDynamics
from .ik import IkSolver


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
