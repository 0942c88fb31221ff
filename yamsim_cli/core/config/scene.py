"""Scenes: the table, the objects, the lights and the fixed cameras."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from ..geometry.se3 import Array, pose, rotation_z
from .base import Config, Name, NonNegative, Positive, Quaternion, Rgb, Rgba, Vector


class Contact(Config):
    """Surface in MuJoCo's terms: sliding, torsional (m) and rolling (m) friction, and the contact dimension."""

    friction: tuple[NonNegative, NonNegative, NonNegative] = (1.0, 0.005, 0.0001)
    condim: Literal[1, 3, 4, 6] = 3


class Capsule(Config):
    """A capsule between two points of the object's frame."""

    type: Literal["capsule"]
    start: Vector
    end: Vector
    radius: Positive
    rgba: Rgba | None = None


class Cylinder(Config):
    """An upright cylinder: centre, radius and half its height."""

    type: Literal["cylinder"]
    centre: Vector
    radius: Positive
    half_height: Positive
    rgba: Rgba | None = None


class Sphere(Config):
    """A ball: centre and radius."""

    type: Literal["sphere"]
    centre: Vector
    radius: Positive
    rgba: Rgba | None = None


class Box(Config):
    """A block that stands upright: centre, half its size along its own axes, and how far these are turned about z."""

    type: Literal["box"]
    centre: Vector
    half_size: tuple[Positive, Positive, Positive]
    yaw_deg: float = 0.0
    rgba: Rgba | None = None

    @property
    def discs(self) -> tuple[tuple[float, float, float], ...]:
        """Discs (x, y, radius) that cover it seen from above, m: as many as it takes squares to cover it."""
        long = self.half_size[0] >= self.half_size[1]
        length, width = (self.half_size[0], self.half_size[1]) if long else (self.half_size[1], self.half_size[0])
        angle = math.radians(self.yaw_deg) + (0 if long else math.pi / 2)
        count = math.ceil(length / width)
        places = [length * ((2 * k + 1) / count - 1) for k in range(count)]
        radius = math.hypot(width, length / count)
        x, y, _ = self.centre
        return tuple((x + d * math.cos(angle), y + d * math.sin(angle), radius) for d in places)


class Ring(Config):
    """A sloping rim of boxes around the object's z axis, such as a plate's.

    Attributes:
        inner, outer: radius and height (m) of the rim's upper surface at its inner and outer edge.
        thickness: of the boxes, below that surface.
        segments: how many boxes go round.
    """

    type: Literal["ring"]
    inner: tuple[Positive, float]
    outer: tuple[Positive, float]
    thickness: Positive
    segments: int = Field(ge=3, le=128)
    rgba: Rgba | None = None


Primitive = Annotated[Sphere | Capsule | Cylinder | Box | Ring, Field(discriminator="type")]


class ObjectMesh(Config):
    """The scan that is seen: asset set and file, and the scan's point that becomes the object's origin."""

    set: str
    file: str
    origin: Vector
    rgba: Rgba
    specular: float = Field(default=0.2, ge=0, le=1)
    shininess: float = Field(default=0.3, ge=0, le=1)


class Inertia(Config):
    """Mass in grams, centre of mass (m) in the object's frame, principal moments (kg m2) and the frame they hold in."""

    mass_g: Positive
    centre: Vector = (0.0, 0.0, 0.0)
    diagonal: tuple[Positive, Positive, Positive]
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

    position: Vector
    axis_deg: float
    opening: NonNegative

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

    force: Positive
    points: Annotated[tuple[GraspPoint, ...], Field(min_length=1)]


class Grasp(GraspPoint):
    """How the fingers take an object from above: at this point where a weld holds it.

    Attributes:
        clearance: how much wider than closed each finger is before it closes and after it opened, m.
        friction: how friction alone holds it; without, a weld must.
    """

    clearance: Positive = 0.010
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
    rest_height: NonNegative
    preposition: Literal["on", "in"] = "on"
    grasp: Grasp | None = None

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


class Table(Config):
    """The work surface, a box: centre and half-size in metres, and how much of what stands on it it reflects."""

    position: Vector
    half_size: tuple[Positive, Positive, Positive]
    rgba: Rgba
    reflectance: float = Field(default=0.0, ge=0, le=1)
    contact: Contact = Contact()

    @property
    def top(self) -> float:
        """Height of the surface in `world`, m."""
        return self.position[2] + self.half_size[2]

    def widened(self, by: float) -> Table:
        """The same table, wider along world y by so many metres."""
        x, y, z = self.half_size
        return self.model_copy(update={"half_size": (x, y + by / 2, z)})


class Light(Config):
    """A directional light: where it shines towards, and its colour.

    Attributes:
        castshadow: whether it casts shadows in what other programs draw; here, a quality says how many lights do.
    """

    direction: Vector
    diffuse: Rgb
    specular: Rgb = (0.2, 0.2, 0.2)
    castshadow: bool = False


# How far a camera steps back for each metre that the scene grows wider.
_STEP_BACK = 0.5


class FixedCamera(Config):
    """A camera that stands still in `world`: its position and the point it looks at (m); image up is world up."""

    position: Vector
    look_at: Vector
    fovy_deg: float = Field(gt=1, lt=179)

    @model_validator(mode="after")
    def _not_along_up(self) -> FixedCamera:
        if math.dist(self.position, self.look_at) < 1e-6:
            raise ValueError("position and look_at are the same point")
        return self

    def stepped_back(self, by: float) -> FixedCamera:
        """The same camera, so many metres farther from what it looks at."""
        away = 1 + by / math.dist(self.position, self.look_at)
        x, y, z = (at + away * (p - at) for p, at in zip(self.position, self.look_at, strict=True))
        return self.model_copy(update={"position": (x, y, z)})


class SceneConfig(Config):
    """A station's surroundings.

    Attributes:
        table: the work surface; without one, a rig stands on the floor.
        safety_plane: height in `world` of the floor, which catches what falls, m.
        floor_rgba, sky: what is seen around the table.
        scene_camera: the camera that recordings are made with.
    """

    name: Name
    table: Table | None = None
    safety_plane: float
    floor_rgba: tuple[Rgb, Rgb]
    sky: tuple[Rgb, Rgb]
    ambient: Rgb
    lights: tuple[Light, ...] = Field(min_length=1)
    scene_camera: FixedCamera | None = None

    @model_validator(mode="after")
    def _plane_below_table(self) -> SceneConfig:
        if self.table and self.safety_plane >= self.table.top:
            raise ValueError(f"safety_plane {self.safety_plane} m must lie below the table's top at {self.table.top} m")
        return self

    def for_span(self, span: float) -> SceneConfig:
        """The surroundings, given for one arm, of arms whose places lie `span` metres apart: a wider table, and the
        scene camera farther back, so that it sees all of it.
        """
        if not span:
            return self
        return self.model_copy(
            update={
                "table": self.table and self.table.widened(span),
                "scene_camera": self.scene_camera and self.scene_camera.stepped_back(_STEP_BACK * span),
            }
        )
