"""How one arm moves otherwise than its model: what `yamsim identify` writes, and what simulations then follow."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat

from ..documents.base import Config, Name
from ..documents.units import Within
from .models import ArmModel, Part

_Milliseconds = Annotated[FiniteFloat, Within("ms", 0, 500)]


class JointDynamics(Config):
    """How one joint moves; what is left out is as the model says.

    Attributes:
        armature: of its motor at the joint, kg m2.
        damping: passive, beside that of the drive, N m s/rad.
        frictionloss: Coulomb friction, N m.
        kp, kv: gains of its drive, N m/rad and N m s/rad.
        offset_rad: what the encoder reads where the drive holds the joint at 0.
        gravity_factor: how many times the joint's weight its gravity compensation makes up for; 1 is exactly.
    """

    armature: Annotated[FiniteFloat, Within("kg m2", 0, 100)] | None = None
    damping: Annotated[FiniteFloat, Within("N m s/rad", 0, 1e4)] | None = None
    frictionloss: Annotated[FiniteFloat, Within("N m", 0, 1000)] | None = None
    kp: Annotated[FiniteFloat, Within("N m/rad", 0, 1e5)] | None = None
    kv: Annotated[FiniteFloat, Within("N m s/rad", 0, 1e4)] | None = None
    offset_rad: Annotated[FiniteFloat, Within("rad", -0.5, 0.5)] = 0.0
    gravity_factor: Annotated[FiniteFloat, Within("of 1", -5, 5)] = 1.0


class Dynamics(Config):
    """A named revision of a robot model: of one arm, as it was measured.

    Attributes:
        revision: what it is called.
        base: the robot model that it is a revision of.
        side: of which arms of a rig it is, `left` or `right`; left out, of all that have the model.
        source: what it was identified from, in a few words.
        joints: joint -> how it moves. Others move as the model says.
        command_delay_ms: how long after it was told a command acts.
        sensor_delay_ms: how old what the encoders read is.
        sensor_noise_rad: standard deviation of what a joint reads.
        encoder_step_rad: between two values that an encoder can read; 0 for any.
        tip_mass_g: at the site `pinch_site`, beside what the model weighs; no gravity compensation knows of it.
    """

    revision: Name
    base: Name
    side: Literal["left", "right"] | None = None
    source: str | None = None
    joints: dict[Part, JointDynamics] = Field(default_factory=dict)
    command_delay_ms: _Milliseconds = 0.0
    sensor_delay_ms: _Milliseconds = 0.0
    sensor_noise_rad: Annotated[FiniteFloat, Within("rad", 0, 0.1)] = 0.0
    encoder_step_rad: Annotated[FiniteFloat, Within("rad", 0, 0.1)] = 0.0
    tip_mass_g: Annotated[FiniteFloat, Within("g", 0, 5000)] = 0.0

    def __hash__(self) -> int:
        """Equal ones say the same; the mapping inside could not be hashed."""
        return hash(self.model_dump_json())

    def joint(self, name: str) -> JointDynamics:
        """How a joint moves."""
        return self.joints.get(name, JointDynamics())

    def check(self, arm: ArmModel) -> None:
        """Hold it to the arm that it is to be of.

        Raises:
            ValueError: it is of another, or names a joint that the arm has not.
        """
        if self.base != arm.name:
            raise ValueError(f"revision {self.revision!r} is one of {self.base!r}, and the arm is {arm.name!r}")
        names = [joint.name for joint in arm.joints]
        for name in self.joints:
            if name not in names:
                raise ValueError(f"revision {self.revision!r} names joint {name!r}; {arm.name} has {', '.join(names)}")
