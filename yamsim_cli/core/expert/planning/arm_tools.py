"""Inverse kinematics, dynamics and start positions of a scene's arms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...config.recording import RecordConfig
from ...geometry.se3 import Array
from ...scene.compiled import CompiledScene
from ...scene.robot import arm_spec, bare_arm
from ...types import Stand
from .dynamics import ArmDynamics
from .ik import IkSolver


@dataclass(frozen=True)
class ArmTools:
    """Inverse kinematics and dynamics of one arm."""

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
    """Joints and openings of the scene's arms at the start: acting arms over the table, another arm at home, out of the
    way with closed fingers.
    """
    robots = [config.rig.arms[number].robot for number in config.rig.recorded]
    return tuple(
        Stand(np.array(config.start_joints), robot.fingers.opened if robot.fingers else 0.0)
        if k in config.acting_scene_arms
        else Stand(np.array(robot.home), 0.0)
        for k, robot in enumerate(robots)
    )
