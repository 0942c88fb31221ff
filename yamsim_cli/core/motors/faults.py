"""Faults on demand: a lost motor, a hot one, frames that get lost, a gripper that is stuck."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

from ..errors import UsageError

LOST, HOT, DROP, STUCK = "lost", "hot", "drop", "stuck"
# Kind -> its own keys, beside those that every fault has.
_KEYS = {LOST: ("motor",), HOT: ("motor", "celsius"), DROP: ("share",), STUCK: ()}
_COMMON = ("channel", "at", "for")
_EXAMPLE = "lost:motor=3,at=5,for=2"


@dataclass(frozen=True)
class Fault:
    """What goes wrong on a bus, and when.

    Attributes:
        kind: LOST, HOT, DROP or STUCK.
        channel: the bus; empty for all of them.
        motor: number of the motor that is lost or hot.
        at: when it begins, seconds after the simulation did.
        seconds: how long it lasts.
        celsius: how hot the rotor is kept.
        share: of the frames that get lost, in either direction.
    """

    kind: str
    channel: str = ""
    motor: int = 0
    at: float = 0.0
    seconds: float = float("inf")
    celsius: float = 110.0
    share: float = 0.1

    def acts(self, channel: str, now: float) -> bool:
        """Whether it is there on a channel at a time, s."""
        return self.channel in ("", channel) and self.at <= now < self.at + self.seconds


def parse_fault(text: str) -> Fault:
    """The fault that a flag names, such as `lost:motor=3,at=5,for=2`.

    Raises:
        UsageError: it is not of that form; the message says what would be.
    """
    kind, _, rest = text.partition(":")
    if kind not in _KEYS:
        raise UsageError(f"--fault {text!r}: unknown fault {kind!r}; valid: {', '.join(_KEYS)}, such as {_EXAMPLE}")
    valid = (*_KEYS[kind], *_COMMON)
    given: dict[str, Any] = {}
    for part in filter(None, rest.split(",")):
        key, _, value = part.partition("=")
        if key not in valid:
            raise UsageError(f"--fault {text!r}: a {kind} fault has no {key!r}; valid: {', '.join(valid)}")
        if key in given:
            raise UsageError(f"--fault {text!r}: {key} is there twice")
        given[key] = value if key == "channel" else _number(text, key, value)
    if "motor" in valid and "motor" not in given:
        raise UsageError(f"--fault {text!r}: say which motor, as in {kind}:motor=3")
    given["seconds"] = given.pop("for", Fault.seconds)
    if "motor" in given:
        given["motor"] = int(given["motor"])
    known = {field.name for field in fields(Fault)}
    return Fault(kind, **{key: value for key, value in given.items() if key in known})


_RANGES = {"motor": (1, 15), "at": (0, 86_400), "for": (0, 86_400), "celsius": (0, 250), "share": (0, 1)}


def _number(text: str, key: str, value: str) -> float:
    low, high = _RANGES[key]
    try:
        number = float(value)
    except ValueError:
        number = float("nan")
    if not low <= number <= high or (key == "motor" and not number.is_integer()):
        raise UsageError(f"--fault {text!r}: {key} {value!r} is not valid; it must lie in {low}..{high}")
    return number
