"""Objects: appearance, collision geometry, inertia and grasps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, FiniteFloat, ValidationError, ValidationInfo, model_validator

from ...files.documents.config_base import Config, ConflictError, Name
from ...files.documents.units import Distance, Heading, OffsetPoint, QuantityBounds
from ...files.documents.yaml_document import Document
from ...geometry.se3 import Array, pose, rotation_from_vector, rotation_z
from .articulation import Handle, Link
from .cloth import Cloth, object_keys_from_cloth
from .generated import GENERATED_SET, object_from_shape, object_keys_from_shape, scaled_shape
from .object_part import Contact as Contact
from .object_part import Inertia as Inertia
from .object_part import ObjectMesh as ObjectMesh
from .primitives import Box, Capsule, CollisionPart, Cylinder, HullPart, Primitive, Ring, SdfPart, Sphere
from .shapes import RackShape, Shape

_PRIMITIVE_BOUNDS = QuantityBounds("m", -1, 1)  # m, bounds of lengths and coordinates of primitives


class GraspPoint(Config):
    """A pinch point and the axis along which the fingers close.

    Attributes:
        position: pinch point in the object's frame, m.
        axis_deg: direction in the object's xy plane along which the fingers close, degrees from +x.
        opening: opening of one finger when closed around the object, m.
        tilt_deg: tilt of the hand from straight down for an inclined wall, degrees. Fingers tilt towards `axis_deg`, so
            that both pads lie on the wall. If left out, the arm chooses the tilt.
    """

    position: OffsetPoint
    axis_deg: Heading
    opening: Annotated[FiniteFloat, QuantityBounds("m", 0, 1)]
    tilt_deg: Annotated[FiniteFloat, QuantityBounds("degrees", -90, 90)] | None = None

    def T_pinch_in_object(self, flipped: bool) -> Array:
        """Return the pinch frame's pose (4, 4): z into the object, y along the closing axis, reversed if `flipped`."""
        down = pose(rotation=[[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
        heading = math.radians(self.axis_deg)
        turn = heading + math.pi / 2 + (math.pi if flipped else 0.0)
        T = pose(self.position, rotation_z(turn)) @ down
        if self.tilt_deg:
            tilt = math.radians(self.tilt_deg)
            T[:3, :3] = rotation_from_vector((tilt * math.sin(heading), -tilt * math.cos(heading), 0.0)) @ T[:3, :3]
        return T


class FrictionGrasp(Config):
    """Grasps in which two pads hold an object by friction alone.

    Attributes:
        force: force of each pad, N.
        points: possible grasps, the best first.
        around: whether the points lie around the object and are equally good, so that the arm may use each of them.
        hands: number of hands that are needed to hold the object level.
    """

    force: Annotated[FiniteFloat, QuantityBounds("N", 0.05, 500)]
    points: Annotated[tuple[GraspPoint, ...], Field(min_length=1)]
    around: bool = False
    hands: Literal[1, 2] = 1


class Grasp(GraspPoint):
    """Grasps of an object from above. The inherited keys are for a grasp in which a weld constraint holds the object.

    Attributes:
        clearance: distance between each open finger and its closed position, m.
        friction: grasps by friction; if left out, only a weld constraint holds the object.
    """

    clearance: Annotated[FiniteFloat, QuantityBounds("m", 1e-4, 0.1)] = 0.010
    friction: FrictionGrasp | None = None


# Families of shapes that may lie on any side.
_SHAPES_STABLE_ON_ANY_SIDE = ("block", "fruit", "cutlery", "pasta")


class ObjectConfig(Config):
    """An object: collision geometry, visual meshes, inertia, grasps, and the links of an articulated object.

    For an articulated object, keys other than `links` describe its base.

    Attributes:
        shape: the sizes from which the object is generated. Keys that a file leaves out follow from the sizes. The
            config of a dataset has all keys; only visual meshes are generated again.
        cloth: instead of `shape`, the fabric of a cloth, from which the other keys follow.
        mesh, meshes: visual meshes, each with its own material.
        rest_height: height of the origin above the surface on which the object lies, m.
        support: height above the origin of the surface that supports objects placed in the middle, m; if left out, the
            height follows from the primitives.
        preposition: how instructions name a placement of other objects: "on" a plate, "in" a bowl.
        look: additional visual primitives, such as a banana's brown ends.
        rests: poses in which a hand may place the object: "upright", or "any" stable pose. If left out, hollow, hinged
            and sheet objects are placed upright, and all others in any stable pose.
        base: "free", or "fixed" at its initial pose.
        links: the parts that move on the base and on each other, parents before children.
        handles: grasps of the base.
    """

    name: Name
    shape: Shape | None = None
    cloth: Cloth | None = None
    mesh: ObjectMesh
    meshes: tuple[ObjectMesh, ...] = ()
    inertia: Inertia
    contact: Contact = Contact()
    collision: tuple[CollisionPart, ...] = Field(min_length=1)
    look: tuple[Primitive, ...] = ()
    rest_height: Distance
    support: Distance | None = None
    preposition: Literal["on", "in"] = "on"
    grasp: Grasp | None = None
    rests: Literal["upright", "any"] | None = None
    base: Literal["free", "fixed"] = "free"
    links: tuple[Link, ...] = ()
    handles: tuple[Handle, ...] = ()

    @classmethod
    def read_document(cls, path: Path) -> Document:
        """Return an object's file, completed from its `shape` or `cloth`. Raises as `load_yaml`."""
        document = super().read_document(path)
        document.data.setdefault("name", path.stem)
        for source, made in (
            ("shape", object_keys_from_shape(document.data)),
            ("cloth", object_keys_from_cloth(document.data)),
        ):
            for key, value in made.items():
                if key not in document.data:
                    document.override_value((key,), value, document.place_of((source,)))
        return document

    @model_validator(mode="after")
    def _parts_are_of_plausible_size(self, info: ValidationInfo) -> ObjectConfig:
        for path, part in (
            *((("collision", k), part) for k, part in enumerate(self.collision)),
            *((("look", k), part) for k, part in enumerate(self.look)),
            *(
                (("links", k, "collision", i), part)
                for k, link in enumerate(self.links)
                for i, part in enumerate(link.collision)
            ),
        ):
            for name, value in part:
                if name in ("type", "yaw_deg", "segments", "rgba", "file"):
                    continue
                for number in value if isinstance(value, tuple) else (value,):
                    try:
                        _PRIMITIVE_BOUNDS.check(number, info)
                    except ValueError as error:
                        raise ConflictError(f"{number:g} is not valid: {error}", (*path, name)) from None
        return self

    @model_validator(mode="after")
    def _cloth_is_only_cloth(self) -> ObjectConfig:
        if self.cloth is not None and (self.shape is not None or self.links or self.base == "fixed"):
            raise ConflictError("cloth has no `shape`, no `links` and no fixed `base`; leave them out", ("cloth",))
        return self

    @model_validator(mode="after")
    def _links_are_ordered(self) -> ObjectConfig:
        known: set[str] = set()
        for k, link in enumerate(self.links):
            if link.name in known:
                raise ConflictError(f"two links have the name {link.name!r}", ("links", k, "name"))
            if link.parent is not None and link.parent not in known:
                raise ConflictError(
                    f"parent {link.parent!r} of link {link.name!r} is not a link listed before it; "
                    f"leave it out for the base, or give one of: {', '.join(sorted(known)) or '(none)'}",
                    ("links", k, "parent"),
                )
            known.add(link.name)
        return self

    def with_name(self, name: str) -> ObjectConfig:
        """Return the object with another name, which also names its generated mesh files."""

        def named(mesh: ObjectMesh) -> ObjectMesh:
            made = mesh.set == GENERATED_SET
            return mesh.model_copy(update={"file": name + mesh.file.removeprefix(self.name)}) if made else mesh

        meshes = {"mesh": named(self.mesh), "meshes": tuple(named(mesh) for mesh in self.meshes)}
        return self.model_copy(update={"name": name, **meshes})

    def scaled(self, factor: float) -> ObjectConfig:
        """Return the object with all lengths times a factor, and with mass and grasps for this size.

        Raises ValueError if the object is not generated from sizes alone, or the scaled sizes are not valid.
        """
        if factor == 1.0:
            return self
        if self.shape is None:
            raise ValueError(f"the {self.name} has no `shape`, so its size is fixed")
        given = self.model_dump(mode="json")
        made = self._with_shape(self.shape).model_dump(mode="json")
        if own := sorted(key for key in given if given[key] != made.get(key)):
            raise ValueError(f"the {self.name} has its own `{own[0]}`, which does not scale with its `shape`")
        try:
            return self._with_shape(scaled_shape(self.shape, factor))
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = ".".join(str(part) for part in first["loc"])
            reason = first["msg"].removeprefix("Value error, ")
            raise ValueError(f"the {self.name} cannot be scaled by {factor:g}: {where}: {reason}") from error

    def _with_shape(self, shape: Shape) -> ObjectConfig:
        """Return the object with `shape`, and with all keys that follow from the shape generated again."""
        made = object_from_shape(self.name, shape)
        given = self.model_dump(mode="json")
        kept = {key: value for key, value in given.items() if key not in made and key not in ("grasp", "support")}
        return ObjectConfig.model_validate({**kept, "shape": shape.model_dump(mode="json", exclude_none=True), **made})

    def with_grasp_points(self, points: Sequence[GraspPoint]) -> ObjectConfig:
        """Return the object with other friction grasps, the best first; requires a friction grasp."""
        assert self.grasp is not None and self.grasp.friction is not None
        friction = self.grasp.friction.model_copy(update={"points": tuple(points)})
        at = {name: getattr(points[0], name) for name in GraspPoint.model_fields}
        return self.model_copy(update={"grasp": self.grasp.model_copy(update={**at, "friction": friction})})

    @property
    def all_meshes(self) -> tuple[ObjectMesh, ...]:
        """All visual meshes, including those of the links."""
        return (self.mesh, *self.meshes, *(mesh for link in self.links for mesh in link.meshes))

    @property
    def rests_in_any_pose(self) -> bool:
        """Whether a hand may place the object in any stable pose, not only upright, by `rests` or its geometry."""
        if self.rests is not None:
            return self.rests == "any"
        if self.shape is not None:
            return self.shape.family in _SHAPES_STABLE_ON_ANY_SIDE
        rings = any(isinstance(part, Ring) for part in self.collision)
        hollow = rings or self.preposition == "in" or self.support is not None
        return not hollow and self.cloth is None and not self.links and not self.handles

    @property
    def mesh_sets(self) -> tuple[str, ...]:
        """The asset sets of all meshes, sorted. Collision meshes are in the set of `mesh`."""
        return tuple(sorted({mesh.set for mesh in self.all_meshes} - {GENERATED_SET}))

    @property
    def needs_meshes(self) -> bool:
        """Whether collision geometry needs mesh files, which primitives cannot replace."""
        parts = (*self.collision, *(part for link in self.links for part in link.collision))
        return any(isinstance(part, HullPart | SdfPart) for part in parts)

    @property
    def footprint_discs(self) -> tuple[tuple[float, float, float], ...]:
        """Discs (x, y, radius) in the object's frame that cover its collision geometry seen from above, m."""
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
                    discs.extend(part.covering_discs)
                case HullPart() | SdfPart():
                    discs.extend(part.bounding_box.covering_discs)
                case Ring():
                    discs.append((0.0, 0.0, max(part.inner[0], part.outer[0])))
        return tuple(discs)

    @property
    def can_support(self) -> bool:
        """Whether the object has a flat top or a floor, so that other objects can be placed on or in it."""
        made_to_support = self.support is not None or isinstance(self.shape, RackShape)
        return made_to_support or any(isinstance(part, Cylinder | Box) for part in self.collision)
