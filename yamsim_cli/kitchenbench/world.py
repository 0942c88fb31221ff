"""What the benchmark's checkers ask of a scene, answered from its state."""

from __future__ import annotations

import numpy as np

from ..core.geometry.se3 import Array
from ..core.scene.compiled import Kind
from ..core.sim.shapes import geom_bounds
from ..core.sim.world import SimWorld
from .motion import Motion
from .scene import Realization

_GRIPPER = "gripper_"


class KitchenWorld:
    """The state of a scene in motion, by the names of its blueprint's objects, and `gripper_left`, `gripper_right`.

    Every query raises `KeyError` for a name that the scene does not have. Lengths are in m, in our `world`: x ahead of
    the arms, y to their left, z up.

    Attributes:
        scene: the same, as our own goals and skills ask it.
    """

    def __init__(self, realization: Realization, motion: Motion) -> None:
        simulator = realization.simulator
        compiled = simulator.scene
        self._model, self._data = compiled.model, motion.data
        names = list(compiled.things)
        self._masses = {item.name: 1000 * item.inertia.mass for item in simulator.config.task.objects}
        self.scene: SimWorld = motion.episode.world
        self._names = {*names, *realization.regions}
        fingers = np.isin(compiled.geom_kind, (Kind.LEFT_FINGER, Kind.RIGHT_FINGER)) & (
            compiled.model.geom_contype != 0
        )
        self._grippers = {
            _GRIPPER + side: np.flatnonzero(fingers & (compiled.geom_arm == k))
            for k, side in enumerate(realization.sides)
        }

    def aabb(self, name: str) -> tuple[Array, Array]:
        """The lowest and the highest corner (3,) of what collides of an object; of a gripper, of its two fingers."""
        if name in self._grippers:
            corners = np.array([geom_bounds(self._model, self._data, int(geom)) for geom in self._grippers[name]])
            return corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)
        return self.scene.bounds(self._known(name))

    def contained_fraction(self, item: str, container: str) -> float:
        """The share, 0..1, of an item's volume that lies in the block around a container, or in a compartment."""
        return self.scene.share_in_block(self._known(item), self._known(container))

    def contained_mass_g(self, substance: str, container: str) -> float:
        """How much of a thing, g, lies in a container. Nothing here is poured, so a substance is a thing."""
        if substance not in self._masses:
            raise KeyError(substance)
        return self._masses[substance] * self.contained_fraction(substance, container)

    def opening_fraction(self, name: str) -> float:
        """How far an object is open: 0, since nothing that is realized has a part that opens."""
        self._known(name)
        return 0.0

    def _known(self, name: str) -> str:
        if name not in self._names:
            raise KeyError(name)
        return name
