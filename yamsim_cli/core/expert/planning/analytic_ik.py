"""Analytic inverse kinematics for arms with parallel axes 2, 3 and 4 whose last two axes intersect.

Source of the decomposition: A. J. Elias and J. T. Wen, "IK-Geo: Unified robot inverse kinematics using subproblem
decomposition" (Mechanism and Machine Theory 209, 2025). Notation, all at zero joints: `R_i` rotates about the axis
`h_i` of joint i through its anchor `a_i`. `h` is the direction of the parallel axes. Axes 5 and 6 meet at `c`. The
flange's motion from its pose at zero is `x -> R x + t`, the product of the six rotations. Joints 5 and 6 do not move
`c`. Joints 2 to 4 do not change components along `h`. Therefore:

- q1: `h . R_1^T (R c + t - a_1) = h . (c - a_1)`, at most two angles.
- q5: `h . R_1^T R h_6 = h . R_5 h_6`, at most two angles.
- q6: `R_6` rotates `R^T R_1 h` into `R_5^T h`.
- The sum of q2, q3 and q4: the remaining rotation, `R_1^T R R_6^T R_5^T`, is about `h`.
- q3 and q2: two links in the plane across `h` bring joint 4's anchor to a known point, with at most two postures.
"""

from __future__ import annotations

import cmath
import functools
import itertools
import math
from collections.abc import Iterator, Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...geometry.se3 import Array, invert_pose, pose

Vector = tuple[float, float, float]
Joints = tuple[float, ...]
Ids = NDArray[np.intp]

_SOLUTION_TOLERANCE = 1e-6  # m and rad, of a solution's forward kinematics
_AXIS_TOLERANCE = 1e-9  # rad and m, of axes that count as parallel or as intersecting
_COSINE_ROUNDING = 1e-9  # excess of a cosine over 1 where two solutions meet
_MIN_COEFFICIENT = 1e-7  # m or 1, smaller coefficients leave an angle undetermined; the error is below 1e-6
_SAMPLE_ANGLES = tuple(math.tau * k / 16 for k in range(16))  # rad, tried for an undetermined joint
_LIMIT_ROUNDING = 1e-7  # rad, excess of a joint over its limit
_REACH_SLACK = 1e-5  # rad and 1, extra tolerance of `may_be_reachable` over `all_solutions`: far above rounding
_VALIDATION_POSES = 20  # random poses that must be solved before an arm counts as having analytic inverse kinematics
_CACHE_SIZE = 4096  # poses whose solutions are cached: a search solves each pose up to five times
HAND_LENGTH = 0.13  # m, from the flange to the fingertips: lever that converts a rotation of the hand to a distance


class AnalyticIk:
    """Finds all joint positions that bring an arm's flange to a pose; made by `find_analytic_ik`."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        self._flange = int(model.site("tool").bodyid[0])
        self._ranges = model.jnt_range.tolist()
        # Views of MuJoCo's arrays: they change with its state.
        self._qpos, self._position = self._data.qpos, self._data.xpos[self._flange]
        self._rotation = self._data.xmat[self._flange].reshape(3, 3)
        T_flange = self.forward_kinematics(np.zeros(model.nq))
        axes, anchors = self._data.xaxis.copy(), self._data.xanchor.copy()
        h = axes[1]
        across = np.cross(h, np.eye(3)[np.argmin(np.abs(h))])
        across /= np.linalg.norm(across)
        # The third axis is h; x and y span the plane across h.
        basis = np.array([across, np.cross(h, across), h])
        self._signs = (1.0, *np.sign(axes[1:4] @ h).tolist(), 1.0, 1.0)
        self._T_zero = invert_pose(T_flange) @ pose(rotation=basis.T)
        self._T_basis = pose(rotation=basis)
        h1, h5, h6 = (basis @ axes[k] for k in (0, 4, 5))
        along = np.cross(h5, h6)
        # The point of axis 5 that is nearest to axis 6.
        share = np.cross(basis @ (anchors[5] - anchors[4]), h6) @ along / (along @ along)
        centre = basis @ anchors[4] + share * h5
        self._h1, self._h5, self._h6 = _to_vector(h1), _to_vector(h5), _to_vector(h6)
        self._h5_h6, self._along_5 = _cross(self._h5, self._h6), self._h5[2] * _dot(self._h5, self._h6)
        self._a1, self._centre, self._height = _to_vector(basis @ anchors[0]), centre, float(centre[2])
        a2, a3, a4 = (complex(*(basis @ anchors[k])[:2]) for k in (1, 2, 3))
        self._a2, self._upper, self._fore, self._wrist = a2, a3 - a2, a4 - a3, complex(*centre[:2]) - a4
        steps = np.linalg.norm(np.diff([*anchors, T_flange[:3, 3]], axis=0), axis=1)
        self._levers = np.cumsum(steps[::-1])[::-1] + HAND_LENGTH
        self._cached_solutions = functools.lru_cache(_CACHE_SIZE)(self._compute_solutions)

    def forward_kinematics(self, joints: Array) -> Array:
        """Return the flange's pose in the base at joints (6,), rad."""
        self._qpos[:] = joints
        mujoco.mj_kinematics(self._model, self._data)
        return pose(self._position, self._rotation)

    def all_solutions(self, T_flange_in_base: Array) -> Array:
        """Return all joints (n, 6), rad, within their limits that bring the flange to a pose in the base.

        Where the wrist's centre lies on the first joint's axis, or the last axis is parallel to axes 2 to 4, a joint is
        undetermined. Only 16 of its angles are tried, so an empty array does not prove that the pose is out of reach.
        """
        return self._cached_solutions(T_flange_in_base.tobytes())

    def _compute_solutions(self, T_flange_in_base: bytes) -> Array:
        T = np.frombuffer(T_flange_in_base).reshape(4, 4)
        candidates = self._candidate_joints(self._T_basis @ T @ self._T_zero)
        found = np.array([joints for joints in candidates if self._joints_reach_pose(joints, T)]).reshape(
            -1, self._model.nq
        )
        found.flags.writeable = False
        return found

    def may_be_reachable(self, T_flange_in_base: Array, margin: float) -> Array:
        """Return (n,) which flange poses (n, 4, 4) in the base may have solutions with a `margin` (rad) to all limits.

        A batch is some 30 times as fast as single poses. Its rounding differs between processors, so borderline poses
        give True.
        """
        T = self._T_basis @ T_flange_in_base @ self._T_zero
        R, wrist = T[:, :3, :3], T[:, :3, :3] @ self._centre + T[:, :3, 3] - self._a1
        h1, h5, h6 = (np.array(v) for v in (self._h1, self._h5, self._h6))
        z, x, across_6 = np.array((0.0, 0.0, 1.0)), np.array((1.0, 0.0, 0.0)), _skew_matrix(h6).T
        along_1 = self._h1[2] * (wrist @ h1)
        bent = self._upper.conjugate() * self._fore
        # Each block drops the poses whose joint is too near to a limit. `k` indexes the arrays of the previous block.
        a1, b1, c1 = wrist[:, 2] - along_1, -(wrist @ _skew_matrix(h1).T)[:, 2], self._height - self._a1[2] - along_1
        q1, number = self._solve_angles_within_limits(0, a1, b1, c1, margin)
        before_6 = np.einsum("nji,nj->ni", R[number], _rotate_all(z, h1, q1))
        a5, b5, c5 = self._h6[2] - self._along_5, self._h5_h6[2], before_6 @ h6 - self._along_5
        q5, k = self._solve_angles_within_limits(4, a5, b5, c5, margin)
        q1, number, v, u = q1[k], number[k], before_6[k] @ across_6, _rotate_all(z, h5, -q5) @ across_6
        q6 = np.arctan2(np.einsum("ni,ni->n", v @ across_6, u), np.einsum("ni,ni->n", v, u))
        is_undetermined = np.maximum(np.abs(v), np.abs(u)).max(axis=1) <= _REACH_SLACK
        k = np.flatnonzero(is_undetermined | self._within_limits(5, q6, margin))
        q1, q5, q6, number = q1[k], q5[k], q6[k], number[k]
        ahead = np.einsum("nij,nj->ni", R[number], _rotate_all(_rotate_all(x, h5, -q5), h6, -q6))
        q234 = np.angle(_complex_from_xy(_rotate_all(ahead, h1, -q1)))
        place = _complex_from_xy(_rotate_all(wrist[number], h1, -q1) + self._a1) - self._a2
        far = place - np.exp(1j * q234) * self._wrist
        c3 = (np.abs(far) ** 2 - abs(self._upper) ** 2 - abs(self._fore) ** 2) / 2
        q3, k = self._solve_angles_within_limits(2, bent.real, -bent.imag, c3, margin)
        q2 = np.angle(far[k]) - np.angle(self._upper + self._fore * np.exp(1j * q3))
        q4 = q234[k] - q2 - q3
        reached = np.zeros(len(T), bool)
        reached[number[k[self._within_limits(1, q2, margin) & self._within_limits(3, q4, margin)]]] = True
        return reached

    def _solve_angles_within_limits(
        self, joint: int, a: ArrayLike, b: ArrayLike, c: Array, margin: float
    ) -> tuple[Array, Ids]:
        """Return both angles (m,) with `a cos q + b sin q = c` that keep a margin to a joint's limits, and their
        indices into `c`.

        The angle is 0 where every angle is a solution.
        """
        length = np.hypot(a, b)
        is_undetermined = length <= _REACH_SLACK
        cosine = c / np.where(is_undetermined, 1.0, length)
        half = np.arccos(np.where(np.abs(cosine) > 1.0 + _REACH_SLACK, np.nan, np.clip(cosine, -1.0, 1.0)))
        angles = np.where(is_undetermined, 0.0, np.arctan2(b, a) + np.array((half, -half)))
        kept = np.flatnonzero(is_undetermined | self._within_limits(joint, angles, margin))
        return angles.ravel()[kept], kept % len(c)

    def _within_limits(self, joint: int, angles: Array, margin: float) -> NDArray[np.bool_]:
        low, high = self._ranges[joint]
        low, high = low + margin - _REACH_SLACK, high - margin + _REACH_SLACK
        angles = angles * self._signs[joint]
        within: NDArray[np.bool_] = angles + math.tau * np.ceil((low - angles) / math.tau) <= high
        return within

    def nearest_solution(self, solutions: Array, start: Array) -> Array:
        """Return the solution (6,) of several (n, 6), n > 0, that moves the hand least from joints `start` (6,).

        A joint's lever is the distance from its axis to the end of the stretched arm.
        """
        weighted = (solutions - start) * self._levers
        nearest: Array = solutions[np.argmin(np.einsum("ij,ij->i", weighted, weighted))]
        return nearest

    def distance_from_singularity(self, joints: Array) -> float:
        """Return the distance of joints (6,) from a singular posture, rad.

        It is the smaller of the elbow's bend, 0 for a stretched arm, and the angle between the last axis and the three
        parallel axes.
        """
        fore = self._fore * cmath.rect(1.0, self._signs[2] * float(joints[2]))
        x, y, along = _rotate_about_axis(self._h6, self._h5, float(joints[4]))
        return min(abs(cmath.phase(self._upper.conjugate() * fore)), math.atan2(math.hypot(x, y), abs(along)))

    def _candidate_joints(self, T: Array) -> Iterator[Joints]:
        """Yield joints (6,) for the flange's motion from zero, in the frame whose third axis is h."""
        rows = T[:3, :3].tolist()
        columns = tuple(zip(*rows, strict=True))
        wrist = _subtract(_to_vector(T[:3, :3] @ self._centre + T[:3, 3]), self._a1)
        along_1 = self._h1[2] * _dot(self._h1, wrist)
        for q1 in _solve_cosine_sine_equation(
            wrist[2] - along_1, -_cross(self._h1, wrist)[2], self._height - self._a1[2] - along_1
        ):
            if not (all_q1 := self._equivalent_joint_positions(0, q1)):
                continue
            before_6 = _matrix_vector_product(columns, _rotate_about_axis((0.0, 0.0, 1.0), self._h1, q1))
            x, y, _ = _rotate_about_axis(wrist, self._h1, -q1)
            place = complex(x + self._a1[0], y + self._a1[1]) - self._a2
            c5 = _dot(before_6, self._h6) - self._along_5
            for q5 in _solve_cosine_sine_equation(self._h6[2] - self._along_5, self._h5_h6[2], c5):
                if not (all_q5 := self._equivalent_joint_positions(4, q5)):
                    continue
                after_6 = _rotate_about_axis((0.0, 0.0, 1.0), self._h5, -q5)
                for q6 in _angle_between(before_6, after_6, self._h6):
                    if not (all_q6 := self._equivalent_joint_positions(5, q6)):
                        continue
                    ahead = _matrix_vector_product(
                        rows, _rotate_about_axis(_rotate_about_axis((1.0, 0.0, 0.0), self._h5, -q5), self._h6, -q6)
                    )
                    ahead = _rotate_about_axis(ahead, self._h1, -q1)
                    q234 = math.atan2(ahead[1], ahead[0])
                    for q2, q3 in self._solve_two_links(place - cmath.rect(1.0, q234) * self._wrist):
                        if (all_q3 := self._equivalent_joint_positions(2, q3)) and (
                            all_q2 := self._equivalent_joint_positions(1, q2)
                        ):
                            all_q4 = self._equivalent_joint_positions(3, q234 - q2 - q3)
                            yield from itertools.product(all_q1, all_q2, all_q3, all_q4, all_q5, all_q6)

    def _solve_two_links(self, place: complex) -> Iterator[tuple[float, float]]:
        """Yield angles of joints 2 and 3 that bring joint 4's anchor to `place`, relative to joint 2's anchor."""
        bent = self._upper.conjugate() * self._fore
        rest = (abs(place) ** 2 - abs(self._upper) ** 2 - abs(self._fore) ** 2) / 2
        for q3 in _solve_cosine_sine_equation(bent.real, -bent.imag, rest):
            yield cmath.phase(place) - cmath.phase(self._upper + self._fore * cmath.rect(1.0, q3)), q3

    def _equivalent_joint_positions(self, k: int, angle: float) -> list[float]:
        low, high = self._ranges[k]
        joint = self._signs[k] * angle
        turn = math.ceil((low - _LIMIT_ROUNDING - joint) / math.tau)
        last = math.floor((high + _LIMIT_ROUNDING - joint) / math.tau)
        turns = []
        while turn <= last:
            turns.append(min(max(joint + math.tau * turn, low), high))
            turn += 1
        return turns

    def _joints_reach_pose(self, joints: Joints, T: Array) -> bool:
        self._qpos[:] = joints
        mujoco.mj_kinematics(self._model, self._data)
        off, turn = self._position - T[:3, 3], self._rotation - T[:3, :3]
        # The Frobenius norm of a small rotation is its angle times the square root of 2.
        return bool(off @ off <= _SOLUTION_TOLERANCE**2 and np.vdot(turn, turn) <= 2 * _SOLUTION_TOLERANCE**2)


def find_analytic_ik(model: mujoco.MjModel) -> AnalyticIk | None:
    """Return an arm's analytic inverse kinematics, verified on random poses; None if the arm has none.

    The arm needs six hinge joints, (anti)parallel axes 2, 3 and 4, and intersecting axes 5 and 6.
    """
    if model.nq != 6 or (model.jnt_type != mujoco.mjtJoint.mjJNT_HINGE).any():
        return None
    data = mujoco.MjData(model)
    data.qpos[:] = 0.0
    mujoco.mj_kinematics(model, data)
    axes, anchors = data.xaxis, data.xanchor
    across = np.cross(axes[4], axes[5])
    if (
        np.abs(np.cross(axes[1], axes[2:4])).max() > _AXIS_TOLERANCE
        or np.linalg.norm(across) < _AXIS_TOLERANCE
        or abs(across @ (anchors[5] - anchors[4])) > _AXIS_TOLERANCE
    ):
        return None
    solver, (low, high) = AnalyticIk(model), model.jnt_range.T
    for joints in np.random.default_rng(0).uniform(low, high, (_VALIDATION_POSES, model.nq)):
        found = solver.all_solutions(solver.forward_kinematics(joints))
        if not len(found) or np.abs(found - joints).max(axis=1).min() > _SOLUTION_TOLERANCE:
            return None
    return solver


def _solve_cosine_sine_equation(a: float, b: float, c: float) -> tuple[float, ...]:
    """Return the angles q with `a cos q + b sin q = c`; sample angles if every angle is a solution."""
    length = math.hypot(a, b)
    if length < _MIN_COEFFICIENT:
        return _SAMPLE_ANGLES if abs(c) < _MIN_COEFFICIENT else ()
    cosine = c / length
    if abs(cosine) > 1.0 + _COSINE_ROUNDING:
        return ()
    middle, half = math.atan2(b, a), math.acos(max(-1.0, min(1.0, cosine)))
    return (middle + half, middle - half) if half else (middle,)


def _rotate_all(v: Array, axis: Array, angles: Array) -> Array:
    c, s = np.cos(angles)[:, None], np.sin(angles)[:, None]
    turned: Array = c * v + s * (v @ _skew_matrix(axis).T) + (1.0 - c) * (v @ axis)[..., None] * axis
    return turned


def _skew_matrix(axis: Array) -> Array:
    x, y, z = axis
    return np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))


def _complex_from_xy(points: Array) -> Array:
    both: Array = points[:, 0] + 1j * points[:, 1]
    return both


def _angle_between(v: Vector, u: Vector, axis: Vector) -> tuple[float, ...]:
    """Return the angle about a unit axis between two vectors; sample angles if both are parallel to it."""
    # Near a singular pose the components across the axis are short: take them first, so that products stay precise.
    v, u = _cross(axis, v), _cross(axis, u)
    if max(*map(abs, v), *map(abs, u)) < _MIN_COEFFICIENT:
        return _SAMPLE_ANGLES
    return (math.atan2(_dot(axis, _cross(v, u)), _dot(v, u)),)


def _to_vector(values: Array) -> Vector:
    x, y, z = values.tolist()
    return x, y, z


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _matrix_vector_product(rows: Sequence[Vector], v: Vector) -> Vector:
    return _dot(rows[0], v), _dot(rows[1], v), _dot(rows[2], v)


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _subtract(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _rotate_about_axis(v: Vector, axis: Vector, angle: float) -> Vector:
    """Rotate a vector about a unit axis by Rodrigues' formula."""
    c, s = math.cos(angle), math.sin(angle)
    (i, j, k), (x, y, z) = axis, v
    along = (1.0 - c) * (i * x + j * y + k * z)
    return (
        c * x + s * (j * z - k * y) + along * i,
        c * y + s * (k * x - i * z) + along * j,
        c * z + s * (i * y - j * x) + along * k,
    )
