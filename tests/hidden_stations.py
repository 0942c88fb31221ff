"""Photos of stations whose light, table, floor and camera are known to the test alone."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import mujoco
import numpy as np

from yamsim_cli.camera_effects.lens_distortion import LensWarp
from yamsim_cli.core.attempt_data import ArmPosture
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rendering import RenderConfig
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import Light, SceneConfig
from yamsim_cli.core.config.variation import SurfaceSample
from yamsim_cli.core.files.documents.yaml_document import dump_yaml
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.files.writing import write_file
from yamsim_cli.core.geometry.camera import CameraModel, opencv_from_mujoco
from yamsim_cli.core.geometry.se3 import Array, pose, quat_from_rotation, rotation_from_vector
from yamsim_cli.core.images.jpeg import encode_jpeg
from yamsim_cli.core.images.png import encode_png
from yamsim_cli.core.scene.cameras import WORLD_BODY, SceneCamera
from yamsim_cli.core.scene.randomized_model import texture_image
from yamsim_cli.match.station_renderer import StationRenderer
from yamsim_cli.scene_photos.embedded_photos import photo_text

# Renders a model's camera of a name in a size (width, height), px, at positions (nq,), as RGB (height, width, 3).
RenderPositions = Callable[[mujoco.MjModel, Sequence[Array], str, tuple[int, int]], list[np.ndarray]]
NOISE, BLUR, JPEG = 2.0, 0.5, 92  # grey levels, px, quality
_TEXTURES = ("plain", "wood", "concrete", "noise", "marble", "terrazzo")
# Another renderer setting than the one that matches: finer shadows and edges, and whole meshes.
PHOTO_QUALITY = RenderConfig(
    name="photo",
    multisamples=0,
    supersampling=2,
    shadow_map_px=4096,
    shadow_lights=1,
    reduced_meshes=False,
    reflections=False,
    slices=28,
)


@dataclass(frozen=True)
class HiddenStation:
    """A station. `scene` has its table and light, `direction` (3,) is that of its light, in `world`."""

    rig: RigConfig
    scene: SceneConfig
    direction: Array
    camera: CameraModel
    T_cam_in_world: Array
    postures: tuple[tuple[ArmPosture, ...], ...]


def hidden_station(
    seed: int, locations: Locations, photos: int = 3, size: tuple[int, int] = (640, 480)
) -> HiddenStation:
    """Return a station with everything random: light, colours, texture of the table, camera and postures."""
    rng = np.random.default_rng([seed, 77])
    rig = load_config(RigConfig, "rigs", "single", locations)
    base = load_config(SceneConfig, "scenes", "tabletop", locations)
    assert base.table is not None
    up, around = math.radians(rng.uniform(30, 80)), rng.uniform(-math.pi, math.pi)
    direction = np.array([-math.cos(up) * math.cos(around), -math.cos(up) * math.sin(around), -math.sin(up)])
    tint = 1 + rng.uniform(-0.15, 0.15, 3)
    ambient, diffuse = rng.uniform(0.2, 0.35) * tint, rng.uniform(0.35, 0.6) * tint[::-1]
    colours = tuple(rng.uniform(0.3, 0.85, 3))
    surface = SurfaceSample(
        str(rng.choice(_TEXTURES)), (colours, tuple(0.75 * np.array(colours))), int(rng.integers(2, 6)), seed
    )
    photo = photo_text(encode_jpeg(texture_image(surface, 512), 95))
    table = base.table.model_copy(update={"photo": photo, "reflectance": 0.0})
    floor = tuple(tuple(rng.uniform(0.2, 0.7) * np.ones(3)) for _ in range(2))
    light = Light.model_validate({"direction": tuple(direction), "diffuse": tuple(diffuse), "castshadow": True})
    scene = base.model_copy(
        update={"table": table, "floor_rgba": floor, "lights": (light,), "ambient": tuple(map(float, ambient))}
    )
    width, height = size
    focal = 0.94 * width * rng.uniform(0.9, 1.1)
    K = ((focal, 0.0, width / 2 + 6), (0.0, 0.998 * focal, height / 2 - 5), (0.0, 0.0, 1.0))
    camera = CameraModel(width, height, K, (-0.1, 0.03, 0.0, 0.0, 0.0))
    target = np.array([0.33, 0.0, 0.1]) + rng.uniform(-0.05, 0.05, 3)
    turn = rng.uniform(-0.7, 0.7)
    place = target + rng.uniform(0.9, 1.15) * np.array([math.cos(turn), math.sin(turn), rng.uniform(0.5, 0.9)])
    z = (target - place) / np.linalg.norm(target - place)
    x = np.cross(z, (0.0, 0.0, 1.0)) / np.linalg.norm(np.cross(z, (0.0, 0.0, 1.0)))
    R = np.column_stack([x, np.cross(z, x), z]) @ rotation_from_vector((0.0, 0.0, rng.uniform(-0.05, 0.05)))
    postures = tuple(
        (ArmPosture(np.array([turn, rng.uniform(0.6, 1.4), rng.uniform(0.7, 1.3), *rng.uniform(-0.3, 0.3, 3)]), 0.02),)
        for turn in np.linspace(-0.9, 0.9, photos) + rng.uniform(-0.15, 0.15, photos)
    )
    return HiddenStation(rig, scene, direction, camera, pose(place, R), postures)


def take_photos(
    station: HiddenStation, locations: Locations, seed: int = 0, render: RenderPositions | None = None
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return an RGB photo (height, width, 3) and the mask of the arms (height, width) for each posture.

    Args:
        render: renders the images in place of `StationRenderer`, which always makes the masks.
    """
    warp = LensWarp(station.camera, 2)
    size = warp.ideal.width, warp.ideal.height
    T = station.T_cam_in_world
    view = SceneCamera("photo", WORLD_BODY, pose(T[:3, 3], opencv_from_mujoco(T[:3, :3])), math.degrees(warp.fovy))
    rng = np.random.default_rng(seed)
    images, masks, positions = [], [], []
    with StationRenderer(station.rig, station.scene, PHOTO_QUALITY, view, size, locations) as renderer:
        for posture in station.postures:
            renderer.set_postures(posture)
            positions.append(renderer._data.qpos.copy())
            if render is None:
                images.append(renderer.render())
            masks.append(warp.distort_picture(renderer.masks()[0].astype(np.uint8), nearest=True) > 0)
        if render is not None:
            images = render(renderer._model, positions, view.name, size)
    taken = []
    for image, mask in zip(images, masks, strict=True):
        clean = cv2.GaussianBlur(warp.distort_picture(image), (0, 0), BLUR)
        noisy = np.clip(clean + rng.normal(0, NOISE, clean.shape), 0, 255).round().astype(np.uint8)
        taken.append((noisy, mask))
    return taken


def write_station(station: HiddenStation, locations: Locations, folder: Path, masks: Path, photos: int) -> None:
    """Write the first photos and their masks, and the calibration and joints beside `folder`."""
    for k, (photo, mask) in enumerate(take_photos(station, locations)[:photos]):
        write_file(folder / f"photo_{k}.jpg", encode_jpeg(photo, JPEG))
        write_file(masks / f"photo_{k}.png", encode_png(np.where(mask, 255, 0).astype(np.uint8)))
    write_file(folder.parent / "calibration.yaml", calibration_of(station).encode())
    rows = [[*posture[0].joints.tolist(), posture[0].opening] for posture in station.postures[:photos]]
    np.save(folder.parent / "joints.npy", np.array(rows))


def calibration_of(station: HiddenStation) -> str:
    """Return the text of a calibration.yaml with the true camera and arm."""
    (arm,) = station.rig.arms
    zeros, dof = [0.0, 0.0, 0.0], arm.robot.dof
    T = np.linalg.inv(station.rig.T_base_in_world(0)) @ station.T_cam_in_world
    camera = {
        "name": "scene_camera",
        "position": T[:3, 3].tolist(),
        "quat": quat_from_rotation(T[:3, :3]).tolist(),
        "width": station.camera.width,
        "height": station.camera.height,
        "K": [list(row) for row in station.camera.K],
        "distortion": list(station.camera.distortion),
        "focal": "given",
        "position_95_mm": zeros,
        "rotation_95_deg": zeros,
        "focal_95_percent": 0.0,
        "delay_ms": 0.0,
        "delay_95_ms": 0.0,
        "frames": 0,
        "outline_px": 0.0,
    }
    placed = {
        "name": arm.name,
        "position": zeros,
        "quat": [1.0, 0.0, 0.0, 0.0],
        "position_95_mm": zeros,
        "rotation_95_deg": zeros,
        "joint_offsets_deg": [0.0] * dof,
        "joint_offsets_95_deg": [0.0] * dof,
        "joint_offsets_estimated": [False] * dof,
    }
    return dump_yaml({"rig": station.rig.name, "reference": arm.name, "cameras": [camera], "arms": [placed]})
