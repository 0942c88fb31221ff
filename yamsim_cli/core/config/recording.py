"""A recording: everything that decides its bytes, and how many workers make them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, FiniteFloat, model_validator

from ..shown_meshes import PATTERN
from .base import Config, ConflictError, Name, Reference
from .randomization import RandomizationConfig
from .rig import ArmConfig, RigConfig
from .scene import SceneConfig, Table
from .task import Sampling, TaskConfig
from .units import Within


class ImageConfig(Config):
    """Size in pixels (width, height) and JPEG quality of recorded images."""

    size_px: tuple[Annotated[int, Field(ge=16, le=4096)], Annotated[int, Field(ge=16, le=4096)]]
    jpeg_quality: int = Field(ge=1, le=100)


# How far shadows reach unless a quality says otherwise, m.
SHADOW_REACH = 0.8


class RenderConfig(Config):
    """A quality: how good pictures are, and so what they cost.

    Attributes:
        multisamples: samples a pixel, which smooth edges on a GPU; 0 for none.
        supersampling: pictures are drawn this many times as wide and high, and averaged. That smooths the edges of
            shadows too, and costs less without a GPU than 4 samples a pixel do.
        shadow_map_px: edge of the shadow map in texels; 0 for no shadows.
        shadow_lights: how many of the scene's lights cast shadows, the first ones first. Each draws everything twice
            more.
        shadow_reach_m: how far from the middle of an arm's base and table shadows reach: the nearer, the finer they are
            drawn, and what stands farther off casts none.
        reduced_meshes: draw meshes with fewer faces where they are to be had, see `core.assets.reduction`.
        reflections: let what reflects reflect: it draws everything once more.
        slices: faces around what is round, where it is drawn as a primitive.
    """

    name: Name = "custom"
    multisamples: Literal[0, 2, 4, 8]
    supersampling: float = Field(ge=1, le=4)
    shadow_map_px: int = Field(ge=0, le=8192)
    shadow_lights: int = Field(ge=0, le=8)
    # Left out where it is what it was before it could be chosen, so that older datasets say what they always said.
    shadow_reach_m: Annotated[
        FiniteFloat, Within("m", 0.2, 5), Field(exclude_if=lambda reach: reach == SHADOW_REACH)
    ] = SHADOW_REACH
    reduced_meshes: bool
    reflections: bool
    slices: int = Field(ge=8, le=128, multiple_of=4)

    def fine_size(self, size: tuple[int, int]) -> tuple[int, int]:
        """Width and height (px) in which pictures of a size are drawn."""
        return round(size[0] * self.supersampling), round(size[1] * self.supersampling)


GraspKind = Literal["weld", "contact"]
Side = Literal["left", "right"]

# Grippers whose fingers can hold an object by friction.
_PADS = ("linear_4310",)

# How far each finger opens, m. Source: MuJoCo Menagerie i2rt_yam, the ranges of the fingers' joints.
_OPENS: Mapping[str, float] = {"crank": 0.0375, "linear_4310": 0.0475}


class RecordConfig(Config):
    """What `yamsim record` and `yamsim pickplace batch` run.

    Attributes:
        arm: which of two arms does the task; a rig's only arm does it in any case.
        grasp: "weld" holds the object by a constraint switched on at the grasp, as the lab's magnet does; "contact" by
            friction between a gripper's pads alone.
        episodes: how many successful episodes to record, or trials to run.
        workers: how many processes; it never changes the data.
        seed: with an attempt's number, decides everything random in it.
        wrist: also record the wrist camera.
        boards: also show the base boards and their mounts, as they are on a real arm.
        randomization: what differs between episodes beside where things start.
        truth: also record ground truth for every image, see `core.dataset.truth_files`.
        meshes: asset set -> what is drawn of it, see `core.shown_meshes`. The recorder notes it, whatever a file says;
            None in datasets from before it did.
    """

    rig: Annotated[RigConfig, Reference("rigs")]
    scene: Annotated[SceneConfig, Reference("scenes")]
    task: Annotated[TaskConfig, Reference("tasks")]
    # Left out where it is the default, so that datasets of one arm say what they always said.
    arm: Annotated[Side, Field(exclude_if=lambda side: side == "right")] = "right"
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
    meshes: Annotated[
        Mapping[str, Annotated[str, Field(pattern=PATTERN)]] | None, Field(exclude_if=lambda meshes: meshes is None)
    ] = None

    @model_validator(mode="after")
    def _complete(self) -> RecordConfig:
        for part in ("table", "scene_camera"):
            if getattr(self.scene, part) is None:
                raise ConflictError(
                    f"scene {self.scene.name!r} has no {part}, which task {self.task.name!r} needs",
                    ("scene",),
                    ("task",),
                )
        names = [self.task.object.name, self.task.target.name, *(item.name for item in self.randomization.extras)]
        if len(set(names)) < len(names):
            raise ConflictError(
                f"distractors and the task's objects must all differ: {', '.join(names)}",
                ("randomization", "distractors"),
                ("task", "object"),
                ("task", "target"),
                ("task",),
            )
        return self

    @model_validator(mode="after")
    def _has_the_arm(self) -> RecordConfig:
        if self.arm != "right" and self.arm not in (sides := [arm.side for arm in self.rig.arms]):
            raise ConflictError(
                f"arm {self.arm!r}: rig {self.rig.name!r} has only a {sides[0]} one; leave `arm` out",
                ("arm",),
                ("rig",),
            )
        return self

    @model_validator(mode="after")
    def _can_hand_over(self) -> RecordConfig:
        if self.task.exchange is None:
            return self
        if len(self.rig.arms) < 2:
            raise ConflictError(
                f"task {self.task.name!r} needs two arms, and rig {self.rig.name!r} has one; use --rig bimanual",
                ("rig",),
                ("task",),
            )
        if self.arm != "right" or self.grasp != "weld":
            raise ConflictError(
                f"task {self.task.name!r}: the right arm gives to the left one and both hold by the weld; leave out "
                f"arm {self.arm!r} and grasp {self.grasp!r}",
                ("arm",) if self.arm != "right" else ("grasp",),
                ("task",),
            )
        return self

    @model_validator(mode="after")
    def _fits_between_the_fingers(self) -> RecordConfig:
        item = self.task.object
        assert item.grasp is not None  # checked by the task
        for arm in self.acting_arms:
            if item.grasp.opening > _OPENS[arm.gripper]:
                raise ConflictError(
                    f"object {item.name!r} is too wide to be picked up: {2000 * item.grasp.opening:.0f} mm, and "
                    f"gripper {arm.gripper} of rig {self.rig.name!r} opens {2000 * _OPENS[arm.gripper]:.0f} mm; "
                    "it can still be a target or a distractor",
                    ("task", "object"),
                    ("rig",),
                    ("task",),
                )
        return self

    @model_validator(mode="after")
    def _can_be_held(self) -> RecordConfig:
        if self.grasp != "contact":
            return self
        for arm in self.acting_arms:
            if arm.gripper not in _PADS:
                raise ConflictError(
                    f"grasp 'contact' needs a gripper with pads ({', '.join(_PADS)}), and {arm.name} of rig "
                    f"{self.rig.name!r} has {arm.gripper}; use --rig single_linear, or grasp: weld",
                    ("grasp",),
                    ("rig",),
                )
        grasp = self.task.object.grasp
        if grasp is None or grasp.friction is None:
            raise ConflictError(
                f"grasp 'contact' needs grasp.friction of object {self.task.object.name!r}, which has none; add it, or "
                "use grasp: weld",
                ("grasp",),
                ("task", "object"),
                ("task",),
            )
        return self

    @property
    def table(self) -> Table:
        """The table, as wide as the rig needs it."""
        table = self.surroundings.table
        assert table is not None  # checked when the config was loaded
        return table

    @property
    def surroundings(self) -> SceneConfig:
        """The scene, as wide as the rig needs it."""
        return self.scene.for_span(self.rig.span)

    @property
    def acting(self) -> tuple[int, ...]:
        """Numbers, in the rig, of the arms that do the task: the one that picks first, the one that places last."""
        by_side = {arm.side: k for k, arm in enumerate(self.rig.arms)}
        if self.task.exchange is not None:
            return by_side["right"], by_side["left"]
        return (by_side.get(self.arm, 0),)

    @property
    def acting_arms(self) -> tuple[ArmConfig, ...]:
        """The same arms themselves."""
        return tuple(self.rig.arms[k] for k in self.acting)

    @property
    def acting_scene_arms(self) -> tuple[int, ...]:
        """The same, by their numbers in a compiled scene and in recordings: the left one of two is 0."""
        return tuple(self.rig.recorded.index(k) for k in self.acting)

    @property
    def wrist_arms(self) -> tuple[ArmConfig, ...]:
        """The arms whose wrist cameras are recorded: those that act, if any are."""
        return tuple(self.rig.arms[k] for k in self.rig.recorded if k in self.acting) if self.wrist else ()

    @property
    def object_box(self) -> Sampling:
        """Where the object starts, in `world`: the task's box, which is given for an arm at 0, at the picking arm."""
        return self.task.sampling.moved(self.rig.place_y(self.acting[0]))

    @property
    def target_box(self) -> Sampling:
        """Where the target stands, in `world`: as `object_box`, for the arm that places."""
        return self.task.sampling.moved(self.rig.place_y(self.acting[-1]))

    @property
    def sampled(self) -> Sampling:
        """The smallest box around both."""
        ends = (*self.object_box.y, *self.target_box.y)
        return self.task.sampling.model_copy(update={"y": (min(ends), max(ends))})

    def data_config(self) -> dict[str, Any]:
        """Everything that decides an episode's bytes, as plain data: how many there are and who makes them does not."""
        return self.model_dump(mode="json", exclude={"episodes", "workers"})
