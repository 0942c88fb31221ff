"""Dimensions of a fin-ray finger, and its stiffness by beam theory. docs/finray.md has the derivation.

The finger is divided at the base and at each rib into rigid segments, which rotate against each other by angles theta
(n,). Both walls bend by the same angle. The back wall lies at a distance h from the front wall, so an angle also shifts
the back wall by h theta. The sum of the shifts up to a rib is the slip at that rib. Ribs are clamped to both walls, and
resist the slip as short beams. The walls meet at the tip, and resist the slip by their stretch.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from ...files.documents.config_base import Config, ConflictError
from ...files.documents.units import QuantityBounds
from ...geometry.se3 import Array

_Length = Annotated[FiniteFloat, QuantityBounds("mm", 20, 300)]
_WidthMm = Annotated[FiniteFloat, QuantityBounds("mm", 2, 100)]
_Thickness = Annotated[FiniteFloat, QuantityBounds("mm", 0.2, 10)]

_MAX_THICKNESS = 0.5  # of walls and ribs, as a share of the distance between two ribs
_TIP_STIFFNESS_RATIO = 1e3  # as a multiple of the walls' stretching stiffness: nearly rigid


class FinRay(Config):
    """Dimensions and material of a finger: a front wall that touches objects, a back wall, and ribs between them.

    The front wall is perpendicular to the base; the back wall leans towards the front wall. Ribs are parallel to the
    base and equally spaced. See docs/finray.md.

    Attributes:
        feet: the bodies of the gripper's MJCF that carry the left and the right finger.
        length_mm: length from the base to the tip.
        base_mm, tip_mm: outer distance across both walls, at the base and at the tip.
        width_mm: width perpendicular to the plane in which the finger bends.
        wall_mm, rib_mm: thickness of each wall and of each rib.
        ribs: number of ribs between base and tip.
        modulus_mpa: Young's modulus of the material.
        density_kg_m3: density of the material.
        relaxation_ms: time constant with which a released massless finger straightens.
    """

    feet: tuple[str, str]
    length_mm: _Length
    base_mm: _WidthMm
    tip_mm: _WidthMm
    width_mm: _WidthMm
    wall_mm: _Thickness
    rib_mm: _Thickness
    ribs: int = Field(ge=2, le=16)
    modulus_mpa: Annotated[FiniteFloat, QuantityBounds("MPa", 1, 5000)]
    density_kg_m3: Annotated[FiniteFloat, QuantityBounds("kg/m3", 100, 3000)]
    relaxation_ms: Annotated[FiniteFloat, QuantityBounds("ms", 1, 100)]

    @model_validator(mode="after")
    def _has_valid_dimensions(self) -> FinRay:
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
            if getattr(self, name) > _MAX_THICKNESS * bay:
                raise ConflictError(
                    f"{name} {getattr(self, name):g} is too thick for {self.ribs} ribs on {self.length_mm:g} "
                    f"mm: at most {_MAX_THICKNESS * bay:.2g}",
                    (name,),
                )
        return self

    @property
    def length(self) -> float:
        """Length from the base to the tip, m."""
        return self.length_mm / 1000

    @property
    def width(self) -> float:
        """Width perpendicular to the plane in which the finger bends, m."""
        return self.width_mm / 1000

    @property
    def wall_thickness(self) -> float:
        """Thickness of a wall, m."""
        return self.wall_mm / 1000

    @property
    def rib_thickness(self) -> float:
        """Thickness of a rib, m."""
        return self.rib_mm / 1000

    @property
    def youngs_modulus(self) -> float:
        """Young's modulus, Pa."""
        return self.modulus_mpa * 1e6

    @property
    def relaxation_time(self) -> float:
        """Damping of each spring divided by its stiffness, s."""
        return self.relaxation_ms / 1000

    @property
    def segment_count(self) -> int:
        """Rigid segments: one begins at the base, and one at each rib."""
        return self.ribs + 1

    @property
    def rib_spacing(self) -> float:
        """Distance along the front wall between two ribs, m; also from the base to the first rib, and to the tip."""
        return self.length / self.segment_count

    @property
    def hinge_heights(self) -> Array:
        """Heights (segments,) of the base and of the ribs, m."""
        return np.asarray(np.arange(self.segment_count, dtype=np.float64) * self.rib_spacing)

    def wall_spacing(self, height: Array | float) -> Array:
        """Return the distance between the walls' middle surfaces at heights (m) above the base, m."""
        base, tip = (across / 1000 - self.wall_thickness for across in (self.base_mm, self.tip_mm))
        heights: Array = np.asarray(height, np.float64)
        return base + (tip - base) * heights / self.length


def hinge_stiffness(finger: FinRay) -> Array:
    """Return the stiffness (n,), N m/rad, of the hinges at the base and at each rib.

    A hinge represents the bending of both walls over one distance between ribs; at the base, over half of it.
    """
    inertia = finger.width * finger.wall_thickness**3 / 12
    stiffness = np.full(finger.segment_count, finger.youngs_modulus * 2 * inertia / finger.rib_spacing)
    stiffness[0] *= 2
    return stiffness


def slip_jacobian(finger: FinRay) -> Array:
    """Return the back wall's slip (n, n), m/rad, at ribs and tip (rows) per angle at base and ribs (columns)."""
    spacing = finger.wall_spacing(finger.hinge_heights)
    # Of the bend that the hinge at a rib represents, half lies below the rib.
    through = np.tril(np.broadcast_to(spacing, (finger.segment_count, finger.segment_count)))
    ribs = through[1:] - np.diag(spacing)[1:] / 2
    return np.vstack([ribs, spacing])


def slip_stiffness(finger: FinRay) -> Array:
    """Return the stiffness matrix (n, n), N/m, of the back wall's slips at the ribs and, last, at the tip."""
    n = finger.segment_count
    inertia = finger.width * finger.rib_thickness**3 / 12
    ribs = 12 * finger.youngs_modulus * inertia / finger.wall_spacing(finger.hinge_heights[1:]) ** 3
    leaning = np.hypot(finger.rib_spacing, (finger.wall_spacing(0.0) - finger.wall_spacing(finger.length)) / n)
    stretch = finger.youngs_modulus * finger.width * finger.wall_thickness / (finger.rib_spacing + leaning)
    held = np.diag(np.append(ribs, _TIP_STIFFNESS_RATIO * stretch))
    # Stretch of both walls below a rib reduces the slip at the rib. The walls stretch so that the energy is least.
    before = np.tril(np.ones((n, n)))
    give = stretch * np.eye(n) + before.T @ held @ before
    stiffness: Array = held - held @ before @ np.linalg.solve(give, before.T @ held)
    return (stiffness + stiffness.T) / 2


def hinge_coupling_springs(finger: FinRay) -> Array:
    """Return coefficients (n, n), m. Each row is a spring of 1 N/m; its elongation is the row times the hinge angles.

    The energy of all springs together equals the energy by `slip_stiffness`.
    """
    rows = np.linalg.cholesky(slip_stiffness(finger)).T @ slip_jacobian(finger)
    # Rounding errors of exact zeros differ between linear algebra libraries.
    return np.where(np.abs(rows) < 1e-9 * np.abs(rows).max(), 0.0, rows)
