"""Fields on a page that show the hand's target, and in which a person can type another."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import viser

from ..geometry.se3 import Array, rotation_z

# Typed numbers count once no key was pressed for so long, s: whoever types 0.15 does not want 0 on the way.
_QUIET = 1.0


class TargetFields:
    """Fields that follow the target until someone types. From then they keep what was typed until it is taken.

    Not to be called from several threads at once. Only the typing itself comes from the server's own thread.
    """

    def __init__(self, gui: viser.GuiApi) -> None:
        self._place = gui.add_vector3("target (m)", (0.0, 0.0, 0.0), step=0.001)
        self._heading = gui.add_number("heading (deg)", 0.0, min=-180.0, max=180.0, step=0.1)
        self._shown: tuple[tuple[float, ...], float] = ((0.0, 0.0, 0.0), 0.0)
        # When the last key was pressed, on a steady clock; None if there is nothing to take.
        self._typed_at: float | None = None
        # Coroutines run in the server's own loop, so that typing is noted before anything that is done after it.
        self._place.on_update(self._type)
        self._heading.on_update(self._type)

    @property
    def typed(self) -> bool:
        """Whether there is something to take."""
        return self._typed_at is not None

    @property
    def ready(self) -> bool:
        """Whether there is something to take, and the typing has ended."""
        typed_at = self._typed_at
        return typed_at is not None and time.monotonic() - typed_at >= _QUIET

    def take(self, target: Array) -> Array:
        """The target (4, 4) in `world` by the typed numbers, where the last one was `target`."""
        self._typed_at = None
        (x, y, z), heading = self._place.value, self._heading.value
        (shown_place, shown_heading), T = self._shown, target.copy()
        # Numbers that were not changed keep the target's full precision.
        for axis, (number, shown) in enumerate(zip((x, y, z), shown_place, strict=True)):
            if number != shown:
                T[axis, 3] = number
        if heading != shown_heading:
            T[:3, :3] = rotation_z(np.radians(heading) - heading_of(target)) @ target[:3, :3]
        self._shown = ((x, y, z), heading)
        return T

    def show(self, target: Array) -> None:
        """Show the target, unless someone is typing."""
        x, y, z = (round(float(part), 3) for part in target[:3, 3])
        numbers = ((x, y, z), round(float(np.degrees(heading_of(target))), 1))
        # Compared with what was shown and not with the fields: they may have been typed in just now, unnoted yet.
        if self.typed or numbers == self._shown:
            return
        self._shown = numbers
        # viser's setters take more types than their getters return, which mypy cannot express.
        self._place.value, self._heading.value = numbers  # type: ignore[misc]

    async def _type(self, event: Any) -> None:
        # Without a client, it was `show` that changed them.
        if event.client is not None:
            self._typed_at = time.monotonic()


def heading_of(T: Array) -> float:
    """The direction of the hand's y axis, along which the fingers close, in the world's xy plane, rad."""
    return float(np.arctan2(T[1, 1], T[0, 1]))
