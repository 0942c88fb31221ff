"""What a fin-ray finger is made like."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from ...documents.base import Config, ConflictError
from ...documents.units import Within
from ...geometry.se3 import Array

_Length = Annotated[FiniteFloat, Within("mm", 20, 300)]
_Across = Annotated[FiniteFloat, Within("mm", 2, 100)]
_Thickness = Annotated[FiniteFloat, Within("mm", 0.2, 10)]

# A wall thicker than this share of what is between two stations is no beam any more.
_SLENDER = 0.5


class FinRay(Config):
    """A finger: a front wall that touches things, a back wall, and ribs across, all of one soft material.

    The front wall stands straight up from the base; the back wall leans towards it. Ribs are parallel to the base and
    equally far apart. See docs/finray.md for what follows from these figures.

    Attributes:
        feet: the bodies of the gripper's MJCF that the left and the right finger grow out of.
        length_mm: from the base to the tip.
        base_mm, tip_mm: across both walls, at the base and at the tip.
        width_mm: out of the plane in which the finger bends.
        wall_mm, rib_mm: how thick each wall and each rib is.
        ribs: how many there are between base and tip.
        modulus_mpa: Young's modulus of the material.
        density_kg_m3: of the material.
        relaxation_ms: the time in which a bent finger that is let go comes back to 1/e, were it without mass.
    """

    feet: tuple[str, str]
    length_mm: _Length
    base_mm: _Across
    tip_mm: _Across
    width_mm: _Across
    wall_mm: _Thickness
    rib_mm: _Thickness
    ribs: int = Field(ge=2, le=16)
    modulus_mpa: Annotated[FiniteFloat, Within("MPa", 1, 5000)]
    density_kg_m3: Annotated[FiniteFloat, Within("kg/m3", 100, 3000)]
    relaxation_ms: Annotated[FiniteFloat, Within("ms", 1, 100)]

    @model_validator(mode="after")
    def _is_a_finger(self) -> FinRay:
        if self.tip_mm >= self.base_mm:
            raise ConflictError(
                f"the tip, {self.tip_mm:g} mm, must be narrower than the base, {self.base_mm:g} mm", ("tip_mm",)
            )
        if self.tip_mm <= 2 * self.wall_mm:
            raise ConflictError(
                f"the tip, {self.tip_mm:g} mm, must be wider than two walls of {self.wall_mm:g} mm", ("tip_mm",)
            )
        bay = self.length_mm / (self.ribs + 1)
        for name in ("wall_mm", "rib_mm"):
            if getattr(self, name) > _SLENDER * bay:
                raise ConflictError(
                    f"{name} {getattr(self, name):g} is too thick for {self.ribs} ribs on {self.length_mm:g} "
                    f"mm: at most {_SLENDER * bay:.2g}",
                    (name,),
                )
        return self

    @property
    def length(self) -> float:
        """From the base to the tip, m."""
        return self.length_mm / 1000

    @property
    def width(self) -> float:
        """Out of the plane in which the finger bends, m."""
        return self.width_mm / 1000

    @property
    def wall(self) -> float:
        """Thickness of a wall, m."""
        return self.wall_mm / 1000

    @property
    def rib(self) -> float:
        """Thickness of a rib, m."""
        return self.rib_mm / 1000

    @property
    def modulus(self) -> float:
        """Young's modulus, Pa."""
        return self.modulus_mpa * 1e6

    @property
    def relaxation(self) -> float:
        """What a spring's damping is of its stiffness, s."""
        return self.relaxation_ms / 1000

    @property
    def segments(self) -> int:
        """How many stiff pieces stand for the finger: one from each station to the next."""
        return self.ribs + 1

    @property
    def bay(self) -> float:
        """From one station to the next, along the front wall, m."""
        return self.length / self.segments

    @property
    def stations(self) -> Array:
        """Heights (segments,) of the base and of the ribs over the base, m."""
        numbers: Array = np.arange(self.segments, dtype=np.float64)
        return numbers * self.bay

    def spacing(self, height: Array | float) -> Array:
        """How far apart the middles of the walls are at heights over the base, m."""
        base, tip = (across / 1000 - self.wall for across in (self.base_mm, self.tip_mm))
        heights: Array = np.asarray(height, np.float64)
        return base + (tip - base) * heights / self.length
