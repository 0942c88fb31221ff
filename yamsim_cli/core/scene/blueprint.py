"""The blueprint of a scene: the value from which `compose` makes every scene."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from ..config.objects.object_config import ObjectConfig
from ..config.randomization import RandomizationConfig
from ..config.recording import SCENE_CAMERA, RecordConfig
from ..config.rendering import RenderConfig
from ..config.rig import RigConfig
from ..config.scene import SceneConfig
from .cameras import SceneCamera, fixed_camera, station_camera, wrist_camera

# MuJoCo's `impratio` for grasps by friction. With the default of 1 an object turns by a few degrees a second in the
# hand; with 10 an object held at its end, as for a hand-over, droops by 11 degrees.
_IMPRATIO, _IMPRATIO_AT_THE_END = 10.0, 100.0


@dataclass(frozen=True)
class PictureSettings:
    """Quality and size (width, height), px, of the pictures of a scene."""

    quality: RenderConfig
    size: tuple[int, int]


@dataclass(frozen=True)
class TaskPhysics:
    """How a task's scene is stepped.

    Attributes:
        timestep: of physics, s.
        impratio: MuJoCo's `impratio` for grasps by friction; None where welds hold things.
        weld_placeholder: name of the thing for which welds are compiled, or None. At run time a weld holds any grasped thing.
    """

    timestep: float
    impratio: float | None
    weld_placeholder: str | None


@dataclass(frozen=True)
class Blueprint:
    """What a scene is composed of, beside the files of robots and meshes.

    Attributes:
        rig: the arms and their poses.
        scene: the surroundings, as wide as the rig needs.
        name: of the scene; by default the rig's.
        boards: whether there are base boards and mounts.
        background: whether there are sky, floor and lights; without these, MuJoCo's default headlight stays. A table
            belongs to the task, and always stays.
        objects: free bodies.
        randomization: the parts that it needs are added to the scene.
        physics: None keeps MuJoCo's default time step, without welds.
        cameras: in their order.
        pictures: None if nothing is rendered.
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
    """The scene of a task with its scene camera, without randomization."""
    camera = config.surroundings.scene_camera
    assert camera is not None  # checked when the config was loaded
    return Blueprint(
        rig=config.rig,
        scene=config.surroundings,
        boards=boards,
        background=background,
        objects=config.task.objects,
        physics=TaskPhysics(config.task.timing.timestep, _impratio(config), _weld_placeholder(config)),
        cameras=(fixed_camera(SCENE_CAMERA, camera),),
    )


def recording_blueprint(config: RecordConfig) -> Blueprint:
    """The scene of a recording: that of the task with all recorded cameras and the randomization."""
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
    """The thing that welds name until they hold one: any stiff thing; None without welds."""
    stiff = (item.name for item in config.task.objects if item.cloth is None)
    return next(stiff, None) if config.grasp == "weld" else None


def _impratio(config: RecordConfig) -> float | None:
    if config.grasp == "weld":
        return None
    return _IMPRATIO_AT_THE_END if config.task.held_at_the_end else _IMPRATIO
