"""A recording: everything that decides its bytes, and how many workers make them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, cast

from pydantic import Field, ValidationInfo, field_validator, model_validator

from ..documents.base import Config, ConflictError, Name, Reference
from ..documents.units import as_recorded
from ..shown_meshes import PATTERN
from .holding import check_fingers, check_friction
from .pictures import ImageConfig, RenderConfig
from .program_task import GraspKind as GraspKind
from .program_task import ProgramTask, Start
from .randomization import RandomizationConfig
from .rig import ArmConfig, RigConfig
from .scene import SceneConfig, Table
from .starts import check_start, common_start

# What recordings call the camera of their scene.
SCENE_CAMERA = "scene_camera"

# What frames hold of the actions: what all drives and the weld are told; or also `state` and `action` as real YAM
# stations record them, which are of each arm its joints and how far its gripper is open, as a share.
ActionKind = Literal["drives", "joints"]
Side = Literal["left", "right"]


class RecordConfig(Config):
    """What `yamsim record` and `yamsim trials` run.

    Attributes:
        arm: which of two arms does the task, or begins it; a rig's only arm does it in any case.
        grasp: "weld" holds the object by a constraint switched on at the grasp, as the lab's magnet does; "contact" by
            friction between a gripper's pads alone; "cloth_constraint", which tasks with cloth have and no others, by
            friction, and cloth by a constraint where both fingers close on it, see `core.sim.cloth`. If left out, it is
            the first of those that the task has.
        episodes: how many successful episodes to record, or trials to run.
        workers: how many processes; it never changes the data.
        action: "joints" records `state` and `action` too, see `core.dataset.lowdim.frame_data`.
        seed: with an attempt's number, decides everything random in it.
        wrist: also record the wrist camera.
        cameras: which cameras to record, in order. Left out: those of the station, and of the wrists, where the rig has
            cameras of its own; else the scene's, and with `wrist` those of the arms that act.
        boards: also show the base boards and their mounts, as they are on a real arm.
        randomization: what differs between episodes beside where things start.
        truth: also record ground truth for every image, see `core.dataset.truth_files`.
        meshes: asset set -> what is shown of it, see `core.shown_meshes`. The recorder notes it, whatever a file says;
            None in datasets from before it did.
    """

    rig: Annotated[RigConfig, Reference("rigs")]
    scene: Annotated[SceneConfig, Reference("scenes")]
    task: Annotated[ProgramTask, Reference("tasks")]
    # Left out where it is the default, so that datasets of one arm say what they always said.
    arm: Annotated[Side, Field(exclude_if=lambda side: side == "right")] = "right"
    # None only before validation, which puts the task's own there.
    grasp: GraspKind = Field(default=cast(GraspKind, None), validate_default=True)
    action: Annotated[ActionKind, Field(exclude_if=lambda kind: kind == "drives")] = "drives"
    episodes: int = Field(default=500, ge=1, le=1_000_000)
    workers: int = Field(default=2, ge=1, le=1024)
    seed: int = Field(ge=0, lt=2**63)
    wrist: bool
    cameras: Annotated[tuple[Name, ...] | None, Field(min_length=1, exclude_if=lambda cameras: cameras is None)] = None
    boards: bool = False
    truth: bool = False
    image: ImageConfig
    render: Annotated[RenderConfig, Reference("quality")]
    randomization: Annotated[RandomizationConfig, Reference("randomization")] = RandomizationConfig()
    meshes: Annotated[
        Mapping[str, Annotated[str, Field(pattern=PATTERN)]] | None, Field(exclude_if=lambda meshes: meshes is None)
    ] = None

    @field_validator("grasp", mode="before")
    @classmethod
    def _tasks_own_grasp(cls, given: Any, info: ValidationInfo) -> Any:
        if given is not None:
            return given
        task = info.data.get("task")
        # A task that is not valid is reported, so that it does not matter what stands here.
        return task.valid_grasps[0] if isinstance(task, ProgramTask) else "contact"

    @model_validator(mode="after")
    def _complete(self) -> RecordConfig:
        for part in ("table", "scene_camera"):
            if getattr(self.scene, part) is None:
                raise ConflictError(
                    f"scene {self.scene.name!r} has no {part}, which task {self.task.name!r} needs",
                    ("scene",),
                    ("task",),
                )
        names = [item.name for item in (*self.task.objects, *self.randomization.extras)]
        if len(set(names)) < len(names):
            raise ConflictError(
                f"distractors and the task's objects must all differ: {', '.join(names)}",
                ("randomization", "distractors"),
                *(("task", "things", role, "of") for role in self.task.things),
                ("task",),
            )
        return self

    @model_validator(mode="after")
    def _has_the_cameras(self) -> RecordConfig:
        there = (SCENE_CAMERA, *self.rig.camera_names)
        for name in self.cameras or ():
            if name not in there:
                raise ConflictError(
                    f"rig {self.rig.name!r} has no camera {name!r}; its cameras: {', '.join(there)}",
                    ("cameras",),
                    ("rig",),
                )
        if self.cameras and len(set(self.cameras)) < len(self.cameras):
            raise ConflictError(f"a camera is named twice: {', '.join(self.cameras)}", ("cameras",))
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
    def _says_which_arms(self) -> RecordConfig:
        first, second = (self.rig.arms[k].side for k in (self.first_arm, self.second_arm))
        return self.model_copy(update={"task": self.task.done_by(first, second)})

    @model_validator(mode="after")
    def _can_be_held(self) -> RecordConfig:
        if self.grasp not in (valid := self.task.valid_grasps):
            raise ConflictError(
                f"task {self.task.name!r} cannot be done with grasp {self.grasp!r}; it has "
                f"{' and '.join(valid)}: give one of those, or leave `grasp` out",
                ("grasp",),
                ("task",),
            )
        if self.grasp == "weld":
            # What the task picks up is known to `core.skills.checked`.
            check_fingers(self.rig, self.acting_arms, {})
        else:
            check_friction(self.grasp, self.rig, self.acting_arms)
        return self

    @model_validator(mode="after")
    def _actions_say_all(self) -> RecordConfig:
        if self.action == "joints" and self.grasp == "weld":
            raise ConflictError(
                "action 'joints' has no place for a weld, and grasp is 'weld'; use grasp 'contact', with a gripper "
                "that has pads",
                ("action",),
                ("grasp",),
            )
        return self

    @model_validator(mode="after")
    def _starts(self, info: ValidationInfo) -> RecordConfig:
        given = self.task.start_joints
        if given is None:
            start = common_start(self.task.name, self.acting_arms)
            # So that a recording says where its arms started.
            return self.model_copy(update={"task": self.task.model_copy(update={"start_joints": start})})
        check_start(self.task.name, self.rig, self.acting_arms, given, recorded=as_recorded(info))
        return self

    @property
    def start_joints(self) -> tuple[float, ...]:
        """Joints of the arms that do the task when it starts, rad."""
        assert self.task.start_joints is not None  # completed when the config was loaded
        return self.task.start_joints

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
        """Numbers, in the rig, of the arms that do the task: the one that begins it is first."""
        alone = self.task.arms == "one" or self.second_arm == self.first_arm
        return (self.first_arm,) if alone else (self.first_arm, self.second_arm)

    @property
    def first_arm(self) -> int:
        """Number, in the rig, of the arm that does the task, or begins it."""
        return next((k for k, arm in enumerate(self.rig.arms) if arm.side == self.arm), 0)

    @property
    def second_arm(self) -> int:
        """Number, in the rig, of the other arm; of a lone arm the same."""
        return len(self.rig.arms) - 1 - self.first_arm

    @property
    def starts(self) -> Mapping[str, Start]:
        """Role -> where its things start, with all regions in `world`."""
        places = {"first": self.rig.place_y(self.first_arm), "second": self.rig.place_y(self.second_arm)}
        return {
            role: start if start.from_arm is None else start.moved(places[start.from_arm])
            for role, start in self.task.starts.items()
        }

    @property
    def acting_arms(self) -> tuple[ArmConfig, ...]:
        """The same arms themselves."""
        return tuple(self.rig.arms[k] for k in self.acting)

    @property
    def acting_scene_arms(self) -> tuple[int, ...]:
        """The same, by their numbers in a compiled scene and in recordings: the left one of two is 0."""
        return tuple(self.rig.recorded.index(k) for k in self.acting)

    @property
    def recorded_cameras(self) -> tuple[str, ...]:
        """Names of the cameras that are recorded, in order."""
        if self.cameras is not None:
            return self.cameras
        if self.rig.cameras:
            return self.rig.camera_names
        acting = (self.rig.arms[k] for k in self.rig.recorded if k in self.acting)
        return (SCENE_CAMERA, *(arm.wrist_camera_name for arm in acting if self.wrist))

    @property
    def wrist_arms(self) -> tuple[ArmConfig, ...]:
        """The arms whose wrist cameras are recorded, the left one first."""
        arms = (self.rig.arms[k] for k in self.rig.recorded)
        return tuple(arm for arm in arms if arm.wrist_camera_name in self.recorded_cameras)

    def data_config(self) -> dict[str, Any]:
        """Everything that decides an episode's bytes, as plain data: how many there are and who makes them does not."""
        return self.model_dump(mode="json", exclude={"episodes", "workers"})
