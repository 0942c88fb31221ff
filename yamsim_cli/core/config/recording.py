"""The config of a recording: all values that determine its bytes, and the number of workers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, cast

import numpy as np
from pydantic import Field, ValidationInfo, field_validator, model_validator

from ...camera_effects.config import CameraEffects
from ...disturbances.config import DisturbanceConfig
from ..files.documents.config_base import Config, ConfigReference, ConflictError, Name
from ..files.documents.units import is_recorded_config
from ..robots.joint_limits import describe_limit_violation
from .mesh_provenance import PROVENANCE_PATTERN
from .objects.object_config import ObjectConfig
from .program_task import GraspKind as GraspKind
from .program_task import ProgramTask
from .randomization import RandomizationConfig
from .rendering import ImageConfig, RenderConfig
from .rig import ArmConfig, RigConfig
from .scene import SceneConfig, Table
from .task_objects import ObjectStartRanges

SCENE_CAMERA = "scene_camera"  # the name of the scene's camera in recordings

# Recorded actions. "drives": commands of all drives and of the weld. "joints": also `state` and `action` in the format
# of real YAM stations: for each arm its joints and the opening of its gripper as a share.
ActionKind = Literal["drives", "joints"]
Side = Literal["left", "right"]

_RIGS_WITH_PADS = ("single_linear", "yam_station_linear_4310_d405")  # rigs that messages suggest, of one arm and of two


class DrawnFrom(Config):
    """The dataset whose stored states `yamsim draw` rendered again.

    Attributes:
        config_sha256: SHA-256 of its `config.yaml`.
        rig: its rig, which determines the physics, if the images show another one.
    """

    config_sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    rig: Annotated[RigConfig | None, ConfigReference("rigs")] = None


class CameraEffectsEntry(Config):
    """Lens and sensor of one camera; if `camera` is left out, of all cameras without their own entry."""

    camera: Name | None = None
    effects: Annotated[CameraEffects, ConfigReference("camera_effects")]


class RecordConfig(Config):
    """The config of `yamsim record` and `yamsim trials`.

    Attributes:
        arm: side of the arm that performs or begins the task; the only arm of a rig always does.
        grasp: "weld" holds objects by a constraint that is active during the grasp, as with the lab's magnet. "contact"
            holds objects only by friction between pads. "cloth_constraint", for exactly the tasks with cloth, holds
            objects by friction, and cloth by a constraint between both closed fingers, see `core.sim.cloth`. If left
            out, the first grasp of the task.
        episodes: number of successful episodes to record, or of trials to run.
        workers: number of processes; the data does not depend on this number.
        action: "drives" records the commands to all drives; "joints" also `state` and `action` as YAM stations do.
        seed: determines, with an attempt's number, everything random in the attempt.
        wrist: whether to record wrist cameras too; see `cameras`.
        cameras: the cameras to record, in order; an empty list records no images. If left out, a rig's own cameras and
            the wrist cameras. If the rig has no own cameras, the scene camera, and with `wrist` the wrist cameras of
            the acting arms.
        boards: whether to show the base boards and their mounts, as on a real arm.
        randomization: domain randomization of the episodes, in addition to the starts of objects.
        truth: whether to record ground truth for every image, see `core.dataset.ground_truth_files`.
        camera_effects: lens distortion, noise and other effects of cameras; no physics depends on them.
        disturb: disturbances of the expert in `record` and `trials`; None for none.
        look: number of the random streams of all that `randomization` varies except physics.
        drawn: set by `yamsim draw`; None in recordings.
        meshes: asset set -> description of the shown meshes, see `core.config.mesh_provenance`. The recorder replaces
            any value in a file; None in datasets without this entry.
    """

    rig: Annotated[RigConfig, ConfigReference("rigs")]
    scene: Annotated[SceneConfig, ConfigReference("scenes")]
    task: Annotated[ProgramTask, ConfigReference("tasks")]
    arm: Side = "right"
    # Validation replaces None by the task's first grasp.
    grasp: GraspKind = Field(default=cast(GraspKind, None), validate_default=True)
    action: ActionKind = "drives"
    episodes: int = Field(default=500, ge=1, le=1_000_000)
    workers: int = Field(default=2, ge=1, le=1024)
    seed: int = Field(ge=0, lt=2**63)
    wrist: bool
    cameras: tuple[Name, ...] | None = None
    boards: bool = False
    truth: bool = False
    image: ImageConfig
    render: Annotated[RenderConfig, ConfigReference("quality")]
    randomization: Annotated[RandomizationConfig, ConfigReference("randomization")] = RandomizationConfig()
    meshes: Mapping[str, Annotated[str, Field(pattern=PROVENANCE_PATTERN)]] | None = None
    camera_effects: tuple[CameraEffectsEntry, ...] = ()
    disturb: DisturbanceConfig | None = None
    look: int = Field(default=0, ge=0, le=9999)
    drawn: DrawnFrom | None = None

    @field_validator("grasp", mode="before")
    @classmethod
    def _tasks_own_grasp(cls, given: Any, info: ValidationInfo) -> Any:
        if given is not None:
            return given
        task = info.data.get("task")
        # For an invalid task, validation fails anyway, so the value returned here does not matter.
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
        names = [item.name for item in (*self.task.objects, *self.randomization.distractor_configs)]
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
        for entry in self.camera_effects:
            if entry.camera not in (None, *there):
                raise ConflictError(f"no camera {entry.camera!r}; valid: {', '.join(there)}", ("camera_effects",))
        if self.cameras and len(set(self.cameras)) < len(self.cameras):
            raise ConflictError(f"a camera is listed twice: {', '.join(self.cameras)}", ("cameras",))
        return self

    @model_validator(mode="after")
    def _rig_has_the_arm(self) -> RecordConfig:
        if self.arm != "right" and self.arm not in (sides := [arm.side for arm in self.rig.arms]):
            raise ConflictError(
                f"arm {self.arm!r}: rig {self.rig.name!r} has only a {sides[0]} arm; leave `arm` out",
                ("arm",),
                ("rig",),
            )
        return self

    @model_validator(mode="after")
    def _fill_in_the_arms(self) -> RecordConfig:
        first, second = (self.rig.arms[k].side for k in (self.first_arm, self.second_arm))
        return self.model_copy(update={"task": self.task.with_side_words(first, second)})

    @model_validator(mode="after")
    def _arms_can_grasp(self) -> RecordConfig:
        if self.grasp not in (valid := self.task.valid_grasps):
            raise ConflictError(
                f"task {self.task.name!r} does not support grasp {self.grasp!r}; "
                f"give {' or '.join(valid)}, or leave `grasp` out",
                ("grasp",),
                ("task",),
            )
        if self.grasp == "weld":
            # `program_checks` knows the objects that the task picks up, and checks them.
            check_fingers(self.rig, self.acting_arms, {})
        else:
            _check_pads(self.grasp, self.rig, self.acting_arms)
        return self

    @model_validator(mode="after")
    def _actions_are_complete(self) -> RecordConfig:
        if self.action == "joints" and self.grasp == "weld":
            raise ConflictError(
                "action 'joints' cannot command a weld, but grasp is 'weld'; use grasp 'contact', with a gripper "
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
        """Joints (dof,) of each acting arm at the start, rad."""
        assert self.task.start_joints is not None  # filled in by `_start_is_valid`
        return self.task.start_joints

    @property
    def widened_table(self) -> Table:
        """The table, widened along y by the distance between the rig's arms."""
        table = self.widened_scene.table
        assert table is not None  # checked by `_task_fits_the_scene`
        return table

    @property
    def widened_scene(self) -> SceneConfig:
        """The scene, with the table widened and the scene camera moved back by the distance between the rig's arms.

        The table also covers the task's `table_area`.
        """
        scene, area = self.scene.widened_for_arm_distance(self.rig.arm_span), self.task.table_area
        if area is None or scene.table is None:
            return scene
        return scene.model_copy(update={"table": scene.table.covering(area.x, area.y)})

    @property
    def acting_indices(self) -> tuple[int, ...]:
        """Indices in the rig of the arms that do the task, in the order in which they begin."""
        alone = self.task.arms == "one" or self.second_arm == self.first_arm
        return (self.first_arm,) if alone else (self.first_arm, self.second_arm)

    @property
    def first_arm(self) -> int:
        """Index in the rig of the arm that does or begins the task."""
        return next((k for k, arm in enumerate(self.rig.arms) if arm.side == self.arm), 0)

    @property
    def second_arm(self) -> int:
        """Index in the rig of the arm that is not `first_arm`; in a rig of one arm, of the only arm."""
        return len(self.rig.arms) - 1 - self.first_arm

    @property
    def start_regions_in_world(self) -> Mapping[str, ObjectStartRanges]:
        """Role -> ranges of the initial poses of its objects, all in `world`."""
        places = {"first": self.rig.arm_origin_y(self.first_arm), "second": self.rig.arm_origin_y(self.second_arm)}
        return {
            role: start if start.from_arm is None else start.with_y_in_world(places[start.from_arm])
            for role, start in self.task.starts.items()
        }

    @property
    def acting_arms(self) -> tuple[ArmConfig, ...]:
        """The arms that do the task, in the order in which they begin."""
        return tuple(self.rig.arms[k] for k in self.acting_indices)

    @property
    def acting_scene_arms(self) -> tuple[int, ...]:
        """Indices of the acting arms in compiled scenes and recordings, where the left of two arms is 0."""
        return tuple(self.rig.recording_order.index(k) for k in self.acting_indices)

    @property
    def recorded_cameras(self) -> tuple[str, ...]:
        """Names of the recorded cameras, in order."""
        if self.cameras is not None:
            return self.cameras
        if self.rig.cameras:
            return self.rig.camera_names
        acting = (self.rig.arms[k] for k in self.rig.recording_order if k in self.acting_indices)
        return (SCENE_CAMERA, *(arm.wrist_camera_name for arm in acting if self.wrist))

    def effects_of(self, camera: str) -> CameraEffects | None:
        """Return the effects of a recorded camera; None for an ideal pinhole camera."""
        found = {entry.camera: entry.effects for entry in self.camera_effects}
        return found.get(camera, found.get(None))

    @property
    def wrist_arms(self) -> tuple[ArmConfig, ...]:
        """The arms with recorded wrist cameras, the left arm first."""
        arms = (self.rig.arms[k] for k in self.rig.recording_order)
        return tuple(arm for arm in arms if arm.wrist_camera_name in self.recorded_cameras)

    def data_config(self) -> dict[str, Any]:
        """Return all values that determine an episode's bytes, as data for JSON."""
        return self.model_dump(mode="json", exclude={"episodes", "workers"})


def check_fingers(
    rig: RigConfig, arms: Sequence[ArmConfig], items: Mapping[tuple[str | int, ...], ObjectConfig]
) -> None:
    """Make sure that arms have fingers, and that objects fit between the fingers.

    Args:
        items: key path in the recording's config -> an object that is picked up by a weld.

    Raises ConflictError if an arm cannot grasp an object.
    """
    for arm in arms:
        fingers = arm.gripper.fingers
        if fingers is None:
            raise ConflictError(
                f"{arm.name} of rig {rig.name!r} has the gripper {arm.gripper.name}, which has no fingers; "
                "use another gripper or another arm",
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
    """Return the start joints that the models of all acting arms have in common, rad."""
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
    """Make sure that the acting arms have the given number of joints; with `stops`, also check joint limits."""
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
