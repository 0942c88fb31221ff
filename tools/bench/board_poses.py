"""The camera's pose by the board beside the arm, for `tools.bench.calibrate --boards`."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tools.bench.calibration_stations import CAMERA, Planted, StationOptions, run_yamsim
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array, pose, pose_from_quat, quat_from_rotation, rotation_vector, rotation_z
from yamsim_cli.core.statistics import Z95

EVERY = 20  # of the pictures, one is used


def board_pose(folder: Path, options: StationOptions) -> dict[str, Any] | None:
    """Return the camera's mean pose in the base by `overlay` on pictures of the station; None if no board is found.

    `position_95_mm` and `rotation_95_deg` are half widths of 95 % intervals along and about the base's axes. They are
    those of one picture: pictures share the errors of focal length and print.
    """
    images = [part for ep in sorted((folder / "episodes").iterdir()) for part in ("--img", ep / "rgb" / CAMERA)]
    text = run_yamsim(
        *("overlay", *images, "--rig", options.rig, "--camera", folder / f"{CAMERA}.yaml", "--every", EVERY),
        *("--out", folder / "overlays", "--overwrite", "--json"),
        codes=(0, 4, 6),
    )
    rig = load_config(RigConfig, "rigs", options.rig, Locations.from_environment({}))
    # Exit code 4 stands for no board in any picture, and also for a missing resource, without JSON.
    if not text:
        raise RuntimeError(f"`yamsim overlay` found nothing and wrote no JSON: run it on {folder}")
    seen = [image["arms"][0] for image in json.loads(text)["images"]]
    seen = [one for one in seen if one["status"] == "ok"]
    if not seen:
        return None
    T_cam = np.array([one["T_cam_in_base"] for one in seen])
    variances = np.mean([_variances(one, rig.arms[0].T_board_in_base) for one in seen], axis=0)
    widths = Z95 * np.sqrt(variances)
    return {
        "position": T_cam[:, :3, 3].mean(axis=0).tolist(),
        "quat": quat_from_rotation(Rotation.from_matrix(T_cam[:, :3, :3]).mean().as_matrix()).tolist(),
        "position_95_mm": (1000 * widths[3:]).tolist(),
        "rotation_95_deg": np.degrees(widths[:3]).tolist(),
        "pictures": len(seen),
    }


def _variances(arm: Mapping[str, Any], T_board_in_base: Array) -> Array:
    """Return the variances (6,) of the camera's turn and shift about and along the base's axes."""
    T = np.array(arm["T_base_in_cam"])
    x, y, z = (T @ T_board_in_base)[:3, 3]
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    R = T[:3, :3].T
    # The covariance is of a turn about the board's centre and of its shift, in the camera's axes.
    by_step = np.block([[-R, np.zeros((3, 3))], [-R @ cross, -R]])
    return np.asarray(np.diag(by_step @ np.array(arm["covariance"]) @ by_step.T))


def in_measured_base(found: Mapping[str, Any], planted: Planted) -> dict[str, Any]:
    """Return a pose by the board in the base in which the measured first joint is true, as `calibrate` gives poses.

    The board shows the base body, which the first joint's offset turns against that base.
    """
    turn = rotation_z(float(planted.offsets[0]))
    T = pose(rotation=turn) @ pose_from_quat(found["position"], found["quat"])
    widths = {}
    for key in ("position_95_mm", "rotation_95_deg"):
        # Half widths along the turned axes, as if the errors along the two were independent.
        widths[key] = np.sqrt(turn**2 @ np.array(found[key]) ** 2).tolist()
    return {**found, **widths, "position": T[:3, 3].tolist(), "quat": quat_from_rotation(T[:3, :3]).tolist()}


def pose_difference(found: Mapping[str, Any], T: Array) -> tuple[Array, Array]:
    """Return how far a found pose is from a pose (4, 4) along and about the base's axes, mm and degrees."""
    T_found = pose_from_quat(found["position"], found["quat"])
    turn = rotation_vector(T_found[:3, :3] @ T[:3, :3].T)
    return 1000 * (T_found[:3, 3] - T[:3, 3]), np.degrees(turn)


def both_widths(one: Mapping[str, Any], other: Mapping[str, Any], key: str) -> list[float]:
    """Return the half widths of the difference of two poses, as if their errors were independent."""
    return [math.hypot(a, b) for a, b in zip(one[key], other[key], strict=True)]
