import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from yamsim_cli.core.geometry.camera import Intrinsics, opencv_from_mujoco, project_points
from yamsim_cli.core.geometry.se3 import pose_from_quat

cameras = st.builds(
    Intrinsics,
    width=st.just(640),
    height=st.just(480),
    fx=st.floats(100, 2000),
    fy=st.floats(100, 2000),
    cx=st.floats(0, 640),
    cy=st.floats(0, 480),
)
points_in_front = st.lists(
    st.tuples(st.floats(-2, 2), st.floats(-2, 2), st.floats(0.05, 10)), min_size=1, max_size=8
).map(np.array)


@pytest.mark.parametrize(("width", "height"), [(640, 480), (5, 3), (16, 16)])
def test_the_edges_of_the_image_lie_on_the_field_of_view(width, height):
    """A pixel's centre is an integer, so the image's edges are at -0.5 and height - 0.5."""
    fovy = math.radians(52)
    camera = Intrinsics.from_fovy(width, height, fovy)
    edge = math.tan(fovy / 2)
    assert project_points(camera.K, [0, -edge, 1])[0, 1] == pytest.approx(-0.5)
    assert project_points(camera.K, [0, edge, 1])[0, 1] == pytest.approx(height - 0.5)
    side = edge * width / height
    assert project_points(camera.K, [-side, 0, 1])[0, 0] == pytest.approx(-0.5)
    assert project_points(camera.K, [side, 0, 1])[0, 0] == pytest.approx(width - 0.5)


@given(cameras, points_in_front)
def test_projection_agrees_with_opencv(camera, points):
    expected, _ = cv2.projectPoints(points.reshape(-1, 1, 3), np.zeros(3), np.zeros(3), camera.K, None)
    assert np.allclose(project_points(camera.K, points), expected.reshape(-1, 2), rtol=1e-9, atol=1e-6)


def test_a_mujoco_camera_looks_along_its_own_minus_z_with_y_up():
    R = opencv_from_mujoco(np.eye(3))
    assert np.array_equal(R @ [0, 0, 1], [0, 0, -1])
    assert np.array_equal(R @ [0, 1, 0], [0, -1, 0])
    assert np.array_equal(R @ [1, 0, 0], [1, 0, 0])


@given(st.tuples(*[st.floats(-1, 1)] * 4).filter(lambda q: math.hypot(*q) > 1e-3))
def test_the_way_to_opencv_and_back_is_the_same_turn(q):
    R = pose_from_quat((0, 0, 0), q)[:3, :3]
    turned = opencv_from_mujoco(R)
    assert np.allclose(turned[:, 2], -R[:, 2])
    assert np.linalg.det(turned) == pytest.approx(1)
    assert np.allclose(opencv_from_mujoco(turned), R)
    assert np.array_equal(opencv_from_mujoco(R.ravel()), turned)
