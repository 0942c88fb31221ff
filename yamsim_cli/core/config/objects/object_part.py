"""Contact parameters, visual meshes and inertia of an object's parts."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat

from ...files.documents.config_base import Config, NonNegative, Quaternion, Rgba
from ...files.documents.units import OffsetPoint, PlacePoint, QuantityBounds

_FrictionLength = Annotated[FiniteFloat, QuantityBounds("m", 0, 1)]
_MomentOfInertia = Annotated[FiniteFloat, QuantityBounds("kg m2", 1e-12, 100)]

_CONTACT_TIME_CONSTANT = 0.02  # s, MuJoCo's default


class Contact(Config):
    """MuJoCo's contact parameters: sliding, torsional (m) and rolling (m) friction, and the contact dimension `condim`.

    Attributes:
        push_out_s: time constant with which a contact resolves penetration, s. A small falling object penetrates a few
            mm for each 0.01 s, and a table's top is thin.
    """

    friction: tuple[NonNegative, _FrictionLength, _FrictionLength] = (1.0, 0.005, 0.0001)
    condim: Literal[1, 3, 4, 6] = 3
    push_out_s: Annotated[FiniteFloat, QuantityBounds("s", 0.004, 0.5)] = _CONTACT_TIME_CONSTANT


class ObjectMesh(Config):
    """A visual mesh, such as a scan.

    Attributes:
        set: name of the folder of mesh files: an asset set of `assets.lock.json`, or one that the user imported.
        file: STL file, or OBJ file for a mesh with a texture.
        origin: the point of the mesh that becomes the part's origin, m.
        rgba: colour, which also multiplies a texture.
        texture: a PNG file in the folder `set` for the OBJ's texture coordinates.
        castshadow: whether the mesh casts a shadow. Under grazing light, a scan of a shallow object shows speckles of
            its own shadow. In that case, let primitives of `look` just below the surface cast the shadow.
    """

    set: str
    file: str
    origin: PlacePoint
    rgba: Rgba
    texture: str | None = None
    specular: float = Field(default=0.2, ge=0, le=1)
    shininess: float = Field(default=0.3, ge=0, le=1)
    castshadow: bool = True


class Inertia(Config):
    """Mass (g), centre of mass (m) in the part's frame, principal moments (kg m2) and quaternion of their axes."""

    mass_g: Annotated[FiniteFloat, QuantityBounds("g", 0.5, 50_000)]
    centre: OffsetPoint = (0.0, 0.0, 0.0)
    diagonal: tuple[_MomentOfInertia, _MomentOfInertia, _MomentOfInertia]
    quat: Quaternion

    @property
    def mass(self) -> float:
        """Mass, kg."""
        return self.mass_g / 1000.0
