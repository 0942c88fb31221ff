"""Ground truth of cloth, against the picture and against folds made by hand."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco
import numpy as np
import pytest

from tests.programs import FOLD, first_attempt, session_of
from yamsim_cli.core.dataset.dataset_paths import TRUTH_LABELS_FILE, truth_path
from yamsim_cli.core.dataset.ground_truth_files import TruthLabels, Visibility, array_faults, load_truth
from yamsim_cli.core.dataset.records import from_json
from yamsim_cli.core.episode.attempt_payload import GroundTruthCollector
from yamsim_cli.core.episode.simulator import Simulator, SimulatorCache
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.rendering.frame_truth import FrameTruth, measure_frame, rendered_cloth_sides
from yamsim_cli.core.scene.cloth import grid_triangles

pytestmark = pytest.mark.render

CAMERA = "top"
SIDES = ("top_left", "top_right", "bottom_right", "bottom_left")


@dataclass
class NapkinScene:
    """A napkin on a table; `start` is MuJoCo's positions with the napkin flat, arms away."""

    simulator: Simulator
    start: Array

    def truth(self, qpos: Array | None = None, camera: str = CAMERA) -> FrameTruth:
        simulator = self.simulator
        simulator.state_replay.set_state(self.start if qpos is None else qpos)
        T = simulator.scene.T_base_in_world
        return measure_frame(simulator.state_replay.data, camera, simulator.renderer, simulator.labels, T)

    def corners(self, truth: FrameTruth) -> dict[str, int]:
        """Return corner -> index among the keypoints."""
        names = [point.name for point in self.simulator.labels.names.keypoints]
        return {side: names.index(f"napkin_{side}") for side in SIDES}

    def visibility(self, truth: FrameTruth) -> list[Visibility]:
        return [Visibility(truth.arrays["visibility"][k]) for k in self.corners(truth).values()]

    def moved(self, points: Array) -> Array:
        """Return MuJoCo's positions with the napkin's points (9, 9, 3) in `world`."""
        cloth, qpos = self.simulator.scene.cloths["napkin"], self.start.copy()
        qpos[cloth.qpos] = points.reshape(-1, 3) - cloth.flat_points
        return qpos

    @property
    def points(self) -> Array:
        return self.simulator.scene.cloths["napkin"].points(self.start).reshape(9, 9, 3)


@pytest.fixture(scope="module", params=["640x480", "160x120"])
def stage(tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> Iterator[NapkinScene]:
    """A pixel is 2.4 mm wide at the napkin, or 10 mm, more than a layer's thickness."""
    session = session_of(tmp_path_factory.mktemp("cloth"), FOLD, truth=True, size=request.param)
    with SimulatorCache(session) as simulators:
        simulator, attempt = first_attempt(simulators)
        simulator.apply_randomization(attempt)
        yield NapkinScene(simulator, attempt.start)


def test_of_a_flat_napkin_every_point_and_corner_is_seen_from_above(stage: NapkinScene) -> None:
    truth = stage.truth()
    names = stage.simulator.labels.names
    assert names.cloths == {"napkin": (9, 9)}
    assert truth.arrays["napkin_visible"].all()
    assert stage.visibility(truth) == [Visibility.VISIBLE] * 4
    number = next(label.id for label in names.labels if label.name == "napkin")
    seen = np.argwhere(truth.labels == number)[:, ::-1]
    places = np.array([truth.arrays["keypoints"][k] for k in stage.corners(truth).values()])
    # The mask's outermost pixels are beside the corners.
    assert np.abs(places - seen[:, None]).max(axis=2).min(axis=0).max() <= 1.5
    assert np.abs(places.min(axis=0) - seen.min(axis=0)).max() <= 1.5
    assert np.abs(places.max(axis=0) - seen.max(axis=0)).max() <= 1.5
    # Left and right, and up along the y axis, as seen by an observer turned that way.
    x, y = places[1] - places[0], places[0] - places[3]
    assert x[0] * y[1] - x[1] * y[0] < 0

    k = names.objects.index("napkin")
    T = truth.arrays["T_cam_in_base"] @ truth.arrays["T_object_in_cam"][k]
    np.testing.assert_allclose(T, stage.simulator.state_replay.T_object_in_base("napkin"), atol=1e-9)
    assert truth.arrays["pixels"][names.instances.index("napkin")] == len(seen)


def test_files_hold_what_their_labels_say(stage: NapkinScene) -> None:
    simulator = stage.simulator
    truth = GroundTruthCollector(simulator.labels, [CAMERA], simulator.scene.T_base_in_world)
    simulator.state_replay.set_state(stage.start)
    for _ in range(2):
        truth.add(simulator.state_replay.data, CAMERA, simulator.renderer)
    labels = from_json(TruthLabels, truth.files[TRUTH_LABELS_FILE], TRUTH_LABELS_FILE)
    arrays = load_truth(truth.files[truth_path(CAMERA)])
    assert not array_faults(arrays, labels, 2)
    assert array_faults(arrays | {"napkin_visible": arrays["napkin_visible"][:, :80]}, labels, 2)
    assert arrays["napkin_visible"].dtype == bool


def test_of_a_napkin_in_half_the_lower_layer_is_hidden(stage: NapkinScene) -> None:
    points, radius = stage.points, stage.simulator.scene.cloths["napkin"].half_thickness
    # The upper layer reaches over the edges of the lower one, which would otherwise be seen from the side.
    fold = points[4, 4]
    points[:, 5:] = fold + 1.15 * (points[:, 3::-1] - fold) + (0, 0, 2 * radius)
    points[:, 4] += (0, 0, radius)
    truth = stage.truth(stage.moved(points))
    visible = truth.arrays["napkin_visible"].reshape(9, 9)
    assert visible[:, 5:].all()
    assert not visible[:, :4].any()
    assert stage.visibility(truth) == [
        Visibility.HIDDEN, Visibility.VISIBLE, Visibility.VISIBLE, Visibility.HIDDEN
    ]  # fmt: skip


def test_what_is_out_of_the_picture_is_outside(stage: NapkinScene) -> None:
    points = stage.points
    away = stage.truth(stage.moved(points + np.array([0.0, 5.0, 0.0])))
    assert not away.arrays["napkin_visible"].any()
    assert stage.visibility(away) == [Visibility.OUTSIDE] * 4
    assert not away.arrays["boxes"][-1].any()
    behind = stage.truth(stage.moved(points + np.array([0.0, 0.0, 5.0])))
    assert not behind.arrays["napkin_visible"].any()
    assert not behind.arrays["keypoint_depth"][list(stage.corners(behind).values())].any()


def test_under_the_table_all_of_it_is_hidden(stage: NapkinScene) -> None:
    truth = stage.truth(stage.moved(stage.points - (0.0, 0.0, 0.03)))
    assert not truth.arrays["napkin_visible"].any()
    assert stage.visibility(truth) == [Visibility.HIDDEN] * 4


def test_the_drawn_sides_are_those_that_the_renderer_draws(stage: NapkinScene) -> None:
    """A randomly bent sheet, against the triangles that MuJoCo passes to OpenGL."""
    cloth, qpos = stage.simulator.scene.cloths["napkin"], stage.start.copy()
    qpos[cloth.qpos] += np.random.default_rng(0).normal(size=cloth.qpos.shape) * 0.01
    stage.simulator.state_replay.set_state(qpos)
    model, scene = stage.simulator.scene.model, mujoco.MjvScene(stage.simulator.scene.model, 1000)
    everything = mujoco.mjtCatBit.mjCAT_ALL.value
    data = stage.simulator.state_replay.data
    mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, mujoco.MjvCamera(), everything, scene)
    drawn = np.array(scene.flexface[: 9 * scene.flexfaceused[0]]).reshape(-1, 3)
    for side in rendered_cloth_sides(cloth.points(qpos), grid_triangles(*cloth.grid), cloth.half_thickness):
        assert np.abs(drawn[None] - side[:, None]).max(axis=2).min(axis=1).max() < 1e-6
