"""The kinds of motors in the arms: what their frames can say, and what they are made of."""

from __future__ import annotations

from dataclasses import dataclass

from .frames import Scale

# Of the air around a motor, degrees Celsius.
AMBIENT = 25.0
# At its rated torque, a rotor comes to rest this much above the air: with the default limit of 100 degrees, a motor
# may give its rated torque for ever, and 1.2 times that for some minutes. No figures are published; an assumption.
_RATED_RISE = 55.0


@dataclass(frozen=True)
class MotorKind:
    """A kind of motor.

    Attributes:
        name: as the maker's SDK has it.
        scale: what its frames can say. Source: `motor_drivers/utils.py` in the maker's SDK 1.3.6.
        gear: ratio; its register tells which kind it is. Source: the same file.
        rated: torque that it can give for ever, N m. Source: DAMIAO's tables.
    """

    name: str
    scale: Scale
    gear: float
    rated: float

    @property
    def heating(self) -> float:
        """How many degrees a torque squared raises the rotor at rest, K/(N m)2."""
        return _RATED_RISE / self.rated**2


KINDS = {
    kind.name: kind
    for kind in (
        MotorKind("DM3507", Scale(12.5, 50.0, 5.0), 7.0, 1.2),
        MotorKind("DM4310", Scale(12.5, 30.0, 10.0), 10.0, 3.0),
        MotorKind("DM4340", Scale(12.5, 10.0, 28.0), 40.0, 9.0),
        MotorKind("DM6248", Scale(12.5, 20.0, 120.0), 48.0, 35.0),
    )
}
