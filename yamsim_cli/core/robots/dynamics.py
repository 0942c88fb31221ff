from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat

from ..files.documents.config_base import Config, Name
from ..files.documents.units import QuantityBounds
from .models import ArmModel, Part

_Milliseconds = Annotated[FiniteFloat, QuantityBounds("ms", 0, 500)]


class JointDynamics(Config):
    """Dynamics of one joint. Keys that are left out keep the model's values.

    Attributes:
        armature: rotor inertia of the motor at the joint, kg m2.
        damping: passive damping, added to the drive's damping, N m s/rad.
        frictionloss: Coulomb friction, N m.
        kp, kv: gains of the drive, N m/rad and N m s/rad.
        offset_rad: encoder reading while the drive holds the joint at 0.
        gravity_factor: the arm's gravity compensation as a multiple of the joint's gravity load; 1 is exact.
    """

    armature: Annotated[FiniteFloat, QuantityBounds("kg m2", 0, 100)] | None = None
    damping: Annotated[FiniteFloat, QuantityBounds("N m s/rad", 0, 1e4)] | None = None
    frictionloss: Annotated[FiniteFloat, QuantityBounds("N m", 0, 1000)] | None = None
    kp: Annotated[FiniteFloat, QuantityBounds("N m/rad", 0, 1e5)] | None = None
    kv: Annotated[FiniteFloat, QuantityBounds("N m s/rad", 0, 1e4)] | None = None
    offset_rad: Annotated[FiniteFloat, QuantityBounds("rad", -0.5, 0.5)] = 0.0
    gravity_factor: Annotated[FiniteFloat, QuantityBounds("of 1", -5, 5)] = 1.0


class MeasuredArmDynamics(Config):
    """Measured dynamics of one real arm, as a named variant ("revision") of a robot model.

    Attributes:
        revision: name of the revision.
        base: name of the robot model whose values these dynamics replace.
        side: `left` or `right`, the arms of a rig that have these dynamics; if left out, all arms of the model.
        source: description of the recordings from which the values were identified.
        joints: joint -> its dynamics; other joints keep the model's dynamics.
        command_delay_ms: delay between a command and its effect.
        sensor_delay_ms: age of the encoders' readings.
        sensor_noise_rad: standard deviation of a joint's reading.
        encoder_step_rad: resolution of the encoders; 0 for continuous readings.
        tip_mass_g: mass at the site `pinch_site` in addition to the model's, without gravity compensation.
    """

    revision: Name
    base: Name
    side: Literal["left", "right"] | None = None
    source: str | None = None
    joints: dict[Part, JointDynamics] = Field(default_factory=dict)
    command_delay_ms: _Milliseconds = 0.0
    sensor_delay_ms: _Milliseconds = 0.0
    sensor_noise_rad: Annotated[FiniteFloat, QuantityBounds("rad", 0, 0.1)] = 0.0
    encoder_step_rad: Annotated[FiniteFloat, QuantityBounds("rad", 0, 0.1)] = 0.0
    tip_mass_g: Annotated[FiniteFloat, QuantityBounds("g", 0, 5000)] = 0.0

    def __hash__(self) -> int:
        """Hash the JSON, since the mapping inside has no hash."""
        return hash(self.model_dump_json())

    def joint(self, name: str) -> JointDynamics:
        """Return the dynamics of a joint; without an entry for it, values that change nothing."""
        return self.joints.get(name, JointDynamics())

    def check(self, arm: ArmModel) -> None:
        """Raise ValueError if the dynamics belong to another model than `arm`, or name a joint that `arm` lacks."""
        if self.base != arm.name:
            raise ValueError(f"revision {self.revision!r} is for {self.base!r}, but the arm is {arm.name!r}")
        names = [joint.name for joint in arm.joints]
        for name in self.joints:
            if name not in names:
                raise ValueError(
                    f"revision {self.revision!r} names an unknown joint {name!r}; valid: {', '.join(names)}"
                )
