"""What a scene is to hold: one value, from which `compose` makes every scene there is."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from ..config.pictures import RenderConfig
from ..config.randomization import RandomizationConfig
from ..config.recording import SCENE_CAMERA, RecordConfig
from ..config.rig import RigConfig
from ..config.scene import SceneConfig
from ..config.things.thing import ObjectConfig
from .cameras import SceneCamera, fixed_camera, station_camera, wrist_camera

# How much stiffer contacts are along a surface than across it where friction alone has to hold. With MuJoCo's own 1 an
# object turns by a few degrees a second in the hand. Held at its end, as for a hand-over, it would droop by 11 degrees
# with 10. Source: MuJoCo's documentation of `impratio`.
_IMPRATIO, _IMPRATIO_AT_THE_END = 10.0, 100.0


@dataclass(frozen=True)
class Pictures:
    """What the pictures of a scene are to be like.

    Attributes:
        quality: what they may cost.
        size: width and height, px.
    """

    quality: RenderConfig
    size: tuple[int, int]


@dataclass(frozen=True)
class TaskPhysics:
    """How a scene is stepped in which a task is done.

    Attributes:
        timestep: of physics, s.
        impratio: how much stiffer contacts are along a surface, where friction alone has to hold things; None where a
            weld does.
        carried: name of the thing that welds are compiled for; None where there are none. At run time a weld holds
            whatever the hand takes.
    """

    timestep: float
    impratio: float | None
    carried: str | None


@dataclass(frozen=True)
class Blueprint:
    """What a scene is made of beside files of robots and meshes.

    Attributes:
        rig: the arms and how they stand.
        scene: what stands around them, as wide as they need it.
        name: of the scene; the rig's unless given.
        boards: whether there are base boards and mounts.
        background: whether there are sky, floor and lights; without them, MuJoCo's headlight is left as it is. A table
            belongs to the task and stays.
        objects: free bodies.
        randomization: what may differ from attempt to attempt; the scene gets the parts that this needs.
        physics: how it is stepped; None leaves MuJoCo's own time step, and has no welds.
        cameras: in their order.
        pictures: None where nothing is rendered.
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
    pictures: Pictures | None = None


def task_blueprint(config: RecordConfig, *, boards: bool = True, background: bool = True) -> Blueprint:
    """The scene in which a task is done, with its scene camera and nothing random."""
    camera = config.surroundings.scene_camera
    assert camera is not None  # checked when the config was loaded
    return Blueprint(
        rig=config.rig,
        scene=config.surroundings,
        boards=boards,
        background=background,
        objects=config.task.objects,
        physics=TaskPhysics(config.task.timing.timestep, _impratio(config), _carried(config)),
        cameras=(fixed_camera(SCENE_CAMERA, camera),),
    )


def recording_blueprint(config: RecordConfig) -> Blueprint:
    """The scene that a recording is made in: its task's, with all that it records and varies."""
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
        pictures=Pictures(config.render, size),
    )


def _carried(config: RecordConfig) -> str | None:
    """Return the thing that welds name until they hold one: any stiff thing; None if nothing is welded."""
    stiff = (item.name for item in config.task.objects if item.cloth is None)
    return next(stiff, None) if config.grasp == "weld" else None


def _impratio(config: RecordConfig) -> float | None:
    if config.grasp == "weld":
        return None
    return _IMPRATIO_AT_THE_END if config.task.held_at_the_end else _IMPRATIO
