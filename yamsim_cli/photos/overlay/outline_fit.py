"""Score rendered arms by edges and masks, and refine their poses by edges."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from yamsim_cli.core.geometry.camera import CameraModel
from yamsim_cli.core.geometry.se3 import Array, invert_pose

from ..edge_alignment import (
    EdgeOffsets,
    PoseCorrectionEquations,
    edge_equations,
    edge_offsets,
    grain_px,
    mask_outline,
    search_distances,
    solve_correction,
)
from ..fiducials.board_localization import replace_board_pose
from .joint_files import ArmPostures
from .photo_arm_poses import ArmBasePose, RigInPhoto
from .rendered_arms import ArmRenderer, ArmsInPinholePicture

_MIN_POINTS = 20  # points of an outline; with fewer, it does not move a pose


def score_outlines(result: RigInPhoto, renderer: ArmRenderer, grey: NDArray[np.uint8]) -> RigInPhoto:
    """Return median distances (px) of outlines to edges in the result, by arm and overall."""
    flat_grey = renderer.undistort_photo(grey)
    labels = renderer.undistorted_label_image()
    offsets = {
        k: edge_offsets(flat_grey, mask_outline(labels == k + 1, _other_arms_mask(labels, k) | renderer.outside_photo))
        for k in result.base_poses
    }
    arms = tuple(
        replace(arm, edge_residual=offsets[k].median_distance) if k in offsets else arm
        for k, arm in enumerate(result.arms)
    )
    reach = next(iter(offsets.values())).search_distance
    every = EdgeOffsets(np.concatenate([found.offsets for found in offsets.values()]), reach)
    return replace(result, arms=arms, edge_residual=every.median_distance)


def _other_arms_mask(labels: NDArray[np.uint8], k: int) -> NDArray[np.bool_]:
    other: NDArray[np.bool_] = (labels > 0) & (labels != k + 1)
    return other


def refine_poses(
    result: RigInPhoto, renderer: ArmRenderer, postures: ArmPostures, grey: NDArray[np.uint8], together: bool
) -> RigInPhoto:
    """Refine poses by edges of a photo (height, width), with poses from boards as prior.

    With `together`, the arms move as one rigid body.
    """
    flat_grey = renderer.undistort_photo(grey)
    start = result.base_poses
    groups = [list(start)] if together else [[k] for k in start]
    priors = [_pose_prior([result.arms[k] for k in group]) for group in groups]
    steps = [np.zeros(6) for _ in groups]
    poses = dict(start)
    for reach in search_distances():
        renderer.set_poses(poses, postures)
        flat = renderer.pinhole_arms()
        for group, (centre, information), step in zip(groups, priors, steps, strict=True):
            equations = [
                part for k in group if (part := _arm_edge_equations(flat, flat_grey, k, centre, reach)) is not None
            ]
            if not equations:
                continue
            move = solve_correction(equations, centre, information, step)
            step += move.step
            poses.update({k: move.apply_to_pose(poses[k]) for k in group})
    camera = result.lens.camera
    arms = tuple(
        _with_refined_pose(arm, poses[k], grey, camera) if k in poses else arm for k, arm in enumerate(result.arms)
    )
    return replace(result, arms=arms)


def _arm_edge_equations(
    flat: ArmsInPinholePicture, flat_grey: NDArray[np.uint8], k: int, centre: Array, reach: float
) -> PoseCorrectionEquations | None:
    line = mask_outline(flat.labels == k + 1, _other_arms_mask(flat.labels, k) | flat.outside_photo)
    if len(line.points) < _MIN_POINTS:
        return None
    inside = np.round(line.points - line.normals).astype(int)
    depth = flat.depth[inside[:, 1], inside[:, 0]].astype(np.float64)
    offsets = edge_offsets(flat_grey, line, reach).offsets
    return edge_equations(line, depth, offsets, flat.intrinsics.K, centre, edge_sigma=grain_px(flat_grey.shape))


def _with_refined_pose(
    arm: ArmBasePose, T_base_in_cam: Array, grey: NDArray[np.uint8], camera: CameraModel
) -> ArmBasePose:
    seen = arm.detection
    if seen is not None and seen.T_board_in_cam is not None:
        assert arm.T_base_in_cam is not None
        T_board_in_base = invert_pose(arm.T_base_in_cam) @ seen.T_board_in_cam
        seen = replace_board_pose(grey, camera, seen, T_base_in_cam @ T_board_in_base)
    return replace(arm, T_base_in_cam=T_base_in_cam, detection=seen)


def _pose_prior(arms: Sequence[ArmBasePose]) -> tuple[Array, Array]:
    """Return a point (3,) in the camera frame, and the pose's inverse covariance (6, 6) about it."""
    for arm in arms:
        seen = arm.detection
        if seen is not None and seen.covariance is not None and seen.T_board_in_cam is not None:
            information: Array = np.linalg.inv(seen.covariance).astype(np.float64)
            return seen.T_board_in_cam[:3, 3], information
    # Recordings hold no uncertainty: assume one degree and one centimetre.
    assert arms[0].T_base_in_cam is not None
    return arms[0].T_base_in_cam[:3, 3], np.diag([math.radians(1) ** -2] * 3 + [0.01**-2] * 3)


def mask_iou(one: NDArray[np.bool_], other: NDArray[np.bool_]) -> float:
    """Return the intersection over union of masks (height, width); 1 if both are empty."""
    union = int((one | other).sum())
    return int((one & other).sum()) / union if union else 1.0
