"""The config of a recording: everything that decides its bytes, and the number of workers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, cast

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from ..files.documents.config_base import OMIT_NONE, Config, ConfigReference, ConflictError, Name, omit_if_default
from ..files.documents.units import is_recorded_config
from ..robots.joint_limits import describe_limit_violation
from .mesh_provenance import PATTERN
from .objects.object_config import ObjectConfig
from .program_task import GraspKind as GraspKind
from .program_task import ProgramTask, Start
from .randomization import RandomizationConfig
from .rendering import ImageConfig, RenderConfig
from .rig import ArmConfig, RigConfig
from .scene import SceneConfig, Table

SCENE_CAMERA = "scene_camera"  # the name of the scene's camera in recordings

# Actions in frames: the commands of all drives and of the weld; with "joints" also `state` and `action` as real YAM
# stations record them: for each arm its joints and the opening of its gripper as a share.
ActionKind = Literal["drives", "joints"]
Side = Literal["left", "right"]

_RIGS_WITH_PADS = ("single_linear", "yam_station_linear_4310_d405")  # suggested: a rig of one arm, and of two


class RecordConfig(Config):
    """What `yamsim record` and `yamsim trials` run.

    Attributes:
        arm: which of two arms does the task, or begins it; the only arm of a rig always does.
        grasp: "weld" holds things by a constraint switched on at the grasp, as the lab's magnet does; "contact" by
            friction between a gripper's pads alone. "cloth_constraint", for all tasks with cloth and no others, holds
            things by friction, and cloth by a constraint where both fingers close on it, see `core.sim.cloth`. If left
            out, the first grasp of the task.
        episodes: the number of successful episodes to record, or of trials to run.
        workers: the number of processes; the data does not depend on it.
        action: "joints" also records `state` and `action`, see `core.dataset.lowdim.frame_data`.
        seed: with an attempt's number, decides everything random in the attempt.
        wrist: also record the wrist camera.
        cameras: which cameras to record, in order. If left out: where the rig has cameras of its own, these and the
            wrist cameras; else the scene's, and with `wrist` those of the acting arms.
        boards: also show the base boards and their mounts, as they are on a real arm.
        randomization: what varies between episodes besides the starts of things.
        truth: also record ground truth for every image, see `core.dataset.ground_truth_files`.
        meshes: asset set -> the meshes that are shown, see `core.config.describe_meshes`. Written by the recorder,
            whatever a file has; None in datasets without this entry.
    """

    rig: Annotated[RigConfig, ConfigReference("rigs")]
    scene: Annotated[SceneConfig, ConfigReference("scenes")]
    task: Annotated[ProgramTask, ConfigReference("tasks")]
    arm: Annotated[Side, omit_if_default("right")] = "right"
    # Validation replaces None by the task's default.
    grasp: GraspKind = Field(default=cast(GraspKind, None), validate_default=True)
    action: Annotated[ActionKind, omit_if_default("drives")] = "drives"
    episodes: int = Field(default=500, ge=1, le=1_000_000)
    workers: int = Field(default=2, ge=1, le=1024)
    seed: int = Field(ge=0, lt=2**63)
    wrist: bool
    cameras: Annotated[tuple[Name, ...] | None, Field(min_length=1), OMIT_NONE] = None
    boards: bool = False
    truth: bool = False
    image: ImageConfig
    render: Annotated[RenderConfig, ConfigReference("quality")]
    randomization: Annotated[RandomizationConfig, ConfigReference("randomization")] = RandomizationConfig()
    meshes: Annotated[Mapping[str, Annotated[str, Field(pattern=PATTERN)]] | None, OMIT_NONE] = None

    @field_validator("grasp", mode="before")
    @classmethod
    def _tasks_own_grasp(cls, given: Any, info: ValidationInfo) -> Any:
        if given is not None:
            return given
        task = info.data.get("task")
        # An invalid task is reported in any case, so that any value will do here.
        return task.valid_grasps[0] if isinstance(task, ProgramTask) else "contact"

    @model_validator(mode="after")
    def _task_fits_the_scene(self) -> RecordConfig:
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
    def _rig_has_the_cameras(self) -> RecordConfig:
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
    def _rig_has_the_arm(self) -> RecordConfig:
        if self.arm != "right" and self.arm not in (sides := [arm.side for arm in self.rig.arms]):
            raise ConflictError(
                f"arm {self.arm!r}: rig {self.rig.name!r} has only a {sides[0]} one; leave `arm` out",
                ("arm",),
                ("rig",),
            )
        return self

    @model_validator(mode="after")
    def _fill_in_the_arms(self) -> RecordConfig:
        first, second = (self.rig.arms[k].side for k in (self.first_arm, self.second_arm))
        return self.model_copy(update={"task": self.task.with_arm_sides(first, second)})

    @model_validator(mode="after")
    def _arms_can_grasp(self) -> RecordConfig:
        if self.grasp not in (valid := self.task.valid_grasps):
            raise ConflictError(
                f"task {self.task.name!r} cannot be done with grasp {self.grasp!r}; it has "
                f"{' and '.join(valid)}: give one of those, or leave `grasp` out",
                ("grasp",),
                ("task",),
            )
        if self.grasp == "weld":
            # `core.expert.skills.program_checks` knows the things that the task picks up, and checks them.
            check_fingers(self.rig, self.acting_arms, {})
        else:
            _check_pads(self.grasp, self.rig, self.acting_arms)
        return self

    @model_validator(mode="after")
    def _actions_are_complete(self) -> RecordConfig:
        if self.action == "joints" and self.grasp == "weld":
            raise ConflictError(
                "action 'joints' has no place for a weld, and grasp is 'weld'; use grasp 'contact', with a gripper "
                "that has pads",
                ("action",),
                ("grasp",),
            )
        return self

    @model_validator(mode="after")
    def _start_is_valid(self, info: ValidationInfo) -> RecordConfig:
        given = self.task.start_joints
        if given is None:
            start = _common_start(self.task.name, self.acting_arms)
            return self.model_copy(update={"task": self.task.model_copy(update={"start_joints": start})})
        _check_start(self.task.name, self.rig, self.acting_arms, given, stops=not is_recorded_config(info))
        return self

    @property
    def start_joints(self) -> tuple[float, ...]:
        """Joints of the acting arms at the start, rad."""
        assert self.task.start_joints is not None  # filled in by `_start_is_valid`
        return self.task.start_joints

    @property
    def table(self) -> Table:
        """The table, widened for the rig."""
        table = self.surroundings.table
        assert table is not None  # checked by `_task_fits_the_scene`
        return table

    @property
    def surroundings(self) -> SceneConfig:
        """The scene, widened for the rig."""
        return self.scene.for_span(self.rig.span)

    @property
    def acting_indices(self) -> tuple[int, ...]:
        """Indices in the rig of the arms that do the task, the one that begins first."""
        alone = self.task.arms == "one" or self.second_arm == self.first_arm
        return (self.first_arm,) if alone else (self.first_arm, self.second_arm)

    @property
    def first_arm(self) -> int:
        """Index in the rig of the arm that does the task, or begins it."""
        return next((k for k, arm in enumerate(self.rig.arms) if arm.side == self.arm), 0)

    @property
    def second_arm(self) -> int:
        """Index in the rig of the other arm; of the same one in a rig of one arm."""
        return len(self.rig.arms) - 1 - self.first_arm

    @property
    def starts(self) -> Mapping[str, Start]:
        """Role -> where its things start, with all regions in `world`."""
        places = {"first": self.rig.base_y(self.first_arm), "second": self.rig.base_y(self.second_arm)}
        return {
            role: start if start.from_arm is None else start.moved(places[start.from_arm])
            for role, start in self.task.starts.items()
        }

    @property
    def acting_arms(self) -> tuple[ArmConfig, ...]:
        """The arms at the indices `acting`."""
        return tuple(self.rig.arms[k] for k in self.acting_indices)

    @property
    def acting_scene_arms(self) -> tuple[int, ...]:
        """Indices of the acting arms in compiled scenes and recordings, where the left one of two arms is 0."""
        return tuple(self.rig.recording_order.index(k) for k in self.acting_indices)

    @property
    def recorded_cameras(self) -> tuple[str, ...]:
        """Names of the cameras that are recorded, in order."""
        if self.cameras is not None:
            return self.cameras
        if self.rig.cameras:
            return self.rig.camera_names
        acting = (self.rig.arms[k] for k in self.rig.recording_order if k in self.acting_indices)
        return (SCENE_CAMERA, *(arm.wrist_camera_name for arm in acting if self.wrist))

    @property
    def wrist_arms(self) -> tuple[ArmConfig, ...]:
        """The arms whose wrist cameras are recorded, the left arm first."""
        arms = (self.rig.arms[k] for k in self.rig.recording_order)
        return tuple(arm for arm in arms if arm.wrist_camera_name in self.recorded_cameras)

    def data_config(self) -> dict[str, Any]:
        """Everything that decides an episode's bytes, as plain data."""
        return self.model_dump(mode="json", exclude={"episodes", "workers"})


def check_fingers(
    rig: RigConfig, arms: Sequence[ArmConfig], items: Mapping[tuple[str | int, ...], ObjectConfig]
) -> None:
    """Make sure that the acting arms have fingers, and that the things that they pick up fit between the fingers.

    Args:
        items: key path in the recording's config -> a thing that is picked up by a weld.

    Raises ConflictError if an arm cannot grasp a thing.
    """
    for arm in arms:
        fingers = arm.gripper.fingers
        if fingers is None:
            raise ConflictError(
                f"{arm.name} of rig {rig.name!r} has the gripper {arm.gripper.name}, which has no fingers to "
                "pick anything up with; use another gripper, or another arm",
                ("rig",),
                ("arm",),
            )
        for path, item in items.items():
            if item.grasp is None:
                raise ConflictError(
                    f"object {item.name!r} has no `grasp`, so it cannot be picked up by a weld",
                    path,
                    ("grasp",),
                    ("task",),
                )
            if item.grasp.opening > fingers.full_opening:
                raise ConflictError(
                    f"object {item.name!r} is too wide to be picked up: {2000 * item.grasp.opening:.0f} mm, and "
                    f"gripper {arm.gripper.name} of rig {rig.name!r} opens {2000 * fingers.full_opening:.0f} mm; "
                    "it can still be a target or a distractor",
                    path,
                    ("rig",),
                    ("task",),
                )


def _check_pads(grasp: GraspKind, rig: RigConfig, arms: Sequence[ArmConfig]) -> None:
    for arm in arms:
        if arm.gripper.fingers is None or not arm.gripper.fingers.pads:
            raise ConflictError(
                f"grasp {grasp!r} needs a gripper with pads, and {arm.name} of rig {rig.name!r} has "
                f"{arm.gripper.name}; use --rig {_RIGS_WITH_PADS[len(rig.arms) > 1]}, or grasp: weld",
                ("grasp",),
                ("rig",),
            )


def _common_start(task: str, arms: Sequence[ArmConfig]) -> tuple[float, ...]:
    """The start joints that the models of all acting arms agree on, rad."""
    robots = [arm.robot for arm in arms]
    starts = {robot.start for robot in robots}
    if len(starts) > 1:
        raise ConflictError(
            f"task {task!r} has no start_joints, and its arms {', '.join(r.model for r in robots)} "
            "would start differently; give start_joints that suit both",
            ("task", "start_joints"),
            ("task",),
            ("rig",),
        )
    return starts.pop()


def _check_start(task: str, rig: RigConfig, arms: Sequence[ArmConfig], given: Sequence[float], *, stops: bool) -> None:
    """Make sure that the acting arms have as many joints as are given, and, with `stops`, reach them."""
    for arm in arms:
        robot, where = arm.robot, (("task", "start_joints"), ("task",), ("rig",))
        if len(given) != robot.dof:
            raise ConflictError(
                f"task {task!r} has {len(given)} start_joints, and {arm.name} of rig {rig.name!r} "
                f"({robot.model}) has {robot.dof} joints; give one for each of {', '.join(robot.joint_names)}, or "
                "leave start_joints out",
                *where,
            )
        if stops and (fault := describe_limit_violation(arm.name, robot, np.array(given), 0.0)):
            raise ConflictError(f"task {task!r}: start_joints: {fault}", *where)
