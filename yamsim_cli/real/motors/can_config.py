"""Motors of an arm and its gripper, from `can.yaml` in their model folders."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import AfterValidator, Field, FiniteFloat, ValidationError

from yamsim_cli.core.errors import ConfigError
from yamsim_cli.core.files.documents.config_base import Config
from yamsim_cli.core.files.documents.validation_messages import explain_validation_error
from yamsim_cli.core.files.resources import Locations, config_path_pattern

from .motor import MOTOR_KINDS


def _require_known_kind(name: str) -> str:
    if name not in MOTOR_KINDS:
        raise ValueError(f"unknown motor {name!r}; valid: {', '.join(MOTOR_KINDS)}")
    return name


MotorNumber = Annotated[int, Field(ge=1, le=15)]
KindName = Annotated[str, AfterValidator(_require_known_kind)]


class JointMotor(Config):
    """The motor of a joint.

    Attributes:
        id: CAN identifier.
        kind: key of `motor.KINDS`.
        direction: 1 if the motor turns in the joint's direction, else -1.
        load: factor of the joint's gravity torque in the simulation.
    """

    id: MotorNumber
    kind: KindName
    direction: Annotated[int, Field(ge=-1, le=1)] = 1
    load: Annotated[FiniteFloat, Field(ge=0, le=3)] = 1.0


class ArmCanConfig(Config):
    """The motors of an arm's joints, from the base to the flange."""

    motors: Annotated[tuple[JointMotor, ...], Field(min_length=1)]


class GripperCanConfig(Config):
    """A gripper's motor, which moves both fingers.

    Attributes:
        id: CAN identifier.
        kind: key of `motor.KINDS`.
        closed, opened: shaft angles, rad.
        stroke: travel of one finger, m.
        armature: rotor inertia at the shaft, kg m2.
        friction: Coulomb friction at the shaft, N m.
        kp, kd: of the drive, N m/rad and N m s/rad.
    """

    id: MotorNumber
    kind: KindName
    closed: FiniteFloat
    opened: FiniteFloat
    stroke: Annotated[FiniteFloat, Field(gt=0, lt=0.5)]
    armature: Annotated[FiniteFloat, Field(gt=0, lt=1)]
    friction: Annotated[FiniteFloat, Field(ge=0, lt=10)]
    kp: Annotated[FiniteFloat, Field(gt=0, le=500)]
    kd: Annotated[FiniteFloat, Field(ge=0, le=5)]

    @property
    def shaft_ratio(self) -> float:
        """Shaft angle per travel of one finger, rad/m."""
        return (self.opened - self.closed) / self.stroke


@dataclass(frozen=True)
class CanConfig:
    """All motors; `gripper` is None without fingers."""

    arm: ArmCanConfig
    gripper: GripperCanConfig | None


def load_can_config(model: str, gripper: str | None, joints: int, locations: Locations) -> CanConfig:
    """Read the motors of an arm and its gripper from their model folders `model` and `gripper`.

    Raises:
        ConfigError: a file is missing or invalid, the number of motors is wrong, or two motors share an identifier.
    """
    place = _find_can_yaml("robots", model, locations)
    arm = _read_motor_config(ArmCanConfig, place)
    if len(arm.motors) != joints:
        raise ConfigError(f"{place}: has {len(arm.motors)} motors, and {model} has {joints} joints; give one for each")
    hand = (
        None
        if gripper is None
        else _read_motor_config(GripperCanConfig, _find_can_yaml("grippers", gripper, locations))
    )
    numbers = [motor.id for motor in arm.motors] + ([hand.id] if hand else [])
    if len(set(numbers)) < len(numbers):
        raise ConfigError(f"{place}: two motors have the same id among {numbers}; each needs its own on its bus")
    return CanConfig(arm, hand)


def _find_can_yaml(kind: str, name: str, locations: Locations) -> Path:
    folder = Path(config_path_pattern(kind).replace("*", name)).parent
    for root in locations.data:
        if (root / folder / "can.yaml").is_file():
            return root / folder / "can.yaml"
    wired = sorted({path.parent.name for root in locations.data for path in (root / folder.parent).glob("*/can.yaml")})
    raise ConfigError(f"{name} has no can.yaml, which lists its motors; valid: {', '.join(wired)}")


W = TypeVar("W", bound=Config)


def _read_motor_config(model: type[W], path: Path) -> W:
    document = model.read_document(path)
    try:
        return model.model_validate(document.data)
    except ValidationError as error:
        place, message = explain_validation_error(model, document, error, {})
        raise ConfigError(f"{place}: {message}") from error
