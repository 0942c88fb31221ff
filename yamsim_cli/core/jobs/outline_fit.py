"""How well drawn arms meet a photo: their outlines against its edges, their pixels against a mask; and better poses."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError
from ..geometry.se3 import Array, inverse
from ..vision.silhouette import EdgeOffsets, correction, edge_offsets, outline, rounds
from .arm_poses import ArmPose, PhotoResult
from .drawn_arms import ArmDrawer


def score_outlines(result: PhotoResult, drawer: ArmDrawer, joints: Array, grey: NDArray[np.uint8]) -> PhotoResult:
    """The result with its outlines compared with the edges of the photo (height, width)."""
    flat_grey = drawer.flattened(grey)
    drawer.pose(result.bases, joints)
    labels = drawer.flat().labels
    offsets = {k: edge_offsets(flat_grey, outline(labels == k + 1, _other(labels, k))) for k in result.bases}
    arms = tuple(
        replace(arm, edge_residual=offsets[k].residual) if k in offsets else arm for k, arm in enumerate(result.arms)
    )
    every = EdgeOffsets(np.concatenate([found.offsets for found in offsets.values()]))
    return replace(result, arms=arms, edge_residual=every.residual)


def _other(labels: NDArray[np.uint8], k: int) -> NDArray[np.bool_]:
    other: NDArray[np.bool_] = (labels > 0) & (labels != k + 1)
    return other


def refine(result: PhotoResult, drawer: ArmDrawer, joints: Array, grey: NDArray[np.uint8]) -> PhotoResult:
    """Every arm's pose moved onto the edges of the photo (height, width), as far as its board's uncertainty lets it."""
    flat_grey = drawer.flattened(grey)
    start = result.bases
    steps = {k: np.zeros(6) for k in start}
    poses = dict(start)
    for reach in rounds():
        drawer.pose(poses, joints)
        flat = drawer.flat()
        K = flat.intrinsics.K
        for k, T in list(poses.items()):
            line = outline(flat.labels == k + 1, _other(flat.labels, k))
            if len(line.points) < 20:
                continue
            inside = np.round(line.points - line.normals).astype(int)
            depth = flat.depth[inside[:, 1], inside[:, 0]].astype(np.float64)
            centre, information = _prior(result.arms[k], T)
            found = edge_offsets(flat_grey, line, reach)
            move = correction(line, depth, found.offsets, K, centre, information, steps[k])
            poses[k] = move.applied(T)
            steps[k] = steps[k] + move.step
    arms = []
    for k, arm in enumerate(result.arms):
        if k not in poses:
            arms.append(arm)
            continue
        seen = arm.sighting
        if seen and seen.T_board_in_cam is not None:
            moved = poses[k] @ inverse(start[k]) @ seen.T_board_in_cam
            seen = replace(seen, T_board_in_cam=moved)
        arms.append(replace(arm, T_base_in_cam=poses[k], sighting=seen))
    return replace(result, arms=tuple(arms))


def _prior(arm: ArmPose, T_base_in_cam: Array) -> tuple[Array, Array]:
    """What the pose is known to before edges are looked at: a point (3,) and the inverse covariance (6, 6) about it."""
    if arm.sighting and arm.sighting.covariance is not None and arm.sighting.T_board_in_cam is not None:
        information: Array = np.linalg.inv(arm.sighting.covariance).astype(np.float64)
        return arm.sighting.T_board_in_cam[:3, 3], information
    # Neither recorded nor inferred poses come with an uncertainty: a degree, and a centimetre.
    return T_base_in_cam[:3, 3], np.diag([math.radians(1) ** -2] * 3 + [0.01**-2] * 3)


def overlap(labels: NDArray[np.uint8], mask: NDArray[np.uint8], path: Path) -> float:
    """Intersection over union of drawn arms (height, width) and a person's mask (height, width[, channels]), not 0.

    Raises:
        ConfigError: the mask has another size than the photo at `path`.
    """
    if mask.shape[:2] != labels.shape:
        raise ConfigError(
            f"the mask for {path} has {mask.shape[1]} x {mask.shape[0]} pixels, the photo {labels.shape[1]} x "
            f"{labels.shape[0]}"
        )
    theirs = mask.reshape(*mask.shape[:2], -1).max(axis=2) > 0
    ours = labels > 0
    union = int((ours | theirs).sum())
    return int((ours & theirs).sum()) / union if union else 1.0
