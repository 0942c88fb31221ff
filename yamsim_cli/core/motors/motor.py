"""One motor: it takes frames, answers, and says by which law it gives torque. It knows no physics and no sockets."""

from __future__ import annotations

from enum import IntEnum

from . import frames, registers
from .frames import Frame, Mit, Scale
from .kinds import AMBIENT, MotorKind
from .registers import Registers

# Of the rotor, s: how fast it warms up and cools down. No figure is published; an assumption.
_THERMAL_SECONDS = 300.0
# The driver warms up by this share of what the rotor does. The same.
_DRIVER_SHARE = 0.5
# Of the driver; the rotor's limit is a register. Source: DAMIAO's manual of the DM-J43 series, "protections".
_DRIVER_LIMIT = 120.0
_REST = Mit(0.0, 0.0, 0.0, 0.0, 0.0)


class Status(IntEnum):
    """What a motor tells of itself in each answer. Source: DAMIAO's manual, "feedback frame"."""

    DISABLED = 0x0
    ENABLED = 0x1
    DRIVER_TOO_HOT = 0xB
    ROTOR_TOO_HOT = 0xC
    LOST_COMMUNICATION = 0xD


class Motor:
    """A motor on a bus. Positions and the like are those of its output shaft, in its own sense of turning.

    Attributes:
        number: its CAN identifier when it was made, by which people name it.
        kind: of which it is.
        registers: what it is set to.
        status: what it tells of itself.
        position, velocity, torque: of the shaft, rad, rad/s and N m, as whoever simulates it last said.
        celsius: temperature of its rotor.
        lost: its plug is out: it hears nothing, says nothing and gives no torque.
        law_changed: whether `law` gives something else than when this was last set to False.
    """

    def __init__(self, number: int, kind: MotorKind) -> None:
        self.number = number
        self.kind = kind
        self.registers = Registers(kind, number)
        self.status = Status.DISABLED
        self.position = self.velocity = self.torque = 0.0
        self.celsius = AMBIENT
        self.lost = False
        self.law_changed = True
        self._command = _REST
        self._zero = 0.0
        self._heard = 0.0
        self._scale = kind.scale

    @property
    def answers_to(self) -> int:
        """The identifier that it listens to."""
        return int(self.registers[registers.ESC_ID])

    @property
    def most_torque(self) -> float:
        """The most that it gives, N m."""
        return min(self._scale.torque, self.kind.scale.torque)

    @property
    def driver_celsius(self) -> float:
        """Temperature of its driver's transistors."""
        return AMBIENT + _DRIVER_SHARE * (self.celsius - AMBIENT)

    def law(self) -> tuple[float, float, float]:
        """(kp, kd, constant): it gives `constant - kp position - kd velocity`, N m, up to `most_torque`."""
        if self.status is not Status.ENABLED or self.lost:
            return 0.0, 0.0, 0.0
        told = self._command
        constant = told.kp * (told.position + self._zero) + told.kd * told.velocity + told.torque
        return told.kp, told.kd, constant

    def hear(self, frame: Frame, now: float) -> Frame | None:
        """Take a frame from the bus at a time (s).

        Returns:
            Its answer; None if it is not meant.
        """
        if self.lost:
            return None
        if frame.id == frames.TO_ALL:
            return self._administer(frame.data)
        if frame.id != self.answers_to or len(frame.data) != 8:
            return None
        asked = frames.special(frame.data)
        if asked is None:
            if self.registers[registers.CTRL_MODE] != registers.MIT_MODE:
                return None
            # What arrives while it is not enabled is answered, and does not act later either.
            self._command = frames.read_mit(frame.data, self._scale) if self.status is Status.ENABLED else _REST
        else:
            self._order(asked)
        self._heard = now
        self.law_changed = True
        return self._answer()

    def drive(self, told: Mit, now: float) -> None:
        """Do what a MIT frame would make it do that comes now, enabling it first; an error stays."""
        if self.lost:
            return
        if self.status is Status.DISABLED:
            self.status = Status.ENABLED
        if self.status is Status.ENABLED:
            self._command = told._replace(position=told.position - self._zero)
        self._heard = now
        self.law_changed = True

    def passes(self, now: float, seconds: float) -> None:
        """Let time pass: it warms up by what it gives, and fails when it is too hot or has heard nothing for long."""
        rise = self.kind.heating * self.torque**2
        self.celsius += (AMBIENT + rise - self.celsius) * min(1.0, seconds / _THERMAL_SECONDS)
        if self.status is not Status.ENABLED:
            return
        patience = self.registers[registers.TIMEOUT] * registers.TIMEOUT_UNIT
        if self.celsius > self.registers[registers.OT_VALUE]:
            self._fail(Status.ROTOR_TOO_HOT)
        elif self.driver_celsius > _DRIVER_LIMIT:
            self._fail(Status.DRIVER_TOO_HOT)
        elif patience and now - self._heard > patience:
            self._fail(Status.LOST_COMMUNICATION)

    def unplug(self) -> None:
        """Take its plug out."""
        self.lost = True
        self.law_changed = True

    def plug_in(self) -> None:
        """Give it its power again: it is disabled, and knows what was saved."""
        self.lost = False
        self.registers.restart()
        self._rescale()
        self.status, self._command = Status.DISABLED, _REST
        self.law_changed = True

    def _fail(self, status: Status) -> None:
        self.status, self._command = status, _REST
        self.law_changed = True

    def _order(self, asked: int) -> None:
        if asked == frames.ENABLE:
            if self.status is Status.DISABLED:
                self.status, self._command = Status.ENABLED, _REST
        elif asked == frames.SET_ZERO:
            self._zero = self.position
        elif asked == frames.DISABLE:
            # An error stays until it is cleared.
            self._command = _REST
            if self.status is Status.ENABLED:
                self.status = Status.DISABLED
        elif self.status is not Status.ENABLED:
            self.status = Status.DISABLED

    def _answer(self) -> Frame:
        celsius = self.driver_celsius, self.celsius
        state = self.position - self._zero, self.velocity, self.torque
        data = frames.feedback(self.answers_to, self.status, *state, celsius, self._scale)
        return Frame(int(self.registers[registers.MST_ID]), data)

    def _administer(self, data: bytes) -> Frame | None:
        """Take a frame to all: registers, or a wish to hear how it is."""
        if len(data) < 4 or int.from_bytes(data[:2], "little") != self.answers_to:
            return None
        what, register = data[2], data[3]
        if what == frames.REFRESH:
            return self._answer()
        self.registers.show(registers.XOUT, self.position - self._zero)
        self.registers.show(registers.ROTOR_POSITION, (self.position - self._zero) * self.kind.gear)
        if what == frames.READ:
            value = self.registers.read(register)
        elif what == frames.WRITE and len(data) == 8:
            value = self.registers.write(register, data[4:8])
            self._rescale()
        elif what == frames.SAVE:
            # It keeps registers only while it stands still, and answers with a short frame.
            kept = self.status is not Status.ENABLED and self.registers.save(register)
            return self._said(bytes([frames.SAVE, kept]))
        else:
            return None
        return None if value is None else self._said(bytes([what, register]) + value)

    def _said(self, what: bytes) -> Frame:
        # A new identifier counts at once.
        return Frame(int(self.registers[registers.MST_ID]), self.answers_to.to_bytes(2, "little") + what)

    def _rescale(self) -> None:
        known = self.registers
        self._scale = Scale(known[registers.PMAX], known[registers.VMAX], known[registers.TMAX])
