"""Frames and calibration file of raiden's layout: joints, hands and cameras, with the left arm first.

raiden reads the `hand_eye_calibration` of wrist cameras and the `extrinsics` of other cameras. The lab's fork reads the
`extrinsics` of all cameras, so a wrist camera has both. Neither program reads `type`.

Source: TRI-ML/raiden 2353b10, `converter.py` and `server.py`; cameronosmith/raiden_fork 434d7c6, `wrist_calibrate.py`,
`exo_calibrate.py`, `wrist_verify_rerun.py`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..core.config.rig import ArmConfig, RigConfig
from ..core.dataset.lowdim import RIGHT_IN_LEFT_BASE_KEY
from ..core.errors import ResourceError, UsageError
from ..core.expert.planning.arm_kinematics import ArmKinematics
from ..core.files.resources import Locations
from ..core.geometry.se3 import Array, invert_pose, pose, rotation_vector
from ..core.scene.arm_model import kinematic_model
from . import raiden_schema as schema
from .export_source import Frames, SimulatedSource
from .raiden_schema import HandFrameName, RaidenOptions

_ARM_SIDES = ("left", "right")  # in the order of raiden's arrays
# In the order of `_ARM_SIDES`; a single arm is the left one.
WRIST_CAMERAS = ("left_wrist_camera", "right_wrist_camera")

_KINEMATICS_FILES = {"i2rt": "raiden_kinematics.xml"}  # hand frame -> MJCF file with its kinematics
_HAND_FRAME_DESCRIPTIONS = {
    "yamsim": "site grasp_site of the simulated arm: where the pictures show the hand",
    "i2rt": "site grasp_site of i2rt 7b6d501, yam with linear_4310: what raiden's kinematics make of the joints",
}

_ZERO_TIME = "1970-01-01T00:00:00.000000"
# The real right wrist camera is mounted upside down. raiden's code turns its images and its hand-eye pose by 180
# degrees, so the file must hold the pose before that turn. Source: TRI-ML/raiden, `converter.py`, `server.py`.
_UPSIDE_DOWN_CAMERA = WRIST_CAMERAS[1]
_HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])


def hand_frame(name: HandFrameName) -> dict[str, str]:
    """Return the entry of metadata.json on a hand frame."""
    return {"name": name, "description": _HAND_FRAME_DESCRIPTIONS[name]}


def camera_names(source: SimulatedSource) -> dict[str, str]:
    """Map each camera to its name in raiden's layout. Only wrist cameras get new names."""
    wrists = _wrist_arms(source)
    return {name: WRIST_CAMERAS[wrists[name]] if name in wrists else name for name in source.camera_sizes}


def _wrist_arms(source: SimulatedSource) -> dict[str, int]:
    config = source.config
    arms = [config.rig.arms[k] for k in config.rig.recording_order]
    return {arm.wrist_camera_name: k for k, arm in enumerate(arms) if arm in config.wrist_arms}


class _ArmConverter:
    """Converts recorded joints (7,) of an arm, six in rad and one finger opening in m, to values of raiden's layout."""

    def __init__(self, arm: ArmConfig, locations: Locations, frame: HandFrameName) -> None:
        robot = arm.robot
        if robot.dof != schema.JOINTS or robot.fingers is None:
            hand = "a gripper" if robot.fingers else "no gripper"
            raise UsageError(
                f"raiden's layout is for arms with {schema.JOINTS} joints and a gripper, but {arm.name} "
                f"({robot.model}) "
                f"has {robot.dof} and {hand}: export it as lerobot or rerun"
            )
        if frame in _KINEMATICS_FILES:
            try:
                file = locations.find_data_file(f"robot_models/{robot.model}/{_KINEMATICS_FILES[frame]}")
            except ResourceError:
                raise UsageError(
                    f"--hand-frame: {robot.model} has no {_KINEMATICS_FILES[frame]} in its folder of robot_models/, "
                    "which this frame needs: give --hand-frame yamsim"
                ) from None
            self._kinematics = ArmKinematics(mujoco.MjModel.from_xml_path(str(file)))
        else:
            self._kinematics = ArmKinematics(kinematic_model(arm))
        self._opening = robot.fingers.range[1]

    def joints_with_gripper_share(self, joints: ArrayLike) -> Array:
        """Return six joints in rad, and the gripper as a share of its opening, clipped to 0..1, (7,)."""
        values = np.array(joints, dtype=np.float64)
        values[schema.JOINTS] = np.clip(values[schema.JOINTS] / self._opening, 0.0, 1.0)
        return values

    def hand_values(self, joints: Array) -> Array:
        """Return hand position, row-major rotation matrix and gripper share (13,), in this arm's base."""
        T = self.T_hand_in_base(joints)
        return np.concatenate([T[:3, 3], T[:3, :3].ravel(), joints[schema.JOINTS :]])

    def T_hand_in_base(self, joints: ArrayLike) -> Array:
        return self._kinematics.T_grasp_in_base(np.asarray(joints)[: schema.JOINTS])


class FrameConverter:
    """Converts frames of one dataset to raiden's layout. With `single`, arrays hold one arm instead of two."""

    def __init__(
        self,
        rig: RigConfig,
        names: Mapping[str, str],
        locations: Locations,
        hand_frame: HandFrameName,
        *,
        single: bool,
    ) -> None:
        arms = [rig.arms[k] for k in rig.recording_order]
        if single and len(arms) > 1:
            raise UsageError(f"--single is for recordings of one arm, and this dataset has {len(arms)}: leave it out")
        self.names = names
        # The model of a single arm stands for the other arm, which was not recorded.
        pair = (arms[0], arms[-1])[: 1 if single else 2]
        self._arms = [_ArmConverter(arm, locations, hand_frame) for arm in pair]

    def convert_simulated_step(self, frame: Mapping[str, Any]) -> dict[str, Any]:
        """Convert a simulated frame to raiden's layout."""
        data = self.convert_frame(
            frame,
            self._joints_with_gripper_shares(frame["joints"]),
            self._joints_with_gripper_shares(frame["action_joints"]),
        )
        if RIGHT_IN_LEFT_BASE_KEY in frame:
            data[schema.RIGHT_BASE_POSE_KEY] = np.asarray(frame[RIGHT_IN_LEFT_BASE_KEY], dtype=np.float32)
        return data

    def convert_frame(
        self, frame: Mapping[str, Any], joints: Sequence[Array], command: Sequence[Array]
    ) -> dict[str, Any]:
        """Convert a frame to raiden's layout, without the pose of the right base.

        `joints` and `command` have, for each arm, six joints in rad and the gripper share (7,).
        """
        return {
            **{
                key: {name: frame[key][camera] for camera, name in self.names.items() if camera in frame[key]}
                for key in ("intrinsics", "extrinsics")
            },
            "joints": _concatenate_float32(joints),
            "action": _concatenate_float32(self._hand_values(command)),
            "actual_poses": _concatenate_float32(self._hand_values(joints)),
            "action_joints": _concatenate_float32(command),
            # Zero-dimensional arrays, as raiden's `converter.py` writes them.
            "language_task": np.array(frame["language_task"], dtype=object),
            "language_prompt": np.array(frame["language_prompt"], dtype=object),
        }

    def T_hand_in_base(self, arm: int, joints: ArrayLike) -> Array:
        """Return the hand pose (4, 4) of an arm in its own base, from the joints of a converted frame."""
        return self._arms[arm].T_hand_in_base(np.asarray(joints)[schema.ARM_VALUES * arm :])

    def _joints_with_gripper_shares(self, joints: ArrayLike) -> list[Array]:
        """Convert recorded joints, (7,) or (14,), to (7,) of each arm. A missing arm is zero."""
        rows = np.zeros((len(self._arms), schema.ARM_VALUES))
        recorded = np.reshape(joints, (-1, schema.ARM_VALUES))
        rows[: len(recorded)] = recorded
        return [arm.joints_with_gripper_share(row) for arm, row in zip(self._arms, rows, strict=True)]

    def _hand_values(self, joints: Sequence[Array]) -> list[Array]:
        return [arm.hand_values(row) for arm, row in zip(self._arms, joints, strict=True)]


def _concatenate_float32(arms: Sequence[ArrayLike]) -> NDArray[np.float32]:
    return np.concatenate(arms).astype(np.float32)


def calibration_json(
    source: SimulatedSource, converter: FrameConverter, options: RaidenOptions, frames: Frames
) -> dict[str, Any]:
    """Return the content of `calibration_results.json`.

    The position of a wrist camera is the mean over the converted `frames`. With kinematics other than the simulated
    arm's, the hand-eye pose differs slightly between frames.
    """
    T = frames[0].get(schema.RIGHT_BASE_POSE_KEY)
    T_right_base_in_left_base = None if T is None else np.asarray(T, np.float64)
    wrists = _wrist_arms(source)
    cameras: dict[str, Any] = {}
    for camera, size in source.camera_sizes.items():
        name = converter.names[camera]
        entry = camera_entry(frames[0]["intrinsics"][name], [0.0] * 5, size, "simulation")
        if camera in wrists:
            T_cam = _mean_hand_eye_pose(name, wrists[camera], converter, frames, T_right_base_in_left_base)
            cameras[name] = wrist_camera(name, wrists[camera], entry, T_cam, "sim")
        else:
            cameras[name] = scene_camera(entry, np.asarray(frames[0]["extrinsics"][name], np.float64))
    found = calibration_document(cameras, options.hand_frame)
    if T_right_base_in_left_base is not None:
        found["bimanual_transform"] = bimanual_transform(T_right_base_in_left_base, computed_from_calibration=False)
    return found


def calibration_document(cameras: Mapping[str, Any], frame: HandFrameName) -> dict[str, Any]:
    """Return the content of `calibration_results.json` with these cameras, without the pose of the right base."""
    return {
        "version": "1.0",
        "timestamp": _ZERO_TIME,
        "coordinate_frame": "left_arm_base",
        "hand_frame": hand_frame(frame),
        "cameras": cameras,
    }


def camera_entry(
    K: ArrayLike, distortion: Sequence[float], size: Sequence[int], source: str, pictures: int = 0
) -> dict[str, Any]:
    """Return the part of a camera's entry that does not depend on its pose.

    Args:
        K: camera matrix (3, 3), px.
        distortion: OpenCV's coefficients.
        size: width and height, px.
        source: what determined the matrix.
        pictures: number of pictures of the calibration.
    """
    return {
        "serial_number": 0,
        "intrinsics": {
            "camera_matrix": np.asarray(K).tolist(),
            "distortion_coeffs": list(distortion),
            "image_size": list(size),
            "source": source,
        },
        "num_poses_used": pictures,
    }


def scene_camera(entry: Mapping[str, Any], T_cam_in_left_base: Array) -> dict[str, Any]:
    """Return the entry of a fixed camera with its pose (4, 4), m."""
    extrinsics = {**_transform_json(T_cam_in_left_base), "reference_frame": "left_arm_base"}
    return {"type": "scene", **entry, "arm": _ARM_SIDES[0], "extrinsics": extrinsics}


def bimanual_transform(T_right_base_in_left_base: Array, *, computed_from_calibration: bool) -> dict[str, Any]:
    """Return the entry of the right base's pose (4, 4), m. raiden's `converter.py` inverts its first value."""
    return {
        "right_base_to_left_base": invert_pose(T_right_base_in_left_base).tolist(),
        "computed_from_calibration": computed_from_calibration,
        "description": "Pose of the left arm's base in the right one's: the inverse of T_right_base_in_left_base",
        "T_right_base_in_left_base": T_right_base_in_left_base.tolist(),
    }


def _mean_hand_eye_pose(
    name: str,
    arm: int,
    converter: FrameConverter,
    frames: Frames,
    T_right_base_in_left_base: Array | None,
) -> Array:
    to_base = np.eye(4)
    if arm == 1 and T_right_base_in_left_base is not None:
        to_base = invert_pose(T_right_base_in_left_base)
    in_hand = [
        invert_pose(converter.T_hand_in_base(arm, frame["joints"]))
        @ to_base
        @ np.asarray(frame["extrinsics"][name], np.float64)
        for frame in frames
    ]
    return pose(np.mean([T[:3, 3] for T in in_hand], axis=0), in_hand[0][:3, :3])


def wrist_camera(name: str, arm: int, entry: Mapping[str, Any], T_cam_in_grasp: Array, method: str) -> dict[str, Any]:
    """Return the entry of a wrist camera with its pose (4, 4) in `grasp_site`, m. `arm` is 0 for the left arm."""
    T = T_cam_in_grasp
    upside_down = name == _UPSIDE_DOWN_CAMERA
    hand_eye = _transform_json(T @ _HALF_TURN if upside_down else T)
    return {
        "type": "hand_eye",
        **entry,
        "arm": _ARM_SIDES[arm],
        "hand_eye_calibration": {**hand_eye, "method": method, "upside_down": upside_down},
        "extrinsics": {**_transform_json(T), "reference_frame": f"{_ARM_SIDES[arm]}_grasp_site"},
    }


def _transform_json(T: Array) -> dict[str, Any]:
    return {
        "success": True,
        "rotation_matrix": T[:3, :3].tolist(),
        "translation_vector": T[:3, 3].tolist(),
        "rotation_vector": rotation_vector(T[:3, :3]).tolist(),
    }
