"""Find a camera's pose without a guess: from where the picture changes when the arms move."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.spatial import cKDTree

from ..core.geometry.se3 import Array, invert_pose, pose, rotation_between, rotation_from_vector, rotation_vector

Mask = NDArray[np.bool_]

# The grid of hypotheses: directions from which the camera looks, and its turn about its axis.
_AZIMUTHS = 24
_ELEVATIONS = np.radians([0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 89.0])  # above the horizon
_ROLLS = np.radians([0.0, 20.0, -20.0, 180.0, 90.0, -90.0])
_DISTANCES = (0.85, 1.0, 1.18)  # factors on the distance at which the arm has the size of the changed part
_CELLS = 40  # cells along a picture's longer side in the score of the grid
_FINE_CELLS = 80  # the same for refined poses
_CELL_SHARE = 0.25  # share of changed pixels in a cell that counts as changed
_SCORED_FRAMES = 10  # pictures in the score of the grid
_POINTS = 500  # points of the moving bodies in each picture
_FINE_POINTS = 2500
# Hypotheses of the grid from which the overlap of coarse masks is maximized, and overlaps computed for each, in 1 s
# together. The overlaps of the grid itself are hardly larger near the camera than elsewhere if its steps are large
# compared with the arms.
_CLIMBED, _CLIMB_EVALUATIONS = 60, 80
_REFINED = 14  # of these hypotheses that are refined
_SAME_TURN, _SAME_SHIFT = math.radians(12), 0.08  # rad, and share of the distance: poses closer than both are one
_WIDTH = 160  # px, width of the masks in the refinement
_STEPS = 18  # of the refinement
_MASK_POINTS = 200  # changed pixels of a picture in the refinement
_POLISHED = 5  # refined hypotheses whose overlap is then maximized
_SIMPLEX = (0.06, 0.03)  # rad, and share of the distance: size of the first simplex
_EVALUATIONS = 350  # of the overlap, for one hypothesis
_MIN_CUTOFF = 4.0  # px of `_WIDTH`
_MIN_MASK = 0.003  # share of the picture that has changed, below which a picture is not used


@dataclass(frozen=True)
class MaskView:
    """A picture's changed pixels, and points (n, 3) of the moving bodies in the reference base's frame, m."""

    changed: Mask
    points: Array


@dataclass(frozen=True)
class Hypothesis:
    """A pose (4, 4) of the reference base in the camera, a focal scale, and its overlap with the masks, 0..1."""

    T_base_in_cam: Array
    focal_scale: float
    overlap: float


def search_poses(
    views: Sequence[MaskView], K: Array, known: Iterable[Array], focal_scales: Sequence[float], count: int
) -> list[Hypothesis]:
    """Return at most `count` different poses, the best first; the best known one is at least the second.

    Args:
        K: camera matrix (3, 3) of the masks, px.
        known: poses (4, 4) of the base in the camera that are tried too, such as the rig's.
        focal_scales: factors on the focal length that are tried.
    """
    usable = [view for view in views if view.changed.mean() > _MIN_MASK and len(view.points)]
    if len(usable) < 3:
        return []
    rng = np.random.default_rng(0)
    scored = [usable[k] for k in np.linspace(0, len(usable) - 1, _SCORED_FRAMES).round().astype(int)]
    rough = _Overlap(scored, _CELLS, _POINTS, rng)
    starts: list[Hypothesis] = []
    for scale in focal_scales:
        scaled = _scale_focal(K, scale)
        starts += _scored(_grid(scored, scaled, rng), scale, rough, K)
    middle = np.mean([view.points.mean(axis=0) for view in scored], axis=0)
    free_focal = len(focal_scales) > 1
    starts = [
        _maximize_overlap(one, rough, K, middle, free_focal, _CLIMB_EVALUATIONS)
        for one in _distinct(sorted(starts, key=_overlap_of, reverse=True), _CLIMBED)
    ]
    starts = _distinct(sorted(starts, key=_overlap_of, reverse=True), _REFINED)
    refiner = _MaskRefiner(scored, K, rng)
    fine = _Overlap(scored, _FINE_CELLS, _FINE_POINTS, rng)
    refined = []
    for start in starts:
        T, scale = refiner.refine(start.T_base_in_cam, start.focal_scale, free_focal)
        score = fine.score([T], _scale_focal(K, scale))[0]
        refined.append(Hypothesis(T, scale, float(score)))
    best = _distinct(sorted(refined, key=_overlap_of, reverse=True), _POLISHED)
    tried = [max((_scored([T], scale, fine, K)[0] for scale in focal_scales), key=_overlap_of) for T in known]
    polished, given = (
        sorted((_maximize_overlap(one, fine, K, middle, free_focal, _EVALUATIONS) for one in some), key=_overlap_of)
        for some in (best, tried)
    )
    found = _distinct(sorted([*polished, *given], key=_overlap_of, reverse=True), count)
    # If the camera sees only a part of the arms, wrong poses may have larger overlaps than the right one.
    return _distinct([found[0], given[-1], *found[1:]], count) if given else found


def _overlap_of(one: Hypothesis) -> float:
    return one.overlap


def _scored(poses: Sequence[Array], scale: float, masks: _Overlap, K: Array) -> list[Hypothesis]:
    scores = masks.score(poses, _scale_focal(K, scale))
    return [Hypothesis(T, scale, float(score)) for T, score in zip(poses, scores, strict=True)]


def _maximize_overlap(
    start: Hypothesis, masks: _Overlap, K: Array, middle: Array, free_focal: bool, evaluations: int
) -> Hypothesis:
    """Return the pose near a hypothesis with the largest overlap, by the simplex method of Nelder and Mead."""
    T0 = start.T_base_in_cam
    centre = T0[:3, :3] @ middle + T0[:3, 3]
    far = float(np.linalg.norm(centre))
    units = np.array([_SIMPLEX[0]] * 3 + [_SIMPLEX[1] * far] * 3 + [_SIMPLEX[1]] * free_focal)

    def moved(step: Array) -> tuple[Array, float]:
        turn, scaled = rotation_from_vector(step[:3] * units[:3]), step[3:6] * units[3:6]
        scale = start.focal_scale * (math.exp(step[6] * units[6]) if free_focal else 1.0)
        return pose(centre + scaled + turn @ (T0[:3, 3] - centre), turn @ T0[:3, :3]), scale

    def cost(step: Array) -> float:
        T, scale = moved(step)
        return -float(masks.score([T], _scale_focal(K, scale))[0])

    simplex = np.vstack([np.zeros(len(units)), np.eye(len(units))])
    options = {"maxfev": evaluations, "initial_simplex": simplex, "xatol": 0.02, "fatol": 1e-4}
    found = minimize(cost, np.zeros(len(units)), method="Nelder-Mead", options=options)
    T, scale = moved(found.x)
    return Hypothesis(T, scale, -float(found.fun))


def mask_overlap(views: Sequence[MaskView], K: Array, T_base_in_cam: Array) -> float:
    """Return the overlap, 0..1, of the moving bodies at a pose with the masks."""
    usable = [view for view in views if view.changed.mean() > _MIN_MASK and len(view.points)]
    if not usable:
        return 0.0
    return float(_Overlap(usable, _FINE_CELLS, _FINE_POINTS, np.random.default_rng(0)).score([T_base_in_cam], K)[0])


def _scale_focal(K: Array, scale: float) -> Array:
    scaled = K.copy()
    scaled[[0, 1], [0, 1]] *= scale
    return scaled


def _thin(points: Array, count: int, rng: np.random.Generator) -> Array:
    return points if len(points) <= count else points[rng.choice(len(points), count, replace=False)]


def _distinct(hypotheses: Sequence[Hypothesis], count: int) -> list[Hypothesis]:
    """Return the first `count` of poses that differ."""
    found: list[Hypothesis] = []
    for one in hypotheses:
        if len(found) == count:
            break
        if all(not _is_same(one.T_base_in_cam, other.T_base_in_cam) for other in found):
            found.append(one)
    return found


def _is_same(one: Array, other: Array) -> bool:
    turn = float(np.linalg.norm(rotation_vector(one[:3, :3] @ other[:3, :3].T)))
    far = np.linalg.norm(one[:3, 3])
    return turn < _SAME_TURN and float(np.linalg.norm(invert_pose(one)[:3, 3] - invert_pose(other)[:3, 3])) < max(
        _SAME_SHIFT, _SAME_SHIFT * float(far)
    )


def _grid(views: Sequence[MaskView], K: Array, rng: np.random.Generator) -> list[Array]:
    """Return poses of the base in the camera, each with the arm's middle at the middle of the changed pixels."""
    clouds = [_thin(view.points, 200, rng) for view in views]
    middle = np.mean([points.mean(axis=0) for points in clouds], axis=0)
    pixels = [np.argwhere(view.changed)[:, ::-1].astype(np.float64) for view in views]
    centre = np.mean([one.mean(axis=0) for one in pixels], axis=0)
    spread = math.sqrt(float(np.mean([one.var(axis=0).sum() for one in pixels])))
    ray = np.array([(centre[0] - K[0, 2]) / K[0, 0], (centre[1] - K[1, 2]) / K[1, 1], 1.0])
    ray /= np.linalg.norm(ray)
    # A camera that looks straight at the middle, turned so that the middle appears at `centre`.
    towards = rotation_between((0.0, 0.0, 1.0), ray)
    poses = []
    for azimuth in np.arange(_AZIMUTHS) * 2 * math.pi / _AZIMUTHS:
        for elevation in _ELEVATIONS:
            from_middle = np.array(
                [math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation)]
            )
            right = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
            straight = np.stack([right, -np.cross(from_middle, right), -from_middle])  # rows: the camera's axes
            flat = math.sqrt(float(np.mean([(points @ straight[:2].T).var(axis=0).sum() for points in clouds])))
            distance = K[0, 0] * flat / max(spread, 1e-6)
            for roll in _ROLLS:
                R = towards @ rotation_from_vector([0.0, 0.0, roll]) @ straight
                poses += [pose(ray * distance * factor - R @ middle, R) for factor in _DISTANCES]
    return poses


class _Overlap:
    """Scores poses by the intersection over union of coarse masks."""

    def __init__(self, views: Sequence[MaskView], cells: int, points: int, rng: np.random.Generator) -> None:
        height, width = views[0].changed.shape
        self._cell = max(width, height) / cells
        self._shape = math.ceil(height / self._cell), math.ceil(width / self._cell)
        share = [
            cv2.resize(view.changed.astype(np.float32), self._shape[::-1], interpolation=cv2.INTER_AREA)
            for view in views
        ]
        self._changed = np.array(share).reshape(len(views), -1) > _CELL_SHARE
        clouds = [_thin(view.points, points, rng) for view in views]
        least = min(len(one) for one in clouds)
        self._points = np.array([one[:least] for one in clouds])

    def score(self, poses: Sequence[Array], K: Array) -> Array:
        """Return the overlap (n,) of each pose."""
        return np.array([self._score(T, K) for T in poses])

    def _score(self, T: Array, K: Array) -> float:
        in_cam = self._points @ T[:3, :3].T + T[:3, 3]
        z = in_cam[..., 2]
        safe = np.where(z > 0.05, z, np.inf)
        column = (in_cam[..., 0] * (K[0, 0] / safe) + K[0, 2]) / self._cell
        row = (in_cam[..., 1] * (K[1, 1] / safe) + K[1, 2]) / self._cell
        rows, columns = self._shape
        inside = (z > 0.05) & (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
        covered = np.zeros_like(self._changed)
        frame, point = np.nonzero(inside)
        covered[frame, row[frame, point].astype(int) * columns + column[frame, point].astype(int)] = True
        union = (covered | self._changed).sum(axis=1)
        both = (covered & self._changed).sum(axis=1)
        # Points outside of the picture count as cells that are missed.
        seen = inside.mean(axis=1)
        return float(np.mean(both / np.maximum(union, 1) * np.minimum(1.0, 0.3 + seen)))


class _MaskRefiner:
    """Moves a pose until the moving bodies' points lie on the changed pixels, and the changed pixels near points."""

    def __init__(self, views: Sequence[MaskView], K: Array, rng: np.random.Generator) -> None:
        height, width = views[0].changed.shape
        self._shrink = _WIDTH / width
        size = _WIDTH, max(1, round(height * self._shrink))
        self._K = K.copy()
        self._K[:2] *= self._shrink
        self._points = [_thin(view.points, _POINTS, rng) for view in views]
        self._nearest, self._pixels = [], []
        for view in views:
            small = cv2.resize(view.changed.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.4
            if not small.any():
                small[size[1] // 2, size[0] // 2] = True
            pixels = np.argwhere(small)[:, ::-1].astype(np.float64)
            _, labels = cv2.distanceTransformWithLabels(
                (~small).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
            )
            by_label = np.zeros((int(labels.max()) + 1, 2))
            by_label[labels[small]] = pixels
            self._nearest.append(by_label[labels])
            self._pixels.append(_thin(pixels, _MASK_POINTS, rng))

    def refine(self, T: Array, scale: float, free_focal: bool) -> tuple[Array, float]:
        """Return the moved pose (4, 4) and focal scale."""
        for step in range(_STEPS):
            found = self._normal_equations(T, scale, cutoff=max(_MIN_CUTOFF, 40.0 * 0.8**step))
            if found is None:
                break
            normal, right_hand_side, centre = found
            normal[6, 6] += 0.0 if free_focal else 1e12
            normal += np.diag(1e-3 * np.diag(normal) + 1e-9)
            move: Array = np.linalg.solve(normal, right_hand_side).astype(np.float64)
            turn = rotation_from_vector(move[:3])
            T = pose(centre + move[3:6] + turn @ (T[:3, 3] - centre), turn @ T[:3, :3])
            scale *= math.exp(float(np.clip(move[6], -0.1, 0.1)))
        return T, scale

    def _normal_equations(self, T: Array, scale: float, cutoff: float) -> tuple[Array, Array, Array] | None:
        K = _scale_focal(self._K, scale)
        rows, residuals = [], []
        centre = np.mean([points.mean(axis=0) for points in self._points], axis=0) @ T[:3, :3].T + T[:3, 3]
        for points, nearest, pixels in zip(self._points, self._nearest, self._pixels, strict=True):
            in_cam = points @ T[:3, :3].T + T[:3, 3]
            in_cam = in_cam[in_cam[:, 2] > 0.05]
            if len(in_cam) < 20:
                continue
            u = in_cam[:, :2] / in_cam[:, 2:] * K[[0, 1], [0, 1]] + K[:2, 2]
            height, width = nearest.shape[:2]
            # Points outside of the picture have no mask.
            within = ((u > 0) & (u < [width - 1, height - 1])).all(axis=1)
            at = np.round(u[within]).astype(int)
            pulls = nearest[at[:, 1], at[:, 0]] - u[within]
            pulls[np.linalg.norm(pulls, axis=1) < 0.75] = 0.0
            distance, chosen = cKDTree(u).query(pixels)
            backs = pixels - u[chosen]
            backs[distance < 1.5] = 0.0
            for where, off, share in ((in_cam[within], pulls, 1.0), (in_cam[chosen], backs, len(u) / len(pixels))):
                length = np.linalg.norm(off, axis=1)
                weight = np.sqrt(share) * np.clip(1 - (length / cutoff) ** 2, 0, None)
                rows.append(_pixel_jacobian(where, K, centre) * weight[:, None, None])
                residuals.append(off * weight[:, None])
        if not rows:
            return None
        J, r = np.concatenate(rows).reshape(-1, 7), np.concatenate(residuals).reshape(-1)
        return J.T @ J, J.T @ r, centre


def _pixel_jacobian(points: Array, K: Array, centre: Array) -> Array:
    """Return how pixels (n, 2, 7) move with a turn about `centre`, a shift and the logarithm of the focal length."""
    x, y, z = points.T
    zero = np.zeros_like(z)
    by_point = np.stack(
        [
            np.stack([K[0, 0] / z, zero, -K[0, 0] * x / z**2], axis=1),
            np.stack([zero, K[1, 1] / z, -K[1, 1] * y / z**2], axis=1),
        ],
        axis=1,
    )
    arm = points - centre
    by_turn = np.cross(arm[:, None, :], by_point)
    by_focal = np.stack([K[0, 0] * x / z, K[1, 1] * y / z], axis=1)[..., None]
    found: Array = np.concatenate([by_turn, by_point, by_focal], axis=2)
    return found
