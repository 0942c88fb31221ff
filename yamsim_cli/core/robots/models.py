"""Configs of arms and grippers: `model.yaml` and `gripper.yaml` in `robot_models/`, each with its MJCF."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree
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

from ..errors import ConfigError
from ..files.documents.config_base import (
    Config,
    ConflictError,
    Name,
    Quaternion,
    Vector,
    require_ordered,
)
from ..files.documents.units import FieldOfView, JointAngle, Offset, OffsetPoint, QuantityBounds
from ..files.documents.yaml_document import Document, load_yaml, read_config_bytes
from ..files.untrusted.confined_folder import ConfinedFolder
from ..files.untrusted.mjcf_includes import expand_includes
from ..files.untrusted.refusals import RefusedError
from ..geometry.se3 import Array, pose_from_quat
from .finray.finger import FinRay

Element = ElementTree.Element

# For an included file that is not in the folder of the MJCF.
_MISSING_INCLUDE_CODES = ("outside", "missing", "not-a-file")

Part = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_/-]+$")]
_Range = Annotated[tuple[JointAngle, JointAngle], AfterValidator(require_ordered)]
_Opening = Annotated[FiniteFloat, QuantityBounds("m", 1e-4, 0.5)]


class Mjcf(Config):
    """The content of an MJCF file beside a YAML file, so that a worker on another machine needs no file.

    Attributes:
        file: path of the file.
        text: the MJCF with its includes expanded.
        includes: whether the file includes others; if so, line numbers of `text` differ from the file's.
    """

    file: str
    text: str = Field(repr=False)
    includes: bool = False


def _refuse_inline_mjcf(value: object) -> object:
    if isinstance(value, str):
        raise ValueError("give the name of a robot or gripper, not its content; put its folder into robot_models/")
    return value


MjcfFile = Annotated[
    Mjcf,
    BeforeValidator(_refuse_inline_mjcf),
    PlainSerializer(lambda mjcf: mjcf.file, return_type=str, when_used="json"),
    WithJsonSchema({"type": "string"}),
]


class JointLimits(Config):
    """The limits of a joint.

    Attributes:
        range: lower and upper joint limit, rad.
        motor_rpm: the motor's no-load speed at the joint, revolutions per minute.
        reported_rad_s: the largest speed that the drive can report, rad/s.
    """

    name: Part
    range: _Range
    motor_rpm: Annotated[FiniteFloat, QuantityBounds("rpm", 1, 10_000)]
    reported_rad_s: Annotated[FiniteFloat, QuantityBounds("rad/s", 0.1, 1000)]

    @property
    def motor_rad_s(self) -> float:
        """The motor's no-load speed, rad/s."""
        return self.motor_rpm * 2 * math.pi / 60


class JointChange(Config):
    """Values of a joint that replace values of the arm's files.

    Attributes:
        range: lower and upper joint limit, rad.
        kp, kv: gains of the drive, N m/rad and N m s/rad.
        torque: largest torque of the drive, N m.
        armature: rotor inertia of the motor at the joint, kg m2.
        frictionloss: Coulomb friction, N m.
    """

    range: _Range | None = None
    kp: Annotated[FiniteFloat, QuantityBounds("N m/rad", 0, 1e5)] | None = None
    kv: Annotated[FiniteFloat, QuantityBounds("N m s/rad", 0, 1e4)] | None = None
    torque: Annotated[FiniteFloat, QuantityBounds("N m", 1e-3, 1e4)] | None = None
    armature: Annotated[FiniteFloat, QuantityBounds("kg m2", 0, 100)] | None = None
    frictionloss: Annotated[FiniteFloat, QuantityBounds("N m", 0, 1000)] | None = None


class Placement(Config):
    """The pose of one frame in another frame: position (m) and quaternion (w, x, y, z)."""

    position: OffsetPoint = (0.0, 0.0, 0.0)
    quat: Quaternion = (1.0, 0.0, 0.0, 0.0)

    @property
    def T(self) -> Array:
        """The pose as a matrix (4, 4)."""
        return pose_from_quat(self.position, self.quat)


class GripperFit(Config):
    """How a gripper is mounted on an arm, and what it changes in the arm.

    Attributes:
        mount: pose of the gripper's frame in the flange's frame.
        joints: joint of the arm -> values that hold with this gripper.
        excludes: pairs of bodies between which collisions are disabled when this gripper is mounted.
    """

    mount: Placement = Placement()
    joints: dict[Part, JointChange] = Field(default_factory=dict)
    excludes: tuple[tuple[Part, Part], ...] = ()


class CameraMode(Config):
    """An image size (width, height in px) of a camera, and the vertical field of view at this size."""

    size_px: tuple[Annotated[int, Field(ge=16, le=4096)], Annotated[int, Field(ge=16, le=4096)]]
    fovy_deg: Annotated[FieldOfView, Field(gt=1, lt=179)]


Fovy = Annotated[FieldOfView, Field(gt=1, lt=179)]
Modes = tuple[CameraMode, ...]


class WristCamera(Config):
    """A camera on the flange: position (m) and axes of its OpenCV frame (x right, y down, z forward) in the flange's.

    Attributes:
        fovy_deg: vertical field of view.
        modes: image sizes at which the field of view differs from `fovy_deg`.
        name: name of the recorded images; if left out, `<side>_wrist_camera`.
    """

    position: OffsetPoint
    x_axis: Vector
    y_axis: Vector
    fovy_deg: Fovy
    modes: Modes = ()
    name: Name | None = None

    def fovy(self, size: tuple[int, int]) -> float:
        """Return the vertical field of view, degrees, of images of a size (width, height), px."""
        return fovy_for_size(size, self.fovy_deg, self.modes)


def fovy_for_size(size: tuple[int, int], fovy_deg: float, modes: tuple[CameraMode, ...]) -> float:
    """Return the field of view (degrees) of the mode with `size` (width, height), px; `fovy_deg` if none."""
    return next((mode.fovy_deg for mode in modes if mode.size_px == size), fovy_deg)


def _read_mjcf(path: Path) -> dict[str, object]:
    data = read_config_bytes(path)
    try:
        text = data.decode()
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: is not UTF-8: {error.reason}") from error
    if "<include" not in text:
        return {"file": str(path), "text": text}
    folder = path.parent.resolve()
    try:
        root = expand_includes(data, ConfinedFolder(folder), folder, parse_root)
    except RefusedError as error:
        mend = f"; an <include> names an MJCF below {path.parent}" if error.code in _MISSING_INCLUDE_CODES else ""
        raise ConfigError(f"{path}: {error}{mend}") from error
    return {"file": str(path), "text": ElementTree.tostring(root, encoding="unicode"), "includes": True}


def parse_root(data: str | bytes) -> Element:
    """Return the root element of an XML text. Raises RefusedError if the text is no XML, or declares entities."""
    text = data if isinstance(data, str) else data.decode(errors="replace")
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise RefusedError("xml-entities", "declares a document type, which no MJCF needs; remove it")
    try:
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise RefusedError("damaged", f"not valid XML: {error}") from error


class _FolderConfig(Config):
    """A config with the name of its folder, and an MJCF beside its YAML."""

    name: Name
    mjcf: MjcfFile
    source: str | None = None

    def __hash__(self) -> int:
        """The mappings in the config have no hash."""
        return hash((self.name, self.mjcf.text))

    @classmethod
    def read_document(cls, path: Path) -> Document:
        """Return the YAML document with the content of its MJCF.

        Raises ConfigError if a file cannot be read, or the name differs from the folder's.
        """
        document = load_yaml(path)
        name = path.absolute().parent.name
        if document.data.setdefault("name", name) != name:
            given = document.data["name"]
            raise ConfigError(f"{document.place_of(('name',))}: name: {given!r} is in folder {name!r}; leave it out")
        file = document.data.get("mjcf")
        if isinstance(file, str):
            document.data["mjcf"] = _read_mjcf(path.with_name(file))
        return document


class ArmModel(_FolderConfig):
    """A robot model: an arm without its gripper.

    Attributes:
        name: name of the folder `robot_models/<name>/`; may be left out.
        source: origin of the figures, in a few words.
        mjcf: the MJCF file beside the YAML. The file has the arm's bodies up to the flange and a position drive for
            each joint, but no joint limits.
        base: the body whose frame is the arm's base frame.
        flange: the last body, which turns with the last joint. A gripper becomes part of this body.
        base_mesh: pose, in the base frame, of the frame in which fiducial boards and their mounts are given.
        mesh_sets: the asset sets of the MJCF's meshes.
        joints: joints from the base to the flange.
        home: joint positions of the idle arm, rad.
        start: joint positions at the start of tasks without `start_joints`, rad; `home` if left out.
        grippers: gripper -> how it is mounted on this arm, unless the gripper's file has an entry for this model.
        family, revision: product and version of the model. A family's name alone stands for its newest version.
    """

    base: Part
    flange: Part
    base_mesh: Placement = Placement()
    mesh_sets: tuple[Name, ...] = ()
    joints: Annotated[tuple[JointLimits, ...], Field(min_length=1)]
    home: tuple[JointAngle, ...]
    start: tuple[JointAngle, ...] | None = None
    grippers: dict[Name, GripperFit] = Field(default_factory=dict)
    family: Name | None = None
    revision: Name | None = None

    @model_validator(mode="after")
    def _revision_of_a_family(self) -> ArmModel:
        if (self.family is None) != (self.revision is None):
            raise ConflictError("give `family` and `revision` together, or neither", ("family",), ("revision",))
        return self

    @model_validator(mode="after")
    def _check_one_value_per_joint(self) -> ArmModel:
        names = [joint.name for joint in self.joints]
        if len(set(names)) < len(names):
            raise ConflictError(f"two joints have the same name: {', '.join(names)}", ("joints",))
        for key, values in (("home", self.home), ("start", self.home if self.start is None else self.start)):
            if len(values) != len(names):
                raise ConflictError(f"has {len(values)} values; give one for each of {', '.join(names)}", (key,))
            for value, joint in zip(values, self.joints, strict=True):
                low, high = joint.range
                if not low <= value <= high:
                    raise ConflictError(f"{joint.name}: {value:g} rad lies outside {low:g}..{high:g}", (key,))
        return self


class Fingers(Config):
    """Two fingers that one drive opens and closes.

    Attributes:
        joints: slide joints of the left and the right finger, which an equality of the MJCF may couple.
        bodies: bodies of the left and the right finger on these joints. Child bodies belong to the finger.
        drive: the actuator of the left finger's joint; its command is that finger's opening, m.
        range: lower and upper limit of one finger's opening, m; 0 is closed. The MJCF must have no range for its joint.
        full_opening: largest opening of one finger in use, m.
        start_opening: opening of one finger at the start of a task, m; `full_opening` if left out.
        radius: half of a finger's width near its tip, m: the space that a finger needs beside an object.
        pads: whether the fingers have pads that can hold an object by friction.
    """

    joints: tuple[Part, Part]
    bodies: tuple[Part, Part]
    drive: Part = "gripper"
    range: Annotated[tuple[Offset, Offset], AfterValidator(require_ordered)]
    full_opening: _Opening
    start_opening: _Opening | None = None
    radius: _Opening
    pads: bool

    @property
    def initial_opening(self) -> float:
        """Opening of one finger at the start of a task, m."""
        return self.full_opening if self.start_opening is None else self.start_opening

    @model_validator(mode="after")
    def _within_the_stops(self) -> Fingers:
        for key in ("full_opening", "start_opening"):
            value = getattr(self, key)
            if value is not None and value > self.range[1]:
                raise ConflictError(f"{value:g} m is beyond the finger's limit of {self.range[1]:g} m", (key,))
        return self


class Gripper(_FolderConfig):
    """A gripper, which becomes part of an arm's flange.

    Attributes:
        name: name of the folder `robot_models/grippers/<name>/`; may be left out.
        source: origin of the figures, in a few words.
        mjcf: the MJCF file beside the YAML. The file has one body, the gripper's frame, whose content becomes part of
            the flange. Its `inertial` covers flange and gripper together. Equalities, excludes and actuators are
            added to the arm's. The site `pinch_site` lies where the fingers meet: z into the grasp, y along closing.
        mesh_sets: the asset sets of the MJCF's meshes.
        fingers: None for a gripper without fingers.
        finray: dimensions of soft fingers, which are generated on two bodies of the MJCF.
        wrist_camera: the wrist camera of an arm with this gripper, unless the rig has another.
        arms: robot model -> how the gripper is mounted on it, unless the model's file has an entry for this gripper.
    """

    mesh_sets: tuple[Name, ...] = ()
    fingers: Fingers | None = None
    finray: FinRay | None = None
    wrist_camera: WristCamera | None = None
    arms: dict[Name, GripperFit] = Field(default_factory=dict)


def find_gripper_fit(arm: ArmModel, gripper: Gripper) -> GripperFit:
    """Return how a gripper is mounted on an arm. Raises ValueError if neither or both of their files define this."""
    mine, theirs = arm.grippers.get(gripper.name), gripper.arms.get(arm.name)
    if mine and theirs:
        raise ValueError(
            f"{arm.mjcf.file} and {gripper.mjcf.file}: both say how {gripper.name} fits {arm.name}; keep one"
        )
    if found := mine or theirs:
        return found
    fitting = ", ".join(sorted(arm.grippers)) or "none"
    raise ValueError(
        f"gripper {gripper.name!r} does not fit {arm.name!r}; valid: {fitting}; if your gripper fits, add the arm "
        "under `arms` in its gripper.yaml"
    )
