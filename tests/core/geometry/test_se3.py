import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from yamsim_cli.core.geometry.se3 import (
    interpolate_rotation,
    invert_pose,
    pose,
    pose_from_quat,
    quat_from_rotation,
    rotation_between,
    rotation_from_vector,
    rotation_vector,
    rotation_z,
    tilt_angle,
    yaw,
)

SMALL = 1e-12

coordinates = st.floats(-10, 10)
positions = st.tuples(coordinates, coordinates, coordinates)
quaternions = st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 1e-3)
rotations = quaternions.map(lambda q: pose_from_quat((0, 0, 0), q)[:3, :3])
poses = st.builds(pose_from_quat, positions, quaternions)
axes = (
    st.tuples(*[st.floats(-1, 1)] * 3)
    .filter(lambda v: math.hypot(*v) > 1e-3)
    .map(lambda v: np.array(v) / math.hypot(*v))
)


def rodrigues(axis: np.ndarray, angle: float) -> np.ndarray:
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


def angle_between(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.linalg.norm(rotation_vector(one.T @ other)))


def test_poses_compose_as_their_names_say():
    """A point on a hand: the hand 1 m above a base that stands at x = 2 m and points along +y."""
    T_base_in_world = pose((2, 0, 0), rotation_z(math.pi / 2))
    T_hand_in_base = pose((0.3, 0, 1.0))
    T_hand_in_world = T_base_in_world @ T_hand_in_base
    assert np.allclose(T_hand_in_world @ [0.1, 0, 0, 1], [2, 0.4, 1, 1], atol=SMALL)
    assert np.allclose(invert_pose(T_base_in_world) @ T_hand_in_world, T_hand_in_base, atol=SMALL)


@given(poses)
def test_the_inverse_undoes_a_pose_from_both_sides(T):
    assert np.allclose(invert_pose(T), np.linalg.inv(T), atol=1e-9)


@given(quaternions, st.floats(0.01, 100))
def test_the_length_and_the_sign_of_a_quaternion_do_not_matter(q, factor):
    reference = pose_from_quat((0, 0, 0), q)
    assert np.allclose(pose_from_quat((0, 0, 0), np.array(q) * factor), reference, atol=SMALL)
    assert np.allclose(pose_from_quat((0, 0, 0), -np.array(q)), reference, atol=SMALL)


def test_quaternions_are_wxyz():
    half = math.sqrt(0.5)
    assert np.allclose(pose_from_quat((0, 0, 0), (half, 0, 0, half))[:3, :3], rotation_z(math.pi / 2), atol=SMALL)
    assert np.allclose(quat_from_rotation(rotation_z(math.pi / 2)), [half, 0, 0, half], atol=SMALL)


def test_a_zero_quaternion_is_refused():
    with pytest.raises(ValueError, match="zero quaternion"):
        pose_from_quat((0, 0, 0), (0, 0, 0, 0))


@given(rotations)
def test_a_rotation_survives_the_way_through_a_quaternion(R):
    q = quat_from_rotation(R)
    assert np.linalg.norm(q) == pytest.approx(1)
    assert q[0] >= 0
    assert np.allclose(pose_from_quat((0, 0, 0), q)[:3, :3], R, atol=SMALL)


@given(axes)
def test_the_quaternion_of_a_half_turn_is_its_axis(axis):
    R = 2 * np.outer(axis, axis) - np.eye(3)
    q = quat_from_rotation(R)
    assert q[0] == pytest.approx(0, abs=1e-8)
    assert abs(q[1:] @ axis) == pytest.approx(1, abs=SMALL)


@given(axes, st.floats(1e-9, 1e-6))
def test_rotations_close_to_a_half_turn_keep_their_precision(axis, missing):
    R = rodrigues(axis, math.pi - missing)
    assert np.allclose(pose_from_quat((0, 0, 0), quat_from_rotation(R))[:3, :3], R, atol=SMALL)


@given(axes, st.floats(0, math.pi - 1e-6))
def test_a_rotation_vector_is_axis_times_angle(axis, angle):
    assert np.allclose(rotation_from_vector(axis * angle), rodrigues(axis, angle), atol=1e-11)
    assert np.allclose(rotation_vector(rodrigues(axis, angle)), axis * angle, atol=1e-9)


@given(axes, axes)
def test_a_rotation_between_vectors_turns_one_onto_the_other_by_their_angle(start, end):
    R = rotation_between(start, end)
    assert np.allclose(R @ start, end, atol=1e-8)
    assert np.linalg.norm(rotation_vector(R)) == pytest.approx(math.acos(np.clip(start @ end, -1, 1)), abs=1e-6)


def test_rotations_between_parallel_and_opposite_vectors():
    x = np.array([1.0, 0.0, 0.0])
    assert np.array_equal(rotation_between(x, x), np.eye(3))
    assert np.allclose(rotation_between(x, -x) @ x, -x, atol=SMALL)


@given(rotations, axes, st.floats(0, 3.1), st.floats(0, 1))
def test_interpolation_covers_the_given_part_of_the_shortest_arc(start, axis, angle, fraction):
    end = start @ rodrigues(axis, angle)
    between = interpolate_rotation(start, end, fraction)
    assert angle_between(start, between) == pytest.approx(fraction * angle, abs=1e-8)
    assert angle_between(between, end) == pytest.approx((1 - fraction) * angle, abs=1e-8)


@given(st.floats(0, math.pi), st.floats(-math.pi, math.pi))
def test_tilt_is_the_angle_from_upright_whatever_the_heading(angle, heading):
    leaning = rotation_z(heading) @ rodrigues(np.array([1.0, 0, 0]), angle)
    assert tilt_angle(leaning) == pytest.approx(angle, abs=1e-7)


def test_tilt_bears_a_cosine_just_outside_its_range():
    assert tilt_angle(np.diag([1, 1, 1 + 1e-15])) == 0
    assert tilt_angle(np.diag([1, -1, -1 - 1e-15])) == math.pi


@given(st.floats(-3.14, 3.14), positions)
def test_yaw_is_the_heading_of_the_x_axis(angle, position):
    assert yaw(pose(position, rotation_z(angle))) == pytest.approx(angle, abs=SMALL)
    assert yaw(pose(position, rotation_z(angle) @ np.diag([1, -1, -1]))) == pytest.approx(angle, abs=SMALL)
