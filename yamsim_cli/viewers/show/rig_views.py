from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np

from yamsim_cli.camera_rendering import QualityRenderer
from yamsim_cli.core.config.rendering import RenderConfig
from yamsim_cli.core.config.rig import ArmConfig, RigConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.files.writing import write_outputs
from yamsim_cli.core.geometry.camera import opencv_from_mujoco
from yamsim_cli.core.geometry.se3 import pose
from yamsim_cli.core.images.image import Image
from yamsim_cli.core.images.png import encode_png
from yamsim_cli.core.rendering.renderer import SceneRenderer
from yamsim_cli.core.rendering.view_cameras import (
    RIG_VIEWS,
    PlacedCamera,
    draw_labels,
    montage,
    place_camera,
    rig_points,
)
from yamsim_cli.core.scene.blueprint import Blueprint, PictureSettings
from yamsim_cli.core.scene.cameras import WORLD_BODY, SceneCamera, add_camera
from yamsim_cli.core.scene.compilation import compile_spec
from yamsim_cli.core.scene.fiducials import BOARD_BODY, MOUNT_BODY

from .compose import compose_at_home

MONTAGE_FILE = "views.png"


@dataclass(frozen=True)
class ViewScene:
    """A rig in its home posture, with a camera for each view.

    Attributes:
        size: (width, height) of a view, px.
        quality: of the views; the model was composed for it.
    """

    rig: RigConfig
    model: mujoco.MjModel
    data: mujoco.MjData
    cameras: dict[str, PlacedCamera]
    size: tuple[int, int]
    quality: RenderConfig

    def open_renderer(self) -> SceneRenderer:
        """Return a renderer of the views, which the caller must close."""
        # Programs that filter shadows also change most other pixels by 1 of 255, see `core.rendering.shadow_shaders`.
        # Without them, images of a view remain comparable with images of earlier versions, byte by byte.
        return QualityRenderer(self.model, self.size, self.quality.model_copy(update={"smooth_shadows": False}))


def set_up_views(blueprint: Blueprint, locations: Locations, quality: RenderConfig, size: tuple[int, int]) -> ViewScene:
    """Compose a rig with a camera for each view, placed by the rig's extent. `size` is (width, height), px."""
    rig = blueprint.rig
    spec, model = compose_at_home(replace(blueprint, pictures=PictureSettings(quality, size)), locations)
    cameras = _view_cameras(rig, model, _data_at_home(model), size)
    for view in RIG_VIEWS:
        T = cameras[view.name].T_cam_in_world
        T_mujoco = pose(T[:3, 3], opencv_from_mujoco(T[:3, :3]))
        add_camera(spec, SceneCamera(view.name, WORLD_BODY, T_mujoco, view.fovy_deg))
    model = compile_spec(spec)
    return ViewScene(rig, model, _data_at_home(model), cameras, size, quality)


def _data_at_home(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_forward(model, data)
    return data


def picture_names() -> list[str]:
    """Return the file names of the images of `render_views`."""
    return [*(f"{view.name}.png" for view in RIG_VIEWS), MONTAGE_FILE]


def render_views(views: ViewScene) -> dict[str, Image]:
    """Render all labelled views, and the montage. Return file name -> RGB image (height, width, 3)."""
    rig, images = views.rig, dict[str, Image]()
    with views.open_renderer() as renderer:
        for name, camera in views.cameras.items():
            texts = {
                text: camera.project_point(point)
                for text, point in _label_positions(rig, views.model, views.data).items()
            }
            title = f"{rig.name}: {name.replace('_', ' ')}"
            images[f"{name}.png"] = draw_labels(renderer.render(views.data, name), texts, title)
    images[MONTAGE_FILE] = montage(list(images.values()))
    return images


def write_views(images: dict[str, Image], out: Path) -> list[Path]:
    """Write all images or none into a folder, created if missing. Return their paths."""
    write_outputs({out / name: encode_png(image) for name, image in images.items()}, make_folder=True)
    return [out / name for name in images]


def _view_cameras(
    rig: RigConfig, model: mujoco.MjModel, data: mujoco.MjData, size: tuple[int, int]
) -> dict[str, PlacedCamera]:
    every = list(range(1, model.nbody))
    near_base = []
    for arm in rig.arms:
        names = [*([BOARD_BODY] if arm.board else []), *([MOUNT_BODY] if arm.mount else []), arm.robot.base]
        near_base += [*(model.body(arm.prefix + name).id for name in names), _body_of_joint(model, arm, 0)]
    return {
        view.name: place_camera(view, rig_points(model, data, near_base if view.is_low_view else every), size)
        for view in RIG_VIEWS
    }


def _body_of_joint(model: mujoco.MjModel, arm: ArmConfig, joint: int) -> int:
    return int(model.jnt_bodyid[model.joint(arm.prefix + arm.robot.joint_names[joint]).id])


def _label_positions(rig: RigConfig, model: mujoco.MjModel, data: mujoco.MjData) -> dict[str, np.ndarray]:
    """Return label -> position (3,) in `world`."""
    names = {}
    for arm in rig.arms:
        names[f"{arm.name} ({arm.side})"] = data.xpos[_body_of_joint(model, arm, arm.robot.dof // 2 - 1)] + np.array(
            [0, 0, 0.09]
        )
        if arm.board:
            ids = arm.board.board_in_metres.marker_ids
            # In front of the board as seen by the cameras. On the board, the text would hide the markers.
            in_front = data.geom(f"{arm.prefix}{BOARD_BODY}").xpos + np.array([0.085, 0, 0])
            names[f"ids {ids[0]}-{ids[-1]}"] = in_front
    return names
