"""Render a rig from the views a person would choose, and lay them side by side."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from ..boards.image import encode_png
from ..config.record import RenderConfig
from ..config.rig import RigConfig
from ..config.scene import SceneConfig
from ..errors import ResourceError
from ..files import refusal, write_file
from ..geometry.camera import opencv_from_mujoco
from ..geometry.se3 import quat_from_rotation
from ..resources import Locations
from ..scene.compose import Contents, Meshes, compile_spec
from ..scene.fiducials import BOARD_BODY, MOUNT_BODY
from ..scene.quality import apply_quality
from ..vision.renderer import Image, SceneRenderer
from ..vision.views import VIEWS, Camera, label, montage, place_camera, rig_points
from .compose import rig_spec

MONTAGE = "views.png"


@dataclass(frozen=True)
class Stage:
    """A rig at rest, ready to be drawn from each view.

    Attributes:
        size: width and height of a view, px.
        fine: the size in which it is drawn.
    """

    model: mujoco.MjModel
    data: mujoco.MjData
    cameras: dict[str, Camera]
    size: tuple[int, int]
    fine: tuple[int, int]

    def renderer(self) -> SceneRenderer:
        """A renderer of the views, to be closed by whoever asks for it.

        Raises:
            ResourceError: nothing can draw here.
        """
        return SceneRenderer(self.model, self.size, self.fine)


def set_stage(
    rig: RigConfig,
    scene: SceneConfig,
    quality: RenderConfig,
    size: tuple[int, int],
    locations: Locations,
    meshes: Meshes,
) -> Stage:
    """Compose a rig with a camera for each view, placed by the rig's extent.

    Args:
        size: width and height of a view, px.
    """
    spec, model = rig_spec(rig, scene, Contents(), locations, meshes)
    cameras = _cameras(rig, model, _at_home(model), size)
    for view in VIEWS:
        T = cameras[view.name].T_cam_in_world
        spec.worldbody.add_camera(
            name=view.name,
            pos=T[:3, 3],
            quat=quat_from_rotation(opencv_from_mujoco(T[:3, :3])),
            fovy=view.fovy_deg,
        )
    apply_quality(spec, quality, size)
    model = compile_spec(spec)
    return Stage(model, _at_home(model), cameras, size, quality.fine_size(size))


def _at_home(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    return data


def render_views(rig: RigConfig, stage: Stage) -> dict[str, Image]:
    """File name -> RGB image (height, width, 3): every view with its names written in, and the montage.

    Raises:
        ResourceError: nothing can draw here.
    """
    images: dict[str, Image] = {}
    with stage.renderer() as renderer:
        for name, camera in stage.cameras.items():
            texts = {text: camera.pixel(point) for text, point in _names(rig, stage.data).items()}
            title = f"{rig.name}: {name.replace('_', ' ')}"
            images[f"{name}.png"] = label(renderer.draw(stage.data, name), texts, title)
    images[MONTAGE] = montage(list(images.values()))
    return images


def write_views(images: dict[str, Image], out: Path) -> list[Path]:
    """Write images into a folder, creating it; each file is replaced whole.

    Raises:
        ResourceError: the folder cannot be written.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        for name, image in images.items():
            write_file(out / name, encode_png(image))
    except OSError as error:
        raise ResourceError(f"{out} cannot be written: {refusal(error, out)}; choose another --out") from error
    return [out / name for name in images]


def _cameras(rig: RigConfig, model: mujoco.MjModel, data: mujoco.MjData, size: tuple[int, int]) -> dict[str, Camera]:
    every = list(range(1, model.nbody))
    near_base = [
        model.body(f"{arm.prefix}{name}").id
        for arm in rig.arms
        for name, there in ((BOARD_BODY, arm.board), (MOUNT_BODY, arm.mount), ("arm", True), ("link_1", True))
        if there
    ]
    return {
        view.name: place_camera(view, rig_points(model, data, near_base if view.low else every), size) for view in VIEWS
    }


def _names(rig: RigConfig, data: mujoco.MjData) -> dict[str, np.ndarray]:
    """Text -> the point (3,) of `world` it belongs to."""
    names = {}
    for arm in rig.arms:
        names[f"{arm.name} ({arm.side})"] = data.body(f"{arm.prefix}link_3").xpos + np.array([0, 0, 0.09])
        if arm.board:
            ids = arm.board.board.ids
            # In front of the board, as the cameras see it: on it, the text would hide the markers.
            in_front = data.geom(f"{arm.prefix}{BOARD_BODY}").xpos + np.array([0.085, 0, 0])
            names[f"ids {ids[0]}-{ids[-1]}"] = in_front
    return names
