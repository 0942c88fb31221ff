"""Photos in scenes: behind arms and objects of a fixed camera, and on the table."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import mujoco
import numpy as np
import pytest

from yamsim_cli.camera_rendering import require_fixed_plates
from yamsim_cli.core.attempt_data import Attempt, AttemptJob
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.recording import CameraEffectsEntry, RecordConfig
from yamsim_cli.core.config.scene import FixedCamera, SceneConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.attempt_payload import render_cameras
from yamsim_cli.core.episode.sampling import sample_attempt
from yamsim_cli.core.episode.simulator import Simulator
from yamsim_cli.core.errors import ConfigError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import rotation_from_vector
from yamsim_cli.core.images.jpeg import encode_jpeg
from yamsim_cli.core.scene.cameras import fixed_camera
from yamsim_cli.scene_photos.embedded_photos import Plate, decode_photo, photo_text
from yamsim_cli.scene_photos.table_texture import add_table_texture

CAMERA, SIZE = "scene_camera", (160, 120)


def photo_of_squares(width: int, height: int) -> np.ndarray:
    row, column = np.mgrid[:height, :width]
    image = np.stack([60 + column * 120 // width, 60 + row * 120 // height, 90 + 60 * ((row + column) // 20 % 2)], -1)
    return image.astype(np.uint8)


@pytest.fixture(scope="module")
def config(make_config: Callable[..., RecordConfig]) -> RecordConfig:
    return make_config({("image", "size_px"): list(SIZE), ("render",): "fast"})


def with_plate(config: RecordConfig, photo: np.ndarray) -> RecordConfig:
    plate = Plate(camera=CAMERA, photo=photo_text(encode_jpeg(photo, 98)))
    scene = config.scene.model_copy(update={"plates": (plate,)})
    return config.model_copy(update={"scene": scene})


def arm_states(simulator: Simulator) -> list[np.ndarray]:
    """Two states of the scene: as it begins, and with the arm turned."""
    start = simulator.state_replay.data.qpos.copy()
    turned = start.copy()
    turned[simulator.scene.model.joint("joint1").qposadr[0]] += 0.6
    return [start, turned]


@pytest.mark.render
def test_arms_and_objects_are_before_the_photo_and_shade_it(config: RecordConfig, locations: Locations) -> None:
    photo = photo_of_squares(*SIZE)
    shown = decode_photo(photo_text(encode_jpeg(photo, 98))).astype(int)
    images: dict[bool, list[np.ndarray]] = {}
    for plate in (False, True):
        chosen = with_plate(config, photo) if plate else config
        with Simulator(Session(chosen, locations)) as simulator:
            attempt = sample_attempt(simulator, AttemptJob(0, 0))
            states = arm_states(simulator)
            # The first state once more: no image depends on the one before it.
            images[plate] = [
                render_cameras(simulator, attempt, qpos, [CAMERA])[CAMERA].copy() for qpos in (*states, states[0])
            ]
            if plate:
                simulator.state_replay.set_state(states[0])
                ids = simulator.renderer.render_geom_ids(simulator.state_replay.data, CAMERA)
                in_front = np.append(simulator.scene.model.geom_bodyid > 0, False)[ids].astype(np.uint8)
    before, after = images[False][0].astype(int), images[True][0].astype(int)
    inside = cv2.erode(in_front, np.ones((5, 5), np.uint8)) > 0
    outside = cv2.dilate(in_front, np.ones((5, 5), np.uint8)) == 0
    np.testing.assert_array_equal(after[inside], before[inside])
    assert inside.sum() > 30
    apart = after[outside] - shown[outside]
    assert (np.abs(apart).max(axis=1) <= 1).mean() > 0.7
    assert apart.max() <= 1  # shadows only darken
    assert (apart.min(axis=1) < -15).sum() > 10
    np.testing.assert_array_equal(images[True][0], images[True][2])
    assert (images[True][0] != images[True][1]).any()


def test_a_photo_on_the_table_has_its_right_at_x_and_its_upper_edge_at_y() -> None:
    image = np.zeros((40, 60, 3), np.uint8)
    image[:20, 30:] = (255, 0, 0)
    spec = mujoco.MjSpec()
    name = add_table_texture(spec, photo_text(encode_jpeg(image, 98)), 0.0)
    spec.worldbody.add_geom(name="table", type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.3, 0.2, 0.01], material=name)
    model = spec.compile()
    pixels = model.tex_data.reshape(40, 60, 3)
    # MuJoCo's own rows: the first one is at +y of a box's upper face, seen from above.
    assert pixels[5, 50].tolist() == pytest.approx([254, 0, 0], abs=6)
    assert pixels[35, 50].max() < 10


@pytest.mark.render
def test_the_renderer_shows_the_table_photo_from_above(config: RecordConfig, locations: Locations) -> None:
    image = np.full((70, 60, 3), 40, np.uint8)
    image[:35, 30:] = (250, 40, 40)
    table = config.scene.table
    assert table is not None
    x, y, _ = table.position
    scene = config.scene.model_copy(
        update={
            "table": table.model_copy(update={"photo": photo_text(encode_jpeg(image, 98))}),
            "scene_camera": FixedCamera(position=(x, y, 1.5), look_at=(x, y, 0.0), fovy_deg=30, up=(0.0, 1.0, 0.0)),
        }
    )
    with Simulator(Session(config.model_copy(update={"scene": scene}), locations)) as simulator:
        attempt: Attempt = sample_attempt(simulator, AttemptJob(0, 0))
        seen = render_cameras(simulator, attempt, simulator.state_replay.data.qpos, [CAMERA])[CAMERA].astype(int)
    # The camera's right is +x and its up +y: the corner with the larger x and y is the upper right one.
    redness = seen[..., 0] - seen[..., 1]
    upper_right, others = redness[25:50, 95:115], [redness[70:95, 95:115], redness[70:95, 45:65]]
    assert np.median(upper_right) > 60
    assert all(np.median(each) < 30 for each in others)


def test_up_turns_the_image_of_a_fixed_camera() -> None:
    upright = FixedCamera(position=(1, 0, 1), look_at=(0, 0, 0), fovy_deg=50)
    T = fixed_camera("a", upright).T_in_body
    turned = rotation_from_vector(0.1 * T[:3, 2]) @ T[:3, 1]
    rolled = fixed_camera("a", upright.model_copy(update={"up": tuple(turned)})).T_in_body
    np.testing.assert_allclose(rolled[:3, 1], turned, atol=1e-9)
    np.testing.assert_allclose(rolled[:3, 2], T[:3, 2], atol=1e-9)


def test_a_photo_that_is_none_is_refused_in_one_line(locations: Locations, tmp_path: Any) -> None:
    file = tmp_path / "mine.yaml"
    text = locations.config_file("scenes", "tabletop").read_text()
    file.write_text(text + "plates: [{camera: scene_camera, photo: bm90aGluZw==}]\n")
    with pytest.raises(ConfigError, match="is not a JPEG or PNG as base64 text") as error:
        load_config(SceneConfig, "scenes", str(file), locations)
    assert "\n" not in str(error.value)


def test_a_camera_with_a_plate_neither_moves_nor_has_a_lens(config: RecordConfig, locations: Locations) -> None:
    chosen = with_plate(config, photo_of_squares(*SIZE))
    require_fixed_plates(chosen)
    moved = load_config(RecordConfig, "record", "default", locations, {("randomization",): ("test", "default")})
    with pytest.raises(UsageError, match="randomization 'default' moves scene_camera"):
        require_fixed_plates(chosen.model_copy(update={"randomization": moved.randomization}))
    entry = CameraEffectsEntry.model_validate({"effects": {"distortion": [-0.2, 0.0, 0.0, 0.0]}})
    with pytest.raises(UsageError, match="give scene_camera a lens"):
        require_fixed_plates(chosen.model_copy(update={"camera_effects": (entry,)}))
