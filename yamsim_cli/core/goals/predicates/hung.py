"""Whether things hang on a peg."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from ...documents.units import Distance
from ...geometry.se3 import inverse
from ..cast import Cast
from ..measure import Measure, either
from ..world import TABLE, World
from .base import Predicate, still_held


class Hung(Predicate):
    """A peg goes through an eye of each thing, which is off the table, and no hand holds it.

    Held for a time, that is hanging: what falls does not stay there. A thing that swings leaves the peg for moments.

    Attributes:
        thing, onto: roles: what hangs, and what has the peg.
        eye, peg: names of their handles: the middle of the opening, which points through it, and the peg's tip, which
            points towards its root.
        radius: how far beside the middle of the eye the peg's middle may pass, m.
        depth: how far behind the tip the eye has to be, m.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "onto")
    IN_HAND: ClassVar[bool | None] = False
    thing: str
    onto: str
    eye: str = "eye"
    peg: str = "peg"
    radius: Distance = 0.022
    depth: Distance = 0.015

    def measures(self, world: World, cast: Cast) -> list[Measure]:
        """See `Predicate`."""
        return [self._measure(world, *pair) for pair in cast.pairs(self.thing, self.onto)]

    def _measure(self, world: World, thing: str, onto: str) -> Measure:
        what = f"hung({thing}, {onto})"
        if held := still_held(world, thing, what):
            return held
        if world.touching(thing, TABLE):
            return either(what, False, "it touches the table")
        T_eye_in_peg = inverse(world.mark(onto, self.peg)) @ world.mark(thing, self.eye)
        (x, y, z), through = T_eye_in_peg[:3, 3], T_eye_in_peg[:3, 2]
        # The peg is the z axis, which meets the eye's plane so far behind the tip; it goes along the plane at worst.
        behind = float(T_eye_in_peg[:3, 3] @ through / through[2]) if abs(through[2]) > 1e-6 else -np.inf
        off = float(np.linalg.norm((x, y, z - behind)))
        told = f"the peg {off * 1000:.0f} mm beside the eye's middle, its tip {behind * 1000:.0f} mm through"
        return Measure(what, min(self.radius - off, behind - self.depth), "m", told)
