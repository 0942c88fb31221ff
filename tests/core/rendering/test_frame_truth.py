"""Ground truth against geometry, rays, and the picture."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import mujoco
import numpy as np
import pytest

from tests.attempts import start_of
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.dataset.ground_truth_files import KeypointRecord, Visibility
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.camera import Intrinsics, opencv_from_mujoco, project_points
from yamsim_cli.core.geometry.se3 import Array, invert_pose, pose
from yamsim_cli.core.images.png import decode_labels, encode_labels
from yamsim_cli.core.rendering.frame_truth import FrameTruth, instance_boxes, is_visible, measure_frame
from yamsim_cli.core.rendering.renderer import SceneRenderer
from yamsim_cli.core.rendering.scene_labels import LabelledKeypoint, SceneLabels, make_scene_labels
from yamsim_cli.core.sim.state_replay import StateReplay

pytestmark = pytest.mark.render

CAMERA, WRIST = "scene_camera", "right_wrist_camera"
SIZE = (640, 480)
# Turned, so that each link is seen from many sides.
POSES = ([0, 1.92, 2.22, -1.55, 0, 0], [0.9, 1.2, 1.5, -0.5, 0.4, 1.0], [-1.2, 1.6, 1.2, 0.8, -0.6, -1.5])


@dataclass
class TruthScene:
    """A scene to measure: `truth` is of its present state; `start` is MuJoCo's positions at the start."""

    replica: StateReplay
    renderer: SceneRenderer
    labels: SceneLabels
    config: RecordConfig
    start: Array

    def pose(self, joints: list[float]) -> None:
        qpos, arm = self.start.copy(), self.replica.scene.first_arm
        qpos[arm.joint_qpos] = joints
        qpos[arm.fingers.qpos] = 0.0375 * arm.fingers.sign
        self.replica.set_state(qpos)

    def truth(self, camera: str = CAMERA) -> FrameTruth:
        scene = self.replica.scene
        return measure_frame(self.replica.data, camera, self.renderer, self.labels, scene.T_base_in_world)

    def T_cam_in_world(self, camera: str = CAMERA) -> Array:
        view = self.replica.data.cam(camera)
        return pose(view.xpos, opencv_from_mujoco(view.xmat))

    def points_in_world(self, truth: FrameTruth, pixels: np.ndarray) -> Array:
        """Points in `world` of pixels (n, 2), (column, row), by the depth image."""
        K = self.renderer.intrinsics(CAMERA).K
        z = truth.depth_mm[pixels[:, 1], pixels[:, 0]] / 1000.0
        rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(K).T
        return np.asarray((rays * z[:, None]) @ self.T_cam_in_world()[:3, :3].T + self.T_cam_in_world()[:3, 3])

    def ray(self, u: int, v: int) -> float:
        """Distance z of the first hit of a ray through a pixel's middle, m: depth without rendering."""
        K, T = self.renderer.intrinsics(CAMERA).K, self.T_cam_in_world()
        direction = T[:3, :3] @ np.linalg.inv(K) @ (u, v, 1.0)
        model, groups = self.replica.scene.model, np.array([1, 1, 1, 0, 0, 0], np.uint8)
        geom = np.zeros(1, np.int32)
        return mujoco.mj_ray(model, self.replica.data, T[:3, 3], direction, groups, True, -1, geom)

    def number(self, name: str) -> int:
        return next(label.id for label in self.labels.names.labels if label.name == name)


@pytest.fixture(scope="module")
def stage(make_config: Callable[..., RecordConfig], locations: Locations) -> Iterator[TruthScene]:
    config = make_config({("wrist",): True, ("boards",): True, ("image", "size_px"): SIZE, ("render",): "fast"})
    simulator = Simulator(Session(config, locations))
    model = simulator.scene.model
    labels = make_scene_labels(model, config.rig, ("banana", "plate"), boards=True)
    with SceneRenderer(model, SIZE) as renderer:
        stage = TruthScene(simulator.state_replay, renderer, labels, config, start_of(simulator))
        stage.pose(POSES[0])
        yield stage


def seen(stage: TruthScene, joints: list[float], kind: str, camera: str = CAMERA) -> Iterator[tuple[int, FrameTruth]]:
    stage.pose(joints)
    truth = stage.truth(camera)
    for k, record in enumerate(stage.labels.names.keypoints):
        if record.kind == kind and truth.arrays["visibility"][k] == Visibility.VISIBLE:
            yield k, truth


def test_labels_name_what_is_seen(stage: TruthScene) -> None:
    names = stage.labels.names
    assert [label.id for label in names.labels] == list(range(len(names.labels)))
    assert names.links == [
        "arm", *(f"link_{k}" for k in range(1, 7)), "link_left_finger", "link_right_finger"
    ]  # fmt: skip
    assert names.objects == ["banana", "plate", "base_board", "base_mount"]
    assert names.instances == ["table", "posts", "arm1", *names.objects]
    truth = stage.truth()
    model = stage.replica.scene.model
    for name in ("banana", "plate", "base_board"):
        body = model.body(name)
        middle = stage.replica.data.body(name).xpos if name != "base_board" else stage.replica.data.geom(name).xpos
        assert body.id
        u, v = project_points(
            stage.renderer.intrinsics(CAMERA).K, transform(invert_pose(stage.T_cam_in_world()), middle)
        )[0]
        assert truth.labels[round(v), round(u)] == stage.number(name), name


def transform(T: Array, point: Array) -> Array:
    return np.asarray(T[:3, :3] @ point + T[:3, 3])


def test_labels_are_those_of_the_geoms(stage: TruthScene) -> None:
    ids = stage.renderer.render_geom_ids(stage.replica.data, CAMERA)
    expected = np.append(stage.labels.label_of_geom, 0)[ids]
    np.testing.assert_array_equal(stage.truth().labels, expected)


def test_depth_of_the_table_lies_on_its_plane(stage: TruthScene) -> None:
    truth = stage.truth()
    inside = cv2.erode((truth.labels == stage.number("table")).astype(np.uint8), np.ones((3, 3), np.uint8))
    rows, columns = np.nonzero(inside)
    points = stage.points_in_world(truth, np.column_stack([columns, rows]))
    top = stage.config.widened_table.top_height
    # The table's front edge is seen as well.
    upper = points[
        points[:, 0] < stage.config.widened_table.position[0] + stage.config.widened_table.half_size[0] - 0.003
    ]
    assert len(upper) > 50_000
    assert np.abs(upper[:, 2] - top).max() < 0.001


def test_depth_of_the_board_lies_on_its_plane(stage: TruthScene) -> None:
    truth = stage.truth()
    inside = cv2.erode((truth.labels == stage.number("base_board")).astype(np.uint8), np.ones((3, 3), np.uint8))
    rows, columns = np.nonzero(inside)
    assert len(rows) > 300
    board = stage.config.rig.arms[0].board
    T = stage.config.rig.T_base_in_world(0) @ stage.config.rig.arms[0].T_board_in_base
    points = stage.points_in_world(truth, np.column_stack([columns, rows]))
    in_board = (points - T[:3, 3]) @ T[:3, :3]
    assert np.abs(in_board[:, 2]).max() < 0.001
    assert (np.abs(in_board[:, 0]) < board.board_in_metres.width / 2).all()


def test_nothing_is_0_mm_away(stage: TruthScene) -> None:
    stage.pose(POSES[0])
    truth = stage.truth(WRIST)
    model, data = stage.replica.scene.model, stage.replica.data
    sky = stage.renderer.render_geom_ids(data, WRIST) == -1
    assert truth.depth_mm.dtype == np.uint16
    if sky.any():
        assert (truth.depth_mm[sky] == 0).all()
    assert (truth.depth_mm[~sky] > 0).all()
    assert model.geom("safety_plane").id in stage.renderer.render_geom_ids(data, CAMERA)


@pytest.mark.parametrize("joints", POSES)
@pytest.mark.parametrize("kind", ["axis", "corner"])
def test_a_visible_point_of_a_surface_lies_on_its_body_and_agrees_with_depth(
    stage: TruthScene, joints: list[float], kind: str
) -> None:
    count = 0
    for k, truth in seen(stage, joints, kind):
        u, v = np.rint(truth.arrays["keypoints"][k]).astype(int)
        number = stage.number(stage.labels.names.keypoints[k].body)
        reach = 1 if kind == "corner" else 0
        part = np.s_[v - reach : v + reach + 1, u - reach : u + reach + 1]
        assert number in truth.labels[part]
        # Half a pixel on a slanted surface adds to the 2 mm tolerance of depth.
        apart = np.abs(truth.depth_mm[part][truth.labels[part] == number] / 1000 - truth.arrays["keypoint_depth"][k])
        assert apart.min() < 0.004
        if kind == "axis":
            assert abs(truth.depth_mm[v, u] / 1000 - stage.ray(u, v)) < 0.002
        count += 1
    assert count >= (1 if kind == "axis" else 4)


@pytest.mark.parametrize("joints", POSES)
def test_a_point_of_a_surface_is_visible_just_where_a_ray_reaches_it(stage: TruthScene, joints: list[float]) -> None:
    """A ray from the camera through the whole scene finds occluders independently."""
    stage.pose(joints)
    truth = stage.truth()
    model, data = stage.replica.scene.model, stage.replica.data
    start = stage.T_cam_in_world()[:3, 3]
    checked = 0
    for point, visibility, z in zip(
        stage.labels.keypoints, truth.arrays["visibility"], truth.arrays["keypoint_depth"], strict=True
    ):
        if point.record.kind != "axis" or visibility == Visibility.OUTSIDE:
            continue
        target = data.xmat[point.body].reshape(3, 3) @ point.position + data.xpos[point.body]
        geom = np.zeros(1, np.int32)
        distance = mujoco.mj_ray(
            model, data, start, target - start, np.array([1, 1, 1, 0, 0, 0], np.uint8), True, -1, geom
        )
        # As a share of the way to the point: 1 without an occluder.
        gap = (1 - distance) * z
        normal = data.xmat[point.body].reshape(3, 3) @ point.normal
        if (normal @ (start - target)) / np.linalg.norm(start - target) < 0.2:
            continue
        if gap < 0.002 and model.geom_bodyid[geom[0]] == point.body:
            assert visibility == Visibility.VISIBLE, point.record.name
        elif gap > 0.008:
            assert visibility == Visibility.HIDDEN, point.record.name
        checked += 1
    assert checked >= 2


@pytest.mark.parametrize("joints", POSES)
def test_a_visible_joint_lies_on_a_link_it_joins(stage: TruthScene, joints: list[float]) -> None:
    model, count = stage.replica.scene.model, 0
    for k, truth in seen(stage, joints, "joint"):
        record = stage.labels.names.keypoints[k]
        link = model.body(record.body).id
        u, v = np.rint(truth.arrays["keypoints"][k]).astype(int)
        name = stage.labels.names.labels[truth.labels[v, u]].name
        assert name in (record.body, model.body(int(model.body_parentid[link])).name)
        # The visible surface is in front of the centre, by at most the link's thickness.
        assert 0 < truth.arrays["keypoint_depth"][k] - truth.depth_mm[v, u] / 1000 < 0.0705
        count += 1
    assert count >= 2


def test_a_point_behind_an_object_is_hidden(stage: TruthScene) -> None:
    """The plate, set up before the board, hides it."""
    stage.pose(POSES[0])
    corners = [k for k, record in enumerate(stage.labels.names.keypoints) if record.kind == "corner"]
    assert (stage.truth().arrays["visibility"][corners] == Visibility.VISIBLE).all()
    scene, data = stage.replica.scene, stage.replica.data
    qpos = data.qpos.copy()
    at = scene.object_qpos["plate"]
    board = data.geom("base_board").xpos
    qpos[at : at + 3] = board + 0.2 * (stage.T_cam_in_world()[:3, 3] - board)
    stage.replica.set_state(qpos)
    assert (stage.truth().arrays["visibility"][corners] == Visibility.HIDDEN).all()
    # The wrist camera points elsewhere.
    assert (stage.truth(WRIST).arrays["visibility"][corners] == Visibility.OUTSIDE).all()


def test_poses_are_those_of_the_bodies_in_the_camera(stage: TruthScene) -> None:
    stage.pose(POSES[1])
    truth = stage.truth()
    T_cam = stage.config.rig.T_base_in_world(0) @ truth.arrays["T_cam_in_base"]
    for names, key in ((stage.labels.names.links, "T_link_in_cam"), (stage.labels.names.objects, "T_object_in_cam")):
        for name, T in zip(names, truth.arrays[key], strict=True):
            body = stage.replica.data.body(name)
            np.testing.assert_allclose(T_cam @ T, pose(body.xpos, body.xmat.reshape(3, 3)), atol=1e-12)


def test_boxes_are_tight_around_what_is_seen(stage: TruthScene) -> None:
    stage.pose(POSES[0])
    truth = stage.truth()
    names = stage.labels.names
    assert (truth.arrays["pixels"] > 0).all()
    for k, instance in enumerate(names.instances):
        parts = [label.id for label in names.labels if label.instance == instance]
        rows, columns = np.nonzero(np.isin(truth.labels, parts))
        box = (columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
        assert tuple(truth.arrays["boxes"][k]) == box, instance
        assert truth.arrays["pixels"][k] == len(rows)


def test_an_object_out_of_sight_has_an_empty_box() -> None:
    boxes, pixels = instance_boxes(np.zeros((4, 6), np.uint8), np.array([-1, 0, 1, 1]), 2)
    assert not boxes.any()
    assert not pixels.any()
    image = np.zeros((4, 6), np.uint8)
    image[3, 5], image[1, 0] = 2, 3
    boxes, pixels = instance_boxes(image, np.array([-1, 0, 1, 1]), 2)
    assert boxes.tolist() == [[0, 0, 0, 0], [0, 1, 6, 4]]
    assert pixels.tolist() == [0, 2]


def test_truth_lies_on_the_picture(stage: TruthScene) -> None:
    """Only the banana is yellow: its mask in the picture equals the segmentation, except for its edge."""
    stage.pose(POSES[0])
    image = stage.renderer.render(stage.replica.data, CAMERA).astype(int)
    yellow = (image[..., 0] > image[..., 2] + 60) & (image[..., 1] > image[..., 2] + 35)
    mask = stage.truth().labels == stage.number("banana")
    both, either = (yellow & mask).sum(), (yellow | mask).sum()
    assert mask.sum() > 300
    assert both / either > 0.75


def test_label_images_come_back(stage: TruthScene) -> None:
    labels = stage.truth().labels
    found = decode_labels(encode_labels(labels))
    np.testing.assert_array_equal(found, labels)
    assert decode_labels(encode_labels(labels)[:-1]) is None
    assert decode_labels(b"") is None


@pytest.mark.parametrize(
    ("nearer_mm", "slant", "seen"),
    [(0, 0.0, True), (1, 0.0, True), (5, 0.0, False), (-5, 0.0, False), (0, 1.0, True), (5, 1.0, False)],
)
def test_the_same_body_in_front_of_a_point_hides_it(nearer_mm: int, slant: float, seen: bool) -> None:
    """One body's plane fills the picture; the point lies on it, or behind it."""
    lens = Intrinsics(32, 24, 100.0, 100.0, 15.5, 11.5)
    p, normal = np.array([0.004, 0.003, 1.0]), np.array([slant, 0.0, -1.0]) / np.hypot(slant, 1.0)
    v, u = np.mgrid[:24, :32]
    rays = np.stack([(u - 15.5) / 100, (v - 11.5) / 100, np.ones(u.shape)], axis=-1)
    depth = np.rint(1000 * (normal @ p) / (rays @ normal)) - nearer_mm
    point = LabelledKeypoint(KeypointRecord(name="point", body="link", kind="axis"), 1, np.zeros(3), normal, (7,))
    pixel = tuple(np.rint(lens.project(p)[0]).astype(int).tolist())
    labels = np.full((24, 32), 7, np.uint8)
    assert is_visible(point, p, normal, lens, pixel, labels, depth.astype(np.uint16)) == seen
    assert not is_visible(point, p, -normal, lens, pixel, labels, depth.astype(np.uint16))
    assert not is_visible(point, p, normal, lens, pixel, labels + np.uint8(1), depth.astype(np.uint16))
