from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...attempt_data import ArmPosture
from ...config.recording import RecordConfig
from ...config.rig import RigConfig
from ...scene.arm_model import arm_spec, kinematic_model
from .dynamics import ArmDynamics
from .ik import IkSolver


@dataclass(frozen=True)
class ArmIkAndDynamics:
    """The solvers of one arm."""

    ik: IkSolver
    dynamics: ArmDynamics


def make_arm_ik_and_dynamics(rig: RigConfig) -> tuple[ArmIkAndDynamics, ...]:
    """Return the solvers of each arm in a rig's scene."""

    def solvers_of_arm(number: int) -> ArmIkAndDynamics:
        arm = rig.arms[number]
        ik = IkSolver(kinematic_model(arm), rig.T_base_in_world(number))
        return ArmIkAndDynamics(ik, ArmDynamics(arm_spec(arm, None).compile(), arm.robot))

    return tuple(solvers_of_arm(number) for number in rig.recording_order)


def start_postures(config: RecordConfig) -> tuple[ArmPosture, ...]:
    """Return each arm's start posture: over the table if it acts, else its home posture with closed fingers."""
    robots = [config.rig.arms[number].robot for number in config.rig.recording_order]
    return tuple(
        ArmPosture(np.array(config.start_joints), robot.fingers.initial_opening if robot.fingers else 0.0)
        if k in config.acting_scene_arms
        else ArmPosture(np.array(robot.home), 0.0)
        for k, robot in enumerate(robots)
    )
