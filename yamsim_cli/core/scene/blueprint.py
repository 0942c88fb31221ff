from __future__ import annotations

from dataclasses import dataclass, field, replace

from ...loose_pieces import loose_pieces
from ..config.objects.object_config import ObjectConfig
from ..config.randomization import RandomizationConfig
from ..config.recording import SCENE_CAMERA, RecordConfig
from ..config.rendering import RenderConfig
from ..config.rig import RigConfig
from ..config.scene import SceneConfig
from .cameras import SceneCamera, fixed_camera, station_camera, wrist_camera

# `impratio` for grasps by friction, and for objects held at one end, as for a handover. With MuJoCo's default of 1, an
# object rotates in the hand by a few degrees per second. With 10, an object held at its end droops by 11 degrees.
_IMPRATIO, _IMPRATIO_AT_THE_END = 10.0, 100.0


@dataclass(frozen=True)
class PictureSettings:
    """Render quality and size (width, height), px, of a scene's images."""

    quality: RenderConfig
    size: tuple[int, int]


@dataclass(frozen=True)
class TaskPhysics:
    """The physics options of a task's scene.

    Attributes:
        timestep: s.
        impratio: for grasps by friction; None (MuJoCo's default) if welds hold grasped objects.
        weld_placeholder: any rigid object, which each hand's inactive weld needs to compile. At run time, a weld can
            hold any object.
    """

    timestep: float
    impratio: float | None
    weld_placeholder: str | None


@dataclass(frozen=True)
class Blueprint:
    """The configs and options of a scene. `compose.compose` adds the files of robots and meshes.

    Attributes:
        scene: the environment, with a table wide enough for all arms.
        name: of the scene; by default the rig's name.
        boards: whether the scene has the marker boards beside the arms' bases, and their mounts.
        background: whether the scene has sky, floor and lights. Without them, MuJoCo's default headlight stays.
        randomization: its distractors and materials are added to the scene.
        physics: None keeps MuJoCo's default time step, without welds.
        pictures: None if the scene is not rendered.
    """

    rig: RigConfig
    scene: SceneConfig
    name: str = ""
    boards: bool = True
    background: bool = True
    objects: tuple[ObjectConfig, ...] = ()
    randomization: RandomizationConfig = field(default_factory=RandomizationConfig)
    physics: TaskPhysics | None = None
    cameras: tuple[SceneCamera, ...] = ()
    pictures: PictureSettings | None = None


def task_blueprint(config: RecordConfig, *, boards: bool = True, background: bool = True) -> Blueprint:
    """Return the blueprint of a task's scene with the fixed scene camera alone, without domain randomization."""
    camera = config.widened_scene.scene_camera
    assert camera is not None  # checked when the config was loaded
    return Blueprint(
        rig=config.rig,
        scene=config.widened_scene,
        boards=boards,
        background=background,
        objects=(*config.task.objects, *(piece for made in loose_pieces(config.task).values() for piece in made)),
        physics=TaskPhysics(config.task.timing.timestep, _impratio(config), _weld_placeholder(config)),
        cameras=(fixed_camera(SCENE_CAMERA, camera),),
    )


def recording_blueprint(config: RecordConfig) -> Blueprint:
    """Return the blueprint of a task's scene with all recorded cameras and domain randomization."""
    task, size = task_blueprint(config, boards=config.boards), config.image.size_px
    return replace(
        task,
        name=f"{config.rig.name}_{config.scene.name}_{config.task.name}",
        randomization=config.randomization,
        cameras=(
            *task.cameras,
            *(station_camera(config.rig, camera, size) for camera in config.rig.cameras),
            *(wrist_camera(arm, size) for arm in config.wrist_arms),
        ),
        pictures=PictureSettings(config.render, size),
    )


def _weld_placeholder(config: RecordConfig) -> str | None:
    stiff = (item.name for item in config.task.objects if item.cloth is None)
    return next(stiff, None) if config.grasp == "weld" else None


def _impratio(config: RecordConfig) -> float | None:
    if config.grasp == "weld":
        return None
    return _IMPRATIO_AT_THE_END if config.task.held_at_the_end else _IMPRATIO
