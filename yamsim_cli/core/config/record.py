"""A recording: everything that decides its bytes, and how many workers make them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from .base import Config, Name, Reference
from .randomization import RandomizationConfig
from .rig import RigConfig
from .scene import SceneConfig, Table
from .task import TaskConfig


class ImageConfig(Config):
    """Size in pixels (width, height) and JPEG quality of recorded images."""

    size_px: tuple[Annotated[int, Field(ge=16, le=4096)], Annotated[int, Field(ge=16, le=4096)]]
    jpeg_quality: int = Field(ge=1, le=100)


class RenderConfig(Config):
    """A quality: how good pictures are, and so what they cost.

    Attributes:
        multisamples: samples a pixel, which smooth edges on a GPU; 0 for none.
        supersampling: pictures are drawn this many times as wide and high, and averaged. That smooths the edges of
            shadows too, and costs less without a GPU than 4 samples a pixel do.
        shadow_map_px: edge of the shadow map in texels; 0 for no shadows.
        shadow_lights: how many of the scene's lights cast shadows, the first ones first. Each draws everything twice
            more.
        reduced_meshes: draw meshes with fewer faces where they are to be had, see `core.assets.reduction`.
        reflections: let what reflects reflect: it draws everything once more.
        slices: faces around what is round, where it is drawn as a primitive.
    """

    name: Name = "custom"
    multisamples: Literal[0, 2, 4, 8]
    supersampling: float = Field(ge=1, le=4)
    shadow_map_px: int = Field(ge=0, le=8192)
    shadow_lights: int = Field(ge=0, le=8)
    reduced_meshes: bool
    reflections: bool
    slices: int = Field(ge=8, le=128, multiple_of=4)

    def fine_size(self, size: tuple[int, int]) -> tuple[int, int]:
        """Width and height (px) in which pictures of a size are drawn."""
        return round(size[0] * self.supersampling), round(size[1] * self.supersampling)


GraspKind = Literal["weld", "contact"]

# Grippers whose fingers can hold an object by friction.
_PADS = ("linear_4310",)

# How far each finger opens, m. Source: MuJoCo Menagerie i2rt_yam, the ranges of the fingers' joints.
_OPENS: Mapping[str, float] = {"crank": 0.0375, "linear_4310": 0.0475}


class RecordConfig(Config):
    """What `yamsim record` and `yamsim pickplace batch` run.

    Attributes:
        grasp: "weld" holds the object by a constraint switched on at the grasp, as the lab's magnet does; "contact" by
            friction between a gripper's pads alone.
        episodes: how many successful episodes to record, or trials to run.
        workers: how many processes; it never changes the data.
        seed: with an attempt's number, decides everything random in it.
        wrist: also record the wrist camera.
        boards: also show the base boards and their mounts, as they are on a real arm.
        randomization: what differs between episodes beside where things start.
        truth: also record ground truth for every image, see `core.dataset.truth`.
    """

    rig: Annotated[RigConfig, Reference("rigs")]
    scene: Annotated[SceneConfig, Reference("scenes")]
    task: Annotated[TaskConfig, Reference("tasks")]
    grasp: GraspKind
    episodes: int = Field(default=500, ge=1, le=1_000_000)
    workers: int = Field(default=2, ge=1, le=1024)
    seed: int = Field(ge=0, lt=2**63)
    wrist: bool
    boards: bool = False
    truth: bool = False
    image: ImageConfig
    render: Annotated[RenderConfig, Reference("quality")]
    randomization: Annotated[RandomizationConfig, Reference("randomization")] = RandomizationConfig()

    @model_validator(mode="after")
    def _complete(self) -> RecordConfig:
        for part in ("table", "scene_camera"):
            if getattr(self.scene, part) is None:
                raise ValueError(f"scene {self.scene.name!r} has no {part}, which task {self.task.name!r} needs")
        names = [self.task.object.name, self.task.target.name, *(item.name for item in self.randomization.extras)]
        if len(set(names)) < len(names):
            raise ValueError(f"distractors and the task's objects must all differ: {', '.join(names)}")
        return self

    @model_validator(mode="after")
    def _fits_between_the_fingers(self) -> RecordConfig:
        item = self.task.object
        assert item.grasp is not None  # checked by the task
        for arm in self.rig.arms:
            if item.grasp.opening > _OPENS[arm.gripper]:
                raise ValueError(
                    f"object {item.name!r} is too wide to be picked up: {2000 * item.grasp.opening:.0f} mm, and "
                    f"gripper {arm.gripper} of rig {self.rig.name!r} opens {2000 * _OPENS[arm.gripper]:.0f} mm; "
                    "it can still be a target or a distractor"
                )
        return self

    @model_validator(mode="after")
    def _can_be_held(self) -> RecordConfig:
        if self.grasp != "contact":
            return self
        for arm in self.rig.arms:
            if arm.gripper not in _PADS:
                raise ValueError(
                    f"grasp 'contact' needs a gripper with pads ({', '.join(_PADS)}), and {arm.name} of rig "
                    f"{self.rig.name!r} has {arm.gripper}; use --rig single_linear, or grasp: weld"
                )
        grasp = self.task.object.grasp
        if grasp is None or grasp.friction is None:
            raise ValueError(
                f"grasp 'contact' needs grasp.friction of object {self.task.object.name!r}, which has none; add it, or "
                "use grasp: weld"
            )
        return self

    @property
    def table(self) -> Table:
        """The scene's table."""
        assert self.scene.table is not None
        return self.scene.table

    def data_config(self) -> dict[str, Any]:
        """Everything that decides an episode's bytes, as plain data: how many there are and who makes them does not."""
        return self.model_dump(mode="json", exclude={"episodes", "workers"})
