"""How well drawn arms meet a photo: their outlines against its edges, their pixels against a mask; and better poses."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError
from ..geometry.camera import CameraModel
from ..geometry.se3 import Array, inverse
from ..vision.fiducials.locate import at_pose
from ..vision.silhouette import EdgeOffsets, Pull, correction, edge_offsets, grain_px, outline, pull, rounds
from .arm_poses import ArmPose, PhotoResult
from .rendered_arms import ArmDrawer, Flat

# An outline of fewer points says too little.
_LEAST_POINTS = 20


def score_outlines(result: PhotoResult, drawer: ArmDrawer, grey: NDArray[np.uint8]) -> PhotoResult:
    """The result with its outlines, as posed in `drawer`, compared with the edges of the photo (height, width)."""
    flat_grey = drawer.flattened(grey)
    labels = drawer.flat_labels()
    offsets = {k: edge_offsets(flat_grey, outline(labels == k + 1, _other(labels, k))) for k in result.bases}
    arms = tuple(
        replace(arm, edge_residual=offsets[k].residual) if k in offsets else arm for k, arm in enumerate(result.arms)
    )
    reach = next(iter(offsets.values())).reach
    every = EdgeOffsets(np.concatenate([found.offsets for found in offsets.values()]), reach)
    return replace(result, arms=arms, edge_residual=every.residual)


def _other(labels: NDArray[np.uint8], k: int) -> NDArray[np.bool_]:
    other: NDArray[np.bool_] = (labels > 0) & (labels != k + 1)
    return other


def refine(
    result: PhotoResult, drawer: ArmDrawer, joints: Array, grey: NDArray[np.uint8], together: bool
) -> PhotoResult:
    """Poses moved onto the edges of the photo (height, width), as far as their boards' uncertainty lets them.

    Args:
        together: the arms keep their places to each other, so all move as one.
    """
    flat_grey = drawer.flattened(grey)
    start = result.bases
    groups = [list(start)] if together else [[k] for k in start]
    priors = [_prior([result.arms[k] for k in group]) for group in groups]
    steps = [np.zeros(6) for _ in groups]
    poses = dict(start)
    for reach in rounds():
        drawer.pose(poses, joints)
        flat = drawer.flat()
        for group, (centre, information), step in zip(groups, priors, steps, strict=True):
            pulls = [part for k in group if (part := _pull(flat, flat_grey, k, centre, reach)) is not None]
            if not pulls:
                continue
            move = correction(pulls, centre, information, step)
            step += move.step
            poses.update({k: move.applied(poses[k]) for k in group})
    camera = result.lens.camera
    arms = tuple(_moved(arm, poses[k], grey, camera) if k in poses else arm for k, arm in enumerate(result.arms))
    return replace(result, arms=arms)


def _pull(flat: Flat, flat_grey: NDArray[np.uint8], k: int, centre: Array, reach: float) -> Pull | None:
    """How the photo's edges want the k-th arm moved; None where too little of it is seen."""
    line = outline(flat.labels == k + 1, _other(flat.labels, k))
    if len(line.points) < _LEAST_POINTS:
        return None
    inside = np.round(line.points - line.normals).astype(int)
    depth = flat.depth[inside[:, 1], inside[:, 0]].astype(np.float64)
    offsets = edge_offsets(flat_grey, line, reach).offsets
    return pull(line, depth, offsets, flat.intrinsics.K, centre, edge_sigma=grain_px(flat_grey.shape))


def _moved(arm: ArmPose, T_base_in_cam: Array, grey: NDArray[np.uint8], camera: CameraModel) -> ArmPose:
    """An arm with a better pose, and what its board says of that."""
    seen = arm.sighting
    if seen is not None and seen.T_board_in_cam is not None:
        assert arm.T_base_in_cam is not None
        T_board_in_base = inverse(arm.T_base_in_cam) @ seen.T_board_in_cam
        seen = at_pose(grey, camera, seen, T_base_in_cam @ T_board_in_base)
    return replace(arm, T_base_in_cam=T_base_in_cam, sighting=seen)


def _prior(arms: Sequence[ArmPose]) -> tuple[Array, Array]:
    """What a pose is known to before edges are looked at: a point (3,) and the inverse covariance (6, 6) about it."""
    for arm in arms:
        seen = arm.sighting
        if seen is not None and seen.covariance is not None and seen.T_board_in_cam is not None:
            information: Array = np.linalg.inv(seen.covariance).astype(np.float64)
            return seen.T_board_in_cam[:3, 3], information
    # A recorded pose comes without an uncertainty: a degree, and a centimetre.
    assert arms[0].T_base_in_cam is not None
    return arms[0].T_base_in_cam[:3, 3], np.diag([math.radians(1) ** -2] * 3 + [0.01**-2] * 3)


def overlap(labels: NDArray[np.uint8], mask: NDArray[np.bool_], path: Path) -> float:
    """Intersection over union of drawn arms (height, width) and a person's mask (height, width).

    Raises:
        ConfigError: the mask has another size than the photo at `path`.
    """
    if mask.shape != labels.shape:
        raise ConfigError(
            f"the mask for {path} has {mask.shape[1]} x {mask.shape[0]} pixels, the photo {labels.shape[1]} x "
            f"{labels.shape[0]}"
        )
    drawn = labels > 0
    union = int((drawn | mask).sum())
    return int((drawn & mask).sum()) / union if union else 1.0
