"""What parts weigh: as the file says, or evenly filled, or evenly thick where they enclose nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import ResourceError
from ..geometry.closed import Enclosed, enclosed, is_closed, welded
from ..geometry.se3 import Array, quat_from_rotation
from ..geometry.stl import Faces
from ..thing_files.parts import Surface, Weight

# How thick a surface that encloses nothing is taken to be, m.
_SHEET = 0.002
# Moments of a body of next to nothing are set to this share of its largest one.
_LEAST = 1e-4


@dataclass(frozen=True)
class Filling:
    """A part's volume (m3), centre and inertia of density 1; `closed` where it is a body's, else a sheet's."""

    enclosed: Enclosed
    closed: bool


def whole(surfaces: tuple[Surface, ...]) -> tuple[Array, Faces]:
    """All surfaces of a part as one, equal corners joined."""
    vertices = np.concatenate([surface.vertices for surface in surfaces])
    starts = np.cumsum([0, *(len(surface.vertices) for surface in surfaces[:-1])])
    faces = np.concatenate([surface.faces + start for surface, start in zip(surfaces, starts, strict=True)])
    return welded(vertices, faces.astype(np.int32))


def filling(vertices: Array, faces: Faces) -> Filling:
    """What a surface holds if it is closed; or else what it would be as a sheet."""
    if is_closed(faces):
        inside = enclosed(vertices, faces)
        if inside.volume < 0:
            inside = Enclosed(-inside.volume, inside.centre, -inside.tensor)
        if inside.volume > 1e-10:
            return Filling(inside, True)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    middles = (a + b + c) / 3
    share = area / max(float(area.sum()), 1e-18)
    centre = share @ middles
    rest = middles - centre
    volume = float(area.sum()) * _SHEET
    second = volume * (np.einsum("i,ip,iq->pq", share, rest, rest) + _SHEET**2 / 12 * np.eye(3))
    return Filling(Enclosed(volume, centre, np.trace(second) * np.eye(3) - second), False)


def of_density(held: Enclosed, density: float) -> Weight:
    """The weight of an even filling, kg/m3."""
    return Weight(held.volume * density, held.centre, held.tensor * density)


def scaled(weight: Weight, factor: float) -> Weight:
    """The same, so many times as heavy."""
    return Weight(weight.mass * factor, weight.centre, weight.tensor * factor)


def plain_inertia(weight: Weight, what: str) -> dict[str, object]:
    """An `inertia` as configs have it.

    Raises:
        ResourceError: no body has such an inertia.
    """
    moments, axes = np.linalg.eigh((weight.tensor + weight.tensor.T) / 2)
    # A file may leave the inertia out, or round small moments to nothing.
    if moments.max() <= 0:
        raise ResourceError(f"{what}: its inertia is {moments.tolist()} kg m2; mend the file, or leave it out there")
    moments = np.maximum(moments, max(_LEAST * float(moments.max()), 1e-11))
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    return {
        "mass_g": round(weight.mass * 1000, 4),
        "centre": [round(float(x), 6) for x in weight.centre],
        "diagonal": [float(f"{moment:.4e}") for moment in moments],
        "quat": [round(float(q), 6) for q in quat_from_rotation(axes)],
    }
