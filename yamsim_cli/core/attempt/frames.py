"""An attempt's recorded frames: the low-dimensional data of its states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..config.recording import RecordConfig
from ..dataset.lowdim import SimulationData, frame_data
from ..geometry.se3 import Array, inverse
from ..sim.readings import readings
from ..types import Attempt, StepState
from .simulator import Simulator


def frames(simulator: Simulator, attempt: Attempt, states: Sequence[StepState]) -> list[dict[str, Any]]:
    """What is recorded of each state, see `dataset.lowdim`; nothing is rendered for it."""
    every = simulator.config.task.timing.ticks_per_frame
    return [_frame(simulator, attempt, state, k * every) for k, state in enumerate(states)]


def _joints(simulator: Simulator) -> dict[str, Array]:
    """Return thing -> positions of its joints, of things that have some."""
    return {item.name: simulator.replica.object_joints(item) for item in simulator.config.task.objects if item.links}


def _frame(simulator: Simulator, attempt: Attempt, state: StepState, tick: int) -> dict[str, Any]:
    config, scene, replica = simulator.config, simulator.varied(attempt), simulator.replica
    task, acting = config.task, state.actions
    replica.show(state.qpos)
    joints = replica.joints() if state.sensed is None else state.sensed
    bases = [arm.T_base_in_world for arm in scene.arms]
    return frame_data(
        joints=readings(scene, joints, attempt.job, tick),
        timestamp=state.time,
        intrinsics={name: replica.intrinsics(name, config.image.size_px).K for name in scene.cameras},
        extrinsics={name: replica.T_cam_in_base(name) for name in scene.cameras},
        object_poses={item.name: replica.T_object_in_base(item.name) for item in task.objects},
        object_joints=_joints(simulator),
        cloth_points=replica.cloth_points(),
        ee_pose=replica.T_grasp_in_base(),
        ctrl=acting.ctrl[0][scene.drives],
        action_joints=acting.joints[0],
        magnet=acting.magnet[0],
        language_task=task.language_task or task.name,
        language_prompt=attempt.phrasing or task.language_prompt,
        wrist_camera=config.wrist_arms[0].wrist_camera_name if len(config.wrist_arms) == 1 else None,
        T_right_base_in_left_base=inverse(bases[0]) @ bases[1] if len(bases) > 1 else None,
        full_openings=full_openings(config) if config.action == "joints" else None,
        simulation=SimulationData(state.qpos, acting.ctrl, acting.magnet),
    )


def full_openings(config: RecordConfig) -> list[float]:
    """How far one finger of each arm opens in use, m, in the order of recordings."""
    fingers = [config.rig.arms[k].robot.fingers for k in config.rig.recorded]
    return [each.full_opening for each in fingers if each is not None]
