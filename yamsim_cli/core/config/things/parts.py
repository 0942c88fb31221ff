"""What every part of a thing has: surface, weight, and the meshes that are seen of it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat

from ...documents.base import OMIT_NONE, Config, NonNegative, Quaternion, Rgba, omit_default
from ...documents.units import OffsetPoint, PlacePoint, Within

_Lever = Annotated[FiniteFloat, Within("m", 0, 1)]
_Moment = Annotated[FiniteFloat, Within("kg m2", 1e-12, 100)]


# MuJoCo's own, s.
_PUSH_OUT = 0.02


class Contact(Config):
    """Surface in MuJoCo's terms: sliding, torsional (m) and rolling (m) friction, and the contact dimension.

    Attributes:
        push_out_s: about how long a contact takes to push out what has sunk in, s. What is small and falls sinks in by
            some millimetres for each hundredth; a table's top is thin.
    """

    friction: tuple[NonNegative, _Lever, _Lever] = (1.0, 0.005, 0.0001)
    condim: Literal[1, 3, 4, 6] = 3
    push_out_s: Annotated[FiniteFloat, Within("s", 0.004, 0.5), omit_default(_PUSH_OUT)] = _PUSH_OUT


class ObjectMesh(Config):
    """A mesh that is seen, such as a scan: asset set and file, and the point of it that becomes the part's origin.

    Attributes:
        set: of the lock, or one of the user's own, see `core.assets.own_sets`.
        file: STL, or OBJ where it has a texture.
        rgba: its colour; with a texture, what the texture is multiplied by.
        texture: a PNG file of the same set, which the OBJ's texture coordinates refer to.
        castshadow: whether the scan casts a shadow. A shallow one speckles itself where light grazes it: then let
            primitives of `look` just under its surface cast the shadow instead.
    """

    set: str
    file: str
    origin: PlacePoint
    rgba: Rgba
    texture: Annotated[str | None, OMIT_NONE] = None
    specular: float = Field(default=0.2, ge=0, le=1)
    shininess: float = Field(default=0.3, ge=0, le=1)
    castshadow: Annotated[bool, omit_default(True)] = True


class Inertia(Config):
    """Mass in grams, centre of mass (m) in the part's frame, principal moments (kg m2) and the frame they hold in."""

    mass_g: Annotated[FiniteFloat, Within("g", 0.5, 50_000)]
    centre: OffsetPoint = (0.0, 0.0, 0.0)
    diagonal: tuple[_Moment, _Moment, _Moment]
    quat: Quaternion

    @property
    def mass(self) -> float:
        """Mass in kilograms."""
        return self.mass_g / 1000.0
