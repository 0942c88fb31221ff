"""Objects: how they look, collide and weigh, and how a hand takes hold of them."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, FiniteFloat, ValidationInfo, model_validator

from ..geometry.se3 import Array, pose, rotation_z
from .base import Config, ConflictError, Name, NonNegative, Quaternion, Rgba
from .primitives import Box, Capsule, Cylinder, Primitive, Ring, Sphere
from .units import Distance, Heading, OffsetPoint, PlacePoint, Within

_Lever = Annotated[FiniteFloat, Within("m", 0, 1)]
_Moment = Annotated[FiniteFloat, Within("kg m2", 1e-12, 100)]
# Of its parts; fits, which look for them, try larger ones on their way.
_PART = Within("m", -1, 1)


class Contact(Config):
    """Surface in MuJoCo's terms: sliding, torsional (m) and rolling (m) friction, and the contact dimension."""

    friction: tuple[NonNegative, _Lever, _Lever] = (1.0, 0.005, 0.0001)
    condim: Literal[1, 3, 4, 6] = 3


class ObjectMesh(Config):
    """The scan that is seen: asset set and file, and the scan's point that becomes the object's origin.

    Attributes:
        castshadow: whether the scan casts a shadow. A shallow one speckles itself where light grazes it: then let
            primitives of `look` just under its surface cast the shadow instead.
    """

    set: str
    file: str
    origin: PlacePoint
    rgba: Rgba
    specular: float = Field(default=0.2, ge=0, le=1)
    shininess: float = Field(default=0.3, ge=0, le=1)
    castshadow: Annotated[bool, Field(exclude_if=lambda cast: cast)] = True


class Inertia(Config):
    """Mass in grams, centre of mass (m) in the object's frame, principal moments (kg m2) and the frame they hold in."""

    mass_g: Annotated[FiniteFloat, Within("g", 0.5, 50_000)]
    centre: OffsetPoint = (0.0, 0.0, 0.0)
    diagonal: tuple[_Moment, _Moment, _Moment]
    quat: Quaternion

    @property
    def mass(self) -> float:
        """Mass in kilograms."""
        return self.mass_g / 1000.0


# Half the width of a crank finger near its tip. Source: the finger meshes of MuJoCo Menagerie i2rt_yam.
_FINGER_RADIUS = 0.012


class GraspPoint(Config):
    """Where the fingers may meet, and along which axis they close.

    Attributes:
        position: of the pinch point in the object's frame, m.
        axis_deg: direction in the object's xy plane along which the fingers close, degrees from +x.
        opening: of one finger around the object once closed, m.
    """

    position: OffsetPoint
    axis_deg: Heading
    opening: Annotated[FiniteFloat, Within("m", 0, 1)]

    def T_pinch_in_object(self, flipped: bool) -> Array:
        """The pinch frame (4, 4) in the object's: z down into it, y along the closing axis, either way round."""
        down = pose(rotation=[[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
        turn = math.radians(self.axis_deg) + math.pi / 2 + (math.pi if flipped else 0.0)
        return pose(self.position, rotation_z(turn)) @ down


class FrictionGrasp(Config):
    """How two pads hold an object by friction alone.

    Attributes:
        force: with which each pad presses, N.
        points: the places where the object can be held so, the best first.
    """

    force: Annotated[FiniteFloat, Within("N", 0.05, 500)]
    points: Annotated[tuple[GraspPoint, ...], Field(min_length=1)]


class Grasp(GraspPoint):
    """How the fingers take an object from above: at this point where a weld holds it.

    Attributes:
        clearance: how much wider than closed each finger is before it closes and after it opened, m.
        friction: how friction alone holds it; without, a weld must.
    """

    clearance: Annotated[FiniteFloat, Within("m", 1e-4, 0.1)] = 0.010
    friction: FrictionGrasp | None = None

    def fingers(self, open_by: float) -> tuple[tuple[float, float, float], ...]:
        """Discs (x, y, radius) in the object's frame where the tips of the open fingers come down around it, m."""
        angle = math.radians(self.axis_deg)
        reach = open_by + _FINGER_RADIUS / 2
        x, y, _ = self.position
        return tuple(
            (x + side * reach * math.cos(angle), y + side * reach * math.sin(angle), _FINGER_RADIUS) for side in (-1, 1)
        )


class ObjectConfig(Config):
    """A thing that can be moved: primitives to collide, a scan to see.

    Attributes:
        rest_height: of the origin over the surface it lies on, m.
        preposition: how things are put there: "on" a plate, "in" a bowl.
        look: extra primitives that are only seen, such as a banana's brown ends.
    """

    name: Name
    mesh: ObjectMesh
    inertia: Inertia
    contact: Contact = Contact()
    collision: tuple[Primitive, ...] = Field(min_length=1)
    look: tuple[Primitive, ...] = ()
    rest_height: Distance
    preposition: Literal["on", "in"] = "on"
    grasp: Grasp | None = None

    @model_validator(mode="after")
    def _of_a_things_size(self, info: ValidationInfo) -> ObjectConfig:
        for path, part in (
            *((("collision", k), part) for k, part in enumerate(self.collision)),
            *((("look", k), part) for k, part in enumerate(self.look)),
        ):
            for name, value in part:
                if name in ("type", "yaw_deg", "segments", "rgba"):
                    continue
                for number in value if isinstance(value, tuple) else (value,):
                    try:
                        _PART.check(number, info)
                    except ValueError as error:
                        raise ConflictError(f"{number:g} is not valid: {error}", (*path, name)) from None
        return self

    @property
    def footprint(self) -> tuple[tuple[float, float, float], ...]:
        """Discs (x, y, radius) in the object's frame that cover its collision primitives seen from above, m."""
        discs: list[tuple[float, float, float]] = []
        for part in self.collision:
            match part:
                case Capsule():
                    for k in range(5):
                        x, y = (part.start[i] + (part.end[i] - part.start[i]) * k / 4 for i in (0, 1))
                        discs.append((x, y, part.radius))
                case Cylinder() | Sphere():
                    discs.append((part.centre[0], part.centre[1], part.radius))
                case Box():
                    discs.extend(part.discs)
                case Ring():
                    discs.append((0.0, 0.0, part.outer[0]))
        return tuple(discs)

    @property
    def support_height(self) -> float:
        """Height over the origin of the surface on which something put into the middle comes to lie, m."""
        return max((top for part in self.collision if (top := _flat_top(part)) is not None), default=0.0)

    @property
    def carries(self) -> bool:
        """Whether something can be put onto it, or into it: it has a flat top, or a floor."""
        return any(_flat_top(part) is not None for part in self.collision)


def _flat_top(part: Primitive) -> float | None:
    """Height of a primitive's flat upper face over the object's origin, m; None if it has none."""
    match part:
        case Cylinder():
            return part.centre[2] + part.half_height
        case Box():
            return part.centre[2] + part.half_size[2]
        case _:
            return None
