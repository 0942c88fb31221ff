"""A target as numbers on a page, which a person can type over."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import viser

from ..geometry.se3 import Array, rotation_z

# What is typed counts once no digit has come for so long, s: on the way to 0.15, nobody wants 0.
_QUIET = 1.0


class TargetFields:
    """Fields that follow the target until someone types; from then they are that person's until it is taken.

    Not safe to call from several threads at once, but for the typing itself, which comes from the server's own.
    """

    def __init__(self, gui: viser.GuiApi) -> None:
        self._place = gui.add_vector3("target (m)", (0.0, 0.0, 0.0), step=0.001)
        self._heading = gui.add_number("heading (deg)", 0.0, min=-180.0, max=180.0, step=0.1)
        self._shown: tuple[tuple[float, ...], float] = ((0.0, 0.0, 0.0), 0.0)
        # When the last digit came, on a steady clock; None where nothing is left to be taken.
        self._typed_at: float | None = None
        # In the server's own loop: what was typed is known before anything that was done after it.
        self._place.on_update(self._type)
        self._heading.on_update(self._type)

    @property
    def typed(self) -> bool:
        """Whether there is something to take."""
        return self._typed_at is not None

    @property
    def ready(self) -> bool:
        """Whether there is something to take, and whoever typed it has finished."""
        typed_at = self._typed_at
        return typed_at is not None and time.monotonic() - typed_at >= _QUIET

    def take(self, target: Array) -> Array:
        """The target (4, 4) in `world` that the numbers ask for, where the last one was `target`."""
        self._typed_at = None
        (x, y, z), heading = self._place.value, self._heading.value
        (shown_place, shown_heading), T = self._shown, target.copy()
        # What was left alone stays as it is, to the last digit.
        for axis, (number, shown) in enumerate(zip((x, y, z), shown_place, strict=True)):
            if number != shown:
                T[axis, 3] = number
        if heading != shown_heading:
            T[:3, :3] = rotation_z(np.radians(heading) - heading_of(target)) @ target[:3, :3]
        self._shown = ((x, y, z), heading)
        return T

    def show(self, target: Array) -> None:
        """Follow the target, unless someone is typing."""
        x, y, z = (round(float(part), 3) for part in target[:3, 3])
        numbers = ((x, y, z), round(float(np.degrees(heading_of(target))), 1))
        # Compared with what was shown, not with what is in the fields: what has just been typed is not known of yet.
        if self.typed or numbers == self._shown:
            return
        self._shown = numbers
        # viser's setters take more types than their getters give, which mypy has no words for.
        self._place.value, self._heading.value = numbers  # type: ignore[misc]

    async def _type(self, event: Any) -> None:
        # Without a client, it was `show`.
        if event.client is not None:
            self._typed_at = time.monotonic()


def heading_of(T: Array) -> float:
    """The direction of the hand's y axis, along which the fingers close, in the world's xy plane, rad."""
    return float(np.arctan2(T[1, 1], T[0, 1]))
