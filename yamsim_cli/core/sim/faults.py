"""What goes wrong in physics: what touches that must not touch, and physics that breaks down."""

from __future__ import annotations

import mujoco

from ..scene.breakdown import breakdown
from ..scene.compiled import CompiledScene


class Faults:
    """Looks at a simulation, and keeps the first fault of each kind.

    Attributes:
        collision: what touched something that it must not touch, and when; None if nothing did.
        breakdown: what went wrong in physics itself, and when; None if nothing did.
    """

    def __init__(self, scene: CompiledScene) -> None:
        self._scene = scene
        self._timestep = float(scene.model.opt.timestep)
        self._steps = 0
        self.collision: str | None = None
        self.breakdown: str | None = None

    def step(self, data: mujoco.MjData) -> None:
        """Observe the state after a physics step."""
        self._steps += 1
        if self.collision is None:
            geoms = data.contact.geom
            forbidden = self._scene.forbidden(geoms)
            if forbidden.any():
                names = " and ".join(self._scene.model.geom(int(geom)).name for geom in geoms[forbidden][0])
                self.collision = f"{names} touch after {data.time:.2f} s"

    def end_tick(self, data: mujoco.MjData) -> None:
        """Observe the state after a control tick's last step."""
        if self.breakdown is None and (text := breakdown(data)):
            # The time is counted in steps, since MuJoCo has reset its own clock.
            self.breakdown = f"physics broke down within {self._steps * self._timestep:.3f} s: {text}"
