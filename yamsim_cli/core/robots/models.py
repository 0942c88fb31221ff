"""What `robot_models/` says of an arm and of a gripper, in `model.yaml` and `gripper.yaml`, each with its MJCF."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    FiniteFloat,
    PlainSerializer,
    StringConstraints,
    WithJsonSchema,
    model_validator,
)

from ..documents.base import OMIT_EMPTY, OMIT_NONE, Config, ConflictError, Name, Quaternion, Vector, ordered
from ..documents.document import Document, load_yaml
from ..documents.units import FieldOfView, JointAngle, Offset, OffsetPoint, Within
from ..errors import ConfigError
from ..geometry.se3 import Array, pose_from_quat
from .finray.parameters import FinRay
from .mjcf_file import read_mjcf

# Names in an MJCF.
Part = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_/-]+$")]
_Range = Annotated[tuple[JointAngle, JointAngle], AfterValidator(ordered)]
_Opening = Annotated[FiniteFloat, Within("m", 1e-4, 0.5)]


class Mjcf(Config):
    """An MJCF file beside a YAML, held whole, so that a robot needs no file wherever its config goes.

    Attributes:
        file: its path.
        text: the MJCF, with what the file includes.
        includes: whether the file includes others, so that lines of `text` are not lines of the file.
    """

    file: str
    text: str = Field(repr=False)
    includes: bool = False


def _named(value: object) -> object:
    if isinstance(value, str):
        raise ValueError(
            "a robot or a gripper is named, not spelled out: put its folder into robot_models/ and name that"
        )
    return value


MjcfFile = Annotated[
    Mjcf,
    BeforeValidator(_named),
    PlainSerializer(lambda mjcf: mjcf.file, return_type=str, when_used="json"),
    WithJsonSchema({"type": "string"}),
]


class JointLimits(Config):
    """One joint.

    Attributes:
        range: between its stops, rad.
        motor_rpm: the motor's no-load speed at the joint, revolutions a minute.
        reported_rad_s: the fastest motion that the drive can report, rad/s.
    """

    name: Part
    range: _Range
    motor_rpm: Annotated[FiniteFloat, Within("rpm", 1, 10_000)]
    reported_rad_s: Annotated[FiniteFloat, Within("rad/s", 0.1, 1000)]

    @property
    def motor_rad_s(self) -> float:
        """The motor's no-load speed, rad/s."""
        return self.motor_rpm * 2 * math.pi / 60


class JointChange(Config):
    """What is otherwise at a joint than the arm's own files say; what is left out stays.

    Attributes:
        range: between its stops, rad.
        kp, kv: gains of its drive, N m/rad and N m s/rad.
        torque: the most that its drive gives, N m.
        armature: of its motor at the joint, kg m2.
        frictionloss: Coulomb friction, N m.
    """

    range: _Range | None = None
    kp: Annotated[FiniteFloat, Within("N m/rad", 0, 1e5)] | None = None
    kv: Annotated[FiniteFloat, Within("N m s/rad", 0, 1e4)] | None = None
    torque: Annotated[FiniteFloat, Within("N m", 1e-3, 1e4)] | None = None
    armature: Annotated[FiniteFloat, Within("kg m2", 0, 100)] | None = None
    frictionloss: Annotated[FiniteFloat, Within("N m", 0, 1000)] | None = None


class Placement(Config):
    """A pose in another frame: position in metres, quaternion wxyz."""

    position: OffsetPoint = (0.0, 0.0, 0.0)
    quat: Quaternion = (1.0, 0.0, 0.0, 0.0)

    @property
    def T(self) -> Array:
        """The pose (4, 4)."""
        return pose_from_quat(self.position, self.quat)


class Fit(Config):
    """How a gripper sits on an arm, and what the arm is otherwise with it.

    Attributes:
        mount: of the gripper's frame in the flange's.
        joints: joint -> what is otherwise there.
        excludes: pairs of bodies that pass through each other with this gripper.
    """

    mount: Placement = Placement()
    joints: dict[Part, JointChange] = Field(default_factory=dict)
    excludes: tuple[tuple[Part, Part], ...] = ()


class CameraMode(Config):
    """One of a camera's image sizes (width, height in pixels), and its field of view there."""

    size_px: tuple[Annotated[int, Field(ge=16, le=4096)], Annotated[int, Field(ge=16, le=4096)]]
    fovy_deg: Annotated[FieldOfView, Field(gt=1, lt=179)]


Fovy = Annotated[FieldOfView, Field(gt=1, lt=179)]
Modes = Annotated[tuple[CameraMode, ...], OMIT_EMPTY]


class WristCamera(Config):
    """A camera on the flange: its position (m) and the axes of its OpenCV frame (x right, y down, z forward) there.

    Attributes:
        fovy_deg: vertical field of view.
        modes: image sizes for which that is another.
        name: under which its images are recorded; left out, `<side>_wrist_camera`.
    """

    position: OffsetPoint
    x_axis: Vector
    y_axis: Vector
    fovy_deg: Fovy
    modes: Modes = ()
    name: Annotated[Name | None, OMIT_NONE] = None

    def fovy(self, size: tuple[int, int]) -> float:
        """Vertical field of view of images of a size (width, height), degrees."""
        return fovy_of(size, self.fovy_deg, self.modes)


def fovy_of(size: tuple[int, int], fovy_deg: float, modes: tuple[CameraMode, ...]) -> float:
    """A camera's vertical field of view for images of a size (width, height), degrees."""
    return next((mode.fovy_deg for mode in modes if mode.size_px == size), fovy_deg)


class _InAFolder(Config):
    """A config that is a folder: named after it, and with an MJCF beside its YAML."""

    name: Name
    mjcf: MjcfFile
    source: str | None = None

    def __hash__(self) -> int:
        """Equal ones have the same text; mappings inside could not be hashed."""
        return hash((self.name, self.mjcf.text))

    @classmethod
    def read(cls, path: Path) -> Document:
        """The YAML with its MJCF read in.

        Raises:
            ConfigError: either cannot be read, or the name is not the folder's.
        """
        document = load_yaml(path)
        name = path.absolute().parent.name
        if document.data.setdefault("name", name) != name:
            said = document.data["name"]
            raise ConfigError(f"{document.place(('name',))}: name: {said!r} lies in folder {name!r}; leave it out")
        file = document.data.get("mjcf")
        if isinstance(file, str):
            document.data["mjcf"] = read_mjcf(path.with_name(file))
        return document


class ArmModel(_InAFolder):
    """A robot model: an arm without its gripper.

    Attributes:
        name: of its folder, `robot_models/<name>/`; need not be said.
        source: where its figures are from, in a few words.
        mjcf: the file beside with the arm's bodies up to the flange and a position drive for each joint. Joints' stops
            are written into it.
        base: the body whose frame is the arm's base frame.
        flange: the last body, which turns with the last joint; a gripper becomes part of it.
        base_mesh: the frame in which boards and mounts are given, in the base frame.
        mesh_sets: the asset sets that the MJCF takes meshes from.
        joints: from the base to the flange.
        home: the joints at rest, rad.
        start: the joints from which a task starts that does not say its own, rad; home if left out.
        grippers: gripper -> how it fits. A gripper's own file may say so instead.
        family, revision: whose revision it is, and which; a rig may name the family and means the newest one.
    """

    base: Part
    flange: Part
    base_mesh: Placement = Placement()
    mesh_sets: tuple[Name, ...] = ()
    joints: Annotated[tuple[JointLimits, ...], Field(min_length=1)]
    home: tuple[JointAngle, ...]
    start: tuple[JointAngle, ...] | None = None
    grippers: dict[Name, Fit] = Field(default_factory=dict)
    family: Name | None = None
    revision: Name | None = None

    @model_validator(mode="after")
    def _revision_of_a_family(self) -> ArmModel:
        if (self.family is None) != (self.revision is None):
            raise ConflictError("a revision needs its family, and a family its revision", ("family",), ("revision",))
        return self

    @model_validator(mode="after")
    def _one_value_a_joint(self) -> ArmModel:
        names = [joint.name for joint in self.joints]
        if len(set(names)) < len(names):
            raise ConflictError(f"two joints have the same name: {', '.join(names)}", ("joints",))
        for key, values in (("home", self.home), ("start", self.start)):
            if values is not None and len(values) != len(names):
                raise ConflictError(f"has {len(values)} values; give one for each of {', '.join(names)}", (key,))
            for value, joint in zip(values or (), self.joints, strict=True):
                low, high = joint.range
                if not low <= value <= high:
                    raise ConflictError(f"{joint.name}: {value:g} rad lies outside {low:g}..{high:g}", (key,))
        return self


class Fingers(Config):
    """Two fingers that one drive opens and closes.

    Attributes:
        joints: of the left and the right finger: slides, coupled by an equality of the MJCF where they are to move
            together.
        bodies: of the left and the right finger, on these joints. What hangs on a finger belongs to it.
        drive: the actuator that moves the left finger's joint; it is told that finger's opening, m.
        range: of one finger between its stops, m; 0 is closed. It is written into the MJCF.
        full_opening: how far one finger opens in use, m.
        start_opening: of one finger when a task starts, m; as far as it opens if left out.
        radius: half of a finger's width near its tip, m: what it needs beside an object when it comes down.
        pads: whether the fingers can hold an object by friction.
    """

    joints: tuple[Part, Part]
    bodies: tuple[Part, Part]
    drive: Part = "gripper"
    range: Annotated[tuple[Offset, Offset], AfterValidator(ordered)]
    full_opening: _Opening
    start_opening: _Opening | None = None
    radius: _Opening
    pads: bool

    @property
    def opened(self) -> float:
        """Opening of one finger when a task starts, m."""
        return self.full_opening if self.start_opening is None else self.start_opening

    @model_validator(mode="after")
    def _within_the_stops(self) -> Fingers:
        for key in ("full_opening", "start_opening"):
            value = getattr(self, key)
            if value is not None and value > self.range[1]:
                raise ConflictError(f"{value:g} m is beyond the finger's stop at {self.range[1]:g} m", (key,))
        return self


class Gripper(_InAFolder):
    """A gripper, which becomes part of an arm's flange.

    Attributes:
        name: of its folder, `robot_models/grippers/<name>/`; need not be said.
        source: where its figures are from, in a few words.
        mjcf: the file beside with one body: the gripper's frame. What is in it is put into the flange; an `inertial`
            there is that of flange and gripper together. Equalities, excludes and actuators come along. The site
            `pinch_site` lies where the fingers meet, z into the grasp, y along the closing direction.
        mesh_sets: the asset sets that the MJCF takes meshes from.
        fingers: left out of a gripper that has none.
        finray: the soft fingers that grow out of two bodies of the MJCF; left out where the MJCF has all there is.
        wrist_camera: where a rig's arm with this gripper has its camera, unless the rig says another.
        arms: robot model -> how the gripper fits there. The model's own file may say so instead.
    """

    mesh_sets: tuple[Name, ...] = ()
    fingers: Fingers | None = None
    finray: FinRay | None = None
    wrist_camera: WristCamera | None = None
    arms: dict[Name, Fit] = Field(default_factory=dict)


def fit(arm: ArmModel, gripper: Gripper) -> Fit:
    """How a gripper fits an arm.

    Raises:
        ValueError: it does not, or both files say how.
    """
    mine, theirs = arm.grippers.get(gripper.name), gripper.arms.get(arm.name)
    if mine is not None and theirs is not None:
        raise ValueError(
            f"{arm.mjcf.file} and {gripper.mjcf.file}: both models say how {gripper.name} fits {arm.name}; keep one"
        )
    if mine is None and theirs is None:
        fitting = ", ".join(sorted(arm.grippers)) or "none"
        raise ValueError(
            f"gripper {gripper.name!r} does not fit {arm.name!r}; that carries: {fitting}. If yours fits, say so under "
            "`arms` in its gripper.yaml"
        )
    found = mine if mine is not None else theirs
    assert found is not None
    return found
