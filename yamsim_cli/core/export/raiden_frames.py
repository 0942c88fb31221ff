"""Converts recorded frames into frames of raiden's layout: joints, hands and cameras, with the left arm first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..config.rig import ArmConfig, RigConfig
from ..dataset.lowdim import BETWEEN_BASES
from ..errors import ResourceError, UsageError
from ..geometry.se3 import Array
from ..planning.arm_kinematics import ArmKinematics
from ..resources import Locations
from ..scene.robot import bare_arm
from . import raiden_schema as schema
from .raiden_options import HandFrameName
from .source import Source

# Names of the arms' wrist cameras in raiden's layout, in the arms' order. A lone arm counts as the left one.
WRIST_CAMERAS = ("left_wrist_camera", "right_wrist_camera")


@dataclass(frozen=True)
class HandFrame:
    """The kinematics by which hands' poses are computed.

    Attributes:
        model: MJCF file in the robot model's folder; empty for the simulated one.
        description: a line for readers of the metadata.
    """

    model: str
    description: str


HAND_FRAMES: Mapping[HandFrameName, HandFrame] = {
    "yamsim": HandFrame("", "site grasp_site of the simulated arm: where the pictures show the hand"),
    "i2rt": HandFrame(
        "raiden_kinematics.xml",
        "site grasp_site of i2rt 7b6d501, yam with linear_4310: what raiden's kinematics make of the joints",
    ),
}


def hand_frame(name: HandFrameName) -> dict[str, str]:
    """The metadata's entry on the hand frame."""
    return {"name": name, "description": HAND_FRAMES[name].description}


def camera_names(source: Source) -> dict[str, str]:
    """Camera -> its name in raiden's layout."""
    wrists = wrist_arms(source)
    return {name: WRIST_CAMERAS[wrists[name]] if name in wrists else name for name in source.cameras}


def wrist_arms(source: Source) -> dict[str, int]:
    """Wrist camera -> the place of its arm in recordings."""
    config = source.config
    arms = [config.rig.arms[k] for k in config.rig.recorded]
    return {arm.wrist_camera_name: k for k, arm in enumerate(arms) if arm in config.wrist_arms}


class _Arm:
    """Converts an arm's recorded joints (7,), six in rad and one finger's opening in m, to the real stack's values.

    Raises:
        UsageError: the layout has no place for such an arm, or the frame none for its hand.
    """

    def __init__(self, arm: ArmConfig, locations: Locations, frame: HandFrame) -> None:
        robot = arm.robot
        if robot.dof != schema.JOINTS or robot.fingers is None:
            hand = "a gripper" if robot.fingers else "no gripper"
            raise UsageError(
                f"raiden's layout is of arms with {schema.JOINTS} joints and a gripper, and {arm.name} ({robot.model}) "
                f"has {robot.dof} and {hand}: export it as lerobot or rerun"
            )
        if frame.model:
            try:
                file = locations.file(f"robot_models/{robot.model}/{frame.model}")
            except ResourceError:
                raise UsageError(
                    f"--hand-frame: {robot.model} has no {frame.model} in its folder of robot_models/, where that hand "
                    "would be: take --hand-frame yamsim"
                ) from None
            self._kinematics = ArmKinematics(mujoco.MjModel.from_xml_path(str(file)))
        else:
            self._kinematics = ArmKinematics(bare_arm(arm))
        self._opening = robot.fingers.range[1]

    def shared(self, joints: ArrayLike) -> Array:
        """Six joints, and the gripper as a share of its opening, (7,)."""
        values = np.array(joints, dtype=np.float64)
        values[schema.JOINTS] = np.clip(values[schema.JOINTS] / self._opening, 0.0, 1.0)
        return values

    def hand(self, shared: Array) -> Array:
        """The hand's position, its rotation row by row and the gripper (13,), in this arm's base."""
        T = self.T_hand_in_base(shared)
        return np.concatenate([T[:3, 3], T[:3, :3].ravel(), shared[schema.JOINTS :]])

    def T_hand_in_base(self, joints: ArrayLike) -> Array:
        """The hand's pose (4, 4) in this arm's base, by the chosen kinematics."""
        return self._kinematics.T_grasp_in_base(np.asarray(joints)[: schema.JOINTS])


class FrameConverter:
    """Converts frames of one dataset to raiden's layout.

    Attributes:
        names: camera -> its name in raiden's layout.
        arms: how many arms the arrays hold.

    Args:
        rig: whose arms were recorded.

    Raises:
        UsageError: two arms cannot be written as one, or the layout has no place for an arm.
    """

    def __init__(
        self,
        rig: RigConfig,
        names: Mapping[str, str],
        locations: Locations,
        hand_frame: HandFrameName,
        *,
        single: bool = False,
    ) -> None:
        arms = [rig.arms[k] for k in rig.recorded]
        if single and len(arms) > 1:
            raise UsageError(f"--single is for recordings of one arm, and this dataset has {len(arms)}: leave it out")
        self.names = names
        self.arms = 1 if single else 2
        frame = HAND_FRAMES[hand_frame]
        # A lone arm's model stands for the other arm, too.
        self._arms = [_Arm(arm, locations, frame) for arm in (arms[0], arms[-1])[: self.arms]]

    def frame(self, frame: Mapping[str, Any]) -> dict[str, Any]:
        """A recorded frame of a simulation in the form of `raiden_schema.lowdim`."""
        data = self.converted(frame, self._shared(frame["joints"]), self._shared(frame["action_joints"]))
        if BETWEEN_BASES in frame:
            data[schema.BETWEEN_ARMS] = np.asarray(frame[BETWEEN_BASES], dtype=np.float32)
        return data

    def converted(self, frame: Mapping[str, Any], joints: Sequence[Array], command: Sequence[Array]) -> dict[str, Any]:
        """A frame in that form, except where the right base stands.

        Args:
            frame: its words, and the matrices of those cameras that have any.
            joints, command: each arm's, six in rad and the gripper's share (7,).
        """
        return {
            **{
                key: {name: frame[key][camera] for camera, name in self.names.items() if camera in frame[key]}
                for key in ("intrinsics", "extrinsics")
            },
            "joints": _f32(joints),
            "action": _f32(self._hands(command)),
            "actual_poses": _f32(self._hands(joints)),
            "action_joints": _f32(command),
            "language_task": _text(frame["language_task"]),
            "language_prompt": _text(frame["language_prompt"]),
        }

    def T_hand_in_base(self, arm: int, joints: ArrayLike) -> Array:
        """The pose (4, 4) of an arm's hand in its own base, from all joints of a converted frame."""
        return self._arms[arm].T_hand_in_base(np.asarray(joints)[schema.ARM * arm :])

    def _shared(self, joints: ArrayLike) -> list[Array]:
        """Each arm's converted joints (7,), from recorded ones (7,) or (14,)."""
        rows = np.zeros((self.arms, schema.ARM))
        recorded = np.reshape(joints, (-1, schema.ARM))
        rows[: len(recorded)] = recorded
        return [arm.shared(row) for arm, row in zip(self._arms, rows, strict=True)]

    def _hands(self, shared: Sequence[Array]) -> list[Array]:
        return [arm.hand(row) for arm, row in zip(self._arms, shared, strict=True)]


def _f32(arms: Sequence[ArrayLike]) -> NDArray[np.float32]:
    return np.concatenate(arms).astype(np.float32)


def _text(text: str) -> NDArray[np.object_]:
    """Text as raiden's converter writes it. Source: TRI-ML/raiden, `converter.py`: an array of no dimensions."""
    return np.array(text, dtype=object)
