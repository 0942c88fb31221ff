"""Inverse kinematics, dynamics and start positions of a scene's arms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...config.recording import RecordConfig
from ...config.rig import RigConfig
from ...scene.robot import arm_spec, bare_arm
from ...types import Stand
from .dynamics import ArmDynamics
from .ik import IkSolver


@dataclass(frozen=True)
class ArmTools:
    """Inverse kinematics and dynamics of one arm."""

    ik: IkSolver
    dynamics: ArmDynamics


def arm_tools(rig: RigConfig) -> tuple[ArmTools, ...]:
    """The tools of each arm in a rig's scene; making them reads files."""

    def tools(number: int) -> ArmTools:
        arm = rig.arms[number]
        ik = IkSolver(bare_arm(arm), rig.T_base_in_world(number))
        return ArmTools(ik, ArmDynamics(arm_spec(arm, None).compile(), arm.robot))

    return tuple(tools(number) for number in rig.recorded)


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
