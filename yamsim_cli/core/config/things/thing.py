"""Objects: how they look, collide and weigh, and how a hand takes hold of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, FiniteFloat, ValidationError, ValidationInfo, model_validator

from ...documents.base import OMIT_EMPTY, OMIT_NONE, Config, ConflictError, Name, omit_default
from ...documents.document import Document
from ...documents.units import Distance, Heading, OffsetPoint, Within
from ...geometry.se3 import Array, pose, rotation_from_vector, rotation_z
from .articulation import Handle, Link
from .cloth import Cloth, cloth_object
from .made import MADE, made_from, made_object, scaled_shape
from .parts import Contact as Contact
from .parts import Inertia as Inertia
from .parts import ObjectMesh as ObjectMesh
from .primitives import Box, Capsule, CollisionPart, Cylinder, HullPart, Primitive, Ring, SdfPart, Sphere
from .shapes import Shape

# Of its parts; fits, which look for them, try larger ones on their way.
_PART = Within("m", -1, 1)


class GraspPoint(Config):
    """Where the fingers may meet, and along which axis they close.

    Attributes:
        position: of the pinch point in the object's frame, m.
        axis_deg: direction in the object's xy plane along which the fingers close, degrees from +x.
        opening: of one finger around the object once closed, m.
        tilt_deg: of a wall that leans, and of the hand from straight down, its fingers pointing towards that direction,
            degrees: both pads lie on the wall. Without, the hand may lean as suits the arm.
    """

    position: OffsetPoint
    axis_deg: Heading
    opening: Annotated[FiniteFloat, Within("m", 0, 1)]
    tilt_deg: Annotated[Annotated[FiniteFloat, Within("degrees", -90, 90)] | None, OMIT_NONE] = None

    def T_pinch_in_object(self, flipped: bool) -> Array:
        """The pinch frame (4, 4) in the object's: z into it, y along the closing axis, either way round."""
        down = pose(rotation=[[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
        heading = math.radians(self.axis_deg)
        turn = heading + math.pi / 2 + (math.pi if flipped else 0.0)
        T = pose(self.position, rotation_z(turn)) @ down
        if self.tilt_deg:
            # A turn about the horizontal axis to the right of the heading lets the fingers point along it.
            tilt = math.radians(self.tilt_deg)
            T[:3, :3] = rotation_from_vector((tilt * math.sin(heading), -tilt * math.cos(heading), 0.0)) @ T[:3, :3]
        return T


class FrictionGrasp(Config):
    """How two pads hold an object by friction alone.

    Attributes:
        force: with which each pad presses, N.
        points: the places where the object can be held so, the best first.
        around: whether they go round the object, each as good as the others: then the hand takes first what suits it.
        hands: how many hands it takes to hold it level.
    """

    force: Annotated[FiniteFloat, Within("N", 0.05, 500)]
    points: Annotated[tuple[GraspPoint, ...], Field(min_length=1)]
    around: Annotated[bool, OMIT_EMPTY] = False
    hands: Annotated[Literal[1, 2], omit_default(1)] = 1


class Grasp(GraspPoint):
    """How the fingers take an object from above: at this point where a weld holds it.

    Attributes:
        clearance: how much wider than closed each finger is before it closes and after it opened, m.
        friction: how friction alone holds it; without, a weld must.
    """

    clearance: Annotated[FiniteFloat, Within("m", 1e-4, 0.1)] = 0.010
    friction: FrictionGrasp | None = None

    def fingers(self, open_by: float, radius: float) -> tuple[tuple[float, float, float], ...]:
        """Discs (x, y, radius) in the object's frame where the tips of the open fingers come down around it, m.

        Args:
            open_by: by how much each finger is open, m.
            radius: half of a finger's width, m.
        """
        angle = math.radians(self.axis_deg)
        reach = open_by + radius / 2
        x, y, _ = self.position
        return tuple(
            (x + side * reach * math.cos(angle), y + side * reach * math.sin(angle), radius) for side in (-1, 1)
        )


# Families of shapes that have no upper side.
_SOLID = ("block", "fruit", "cutlery", "pasta")


class ObjectConfig(Config):
    """A thing that can be moved: primitives or convex parts to collide, meshes to see, and parts that move on it.

    Where it has such parts, what stands here is its base.

    Attributes:
        shape: the sizes that it is made from, if it is. Whatever else a file leaves out follows from them when it is
            read; what a dataset holds says it all, and only what is seen is made from the sizes again.
        cloth: rather what fabric it is of: it bends and folds, and what stands here of a stiff thing follows from it.
        mesh, meshes: what is seen, each with its own material.
        rest_height: of the origin over the surface it lies on, m.
        support: height over the origin of the surface on which something put into its middle comes to lie, m; without,
            its primitives tell.
        preposition: how things are put there: "on" a plate, "in" a bowl.
        look: extra primitives that are only seen, such as a banana's brown ends.
        rests: how a hand may put it down: "upright" alone, or in "any" way in which it lies steadily. Without, what is
            hollow, hinged or made of sheet is put down upright, and all else in any way.
        base: "free" to be moved; "fixed" stays where an attempt puts it, whatever pulls.
        links: the parts that move on the base and on each other, parents before children.
        handles: where a hand takes hold of the base.
    """

    name: Name
    shape: Annotated[Shape | None, OMIT_NONE] = None
    cloth: Annotated[Cloth | None, OMIT_NONE] = None
    mesh: ObjectMesh
    meshes: Annotated[tuple[ObjectMesh, ...], OMIT_EMPTY] = ()
    inertia: Inertia
    contact: Contact = Contact()
    collision: tuple[CollisionPart, ...] = Field(min_length=1)
    look: tuple[Primitive, ...] = ()
    rest_height: Distance
    support: Annotated[Distance | None, OMIT_NONE] = None
    preposition: Literal["on", "in"] = "on"
    grasp: Grasp | None = None
    rests: Annotated[Literal["upright", "any"] | None, OMIT_NONE] = None
    base: Annotated[Literal["free", "fixed"], omit_default("free")] = "free"
    links: Annotated[tuple[Link, ...], OMIT_EMPTY] = ()
    handles: Annotated[tuple[Handle, ...], OMIT_EMPTY] = ()

    @classmethod
    def read(cls, path: Path) -> Document:
        """A file of an object, completed from its sizes where it gives any. Raises as `load_yaml`."""
        document = super().read(path)
        document.data.setdefault("name", path.stem)
        for source, made in (("shape", made_from(document.data)), ("cloth", cloth_object(document.data))):
            for key, value in made.items():
                if key not in document.data:
                    document.set((key,), value, document.place((source,)))
        return document

    @model_validator(mode="after")
    def _of_a_things_size(self, info: ValidationInfo) -> ObjectConfig:
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
                        _PART.check(number, info)
                    except ValueError as error:
                        raise ConflictError(f"{number:g} is not valid: {error}", (*path, name)) from None
        return self

    @model_validator(mode="after")
    def _one_kind_of_thing(self) -> ObjectConfig:
        if self.cloth is not None and (self.shape is not None or self.links or self.base == "fixed"):
            raise ConflictError("cloth has no `shape`, no `links` and no fixed `base`; leave them out", ("cloth",))
        return self

    @model_validator(mode="after")
    def _hangs_together(self) -> ObjectConfig:
        known: set[str] = set()
        for k, link in enumerate(self.links):
            if link.name in known:
                raise ConflictError(f"two links are called {link.name!r}", ("links", k, "name"))
            if link.parent is not None and link.parent not in known:
                raise ConflictError(
                    f"parent {link.parent!r} of link {link.name!r} is no link before it; "
                    f"leave it out for the base, or name one of: {', '.join(sorted(known)) or '(none)'}",
                    ("links", k, "parent"),
                )
            known.add(link.name)
        return self

    def called(self, name: str) -> ObjectConfig:
        """The same thing by another name."""

        def named(mesh: ObjectMesh) -> ObjectMesh:
            # What is made from sizes is kept in files of the thing's own name.
            made = mesh.set == MADE
            return mesh.model_copy(update={"file": name + mesh.file.removeprefix(self.name)}) if made else mesh

        meshes = {"mesh": named(self.mesh), "meshes": tuple(named(mesh) for mesh in self.meshes)}
        return self.model_copy(update={"name": name, **meshes})

    def scaled(self, factor: float) -> ObjectConfig:
        """The thing with all lengths times a factor; its mass and its grasps follow.

        Raises:
            ValueError: the thing is not made from sizes alone, or cannot be made in these sizes.
        """
        if factor == 1.0:
            return self
        if self.shape is None:
            raise ValueError(f"the {self.name} has no `shape`, and only what is made from its sizes has others")
        given = self.model_dump(mode="json")
        made = self._made_again(self.shape).model_dump(mode="json")
        if own := sorted(key for key in given if given[key] != made.get(key)):
            raise ValueError(f"the {self.name} has `{own[0]}` beside its `shape`, which does not grow with it")
        try:
            return self._made_again(scaled_shape(self.shape, factor))
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = ".".join(str(part) for part in first["loc"])
            reason = first["msg"].removeprefix("Value error, ")
            raise ValueError(f"the {self.name} cannot be made {factor:g} times as large: {where}: {reason}") from error

    def _made_again(self, shape: Shape) -> ObjectConfig:
        """The thing with everything that follows from a shape replaced."""
        made = made_object(self.name, shape)
        given = self.model_dump(mode="json")
        kept = {key: value for key, value in given.items() if key not in made and key not in ("grasp", "support")}
        return ObjectConfig.model_validate({**kept, "shape": shape.model_dump(mode="json", exclude_none=True), **made})

    def with_places(self, points: Sequence[GraspPoint]) -> ObjectConfig:
        """The same thing, held by friction at other places, the best first; it needs a friction grasp already."""
        assert self.grasp is not None and self.grasp.friction is not None
        friction = self.grasp.friction.model_copy(update={"points": tuple(points)})
        at = {name: getattr(points[0], name) for name in GraspPoint.model_fields}
        return self.model_copy(update={"grasp": self.grasp.model_copy(update={**at, "friction": friction})})

    @property
    def all_meshes(self) -> tuple[ObjectMesh, ...]:
        """Every mesh that is seen of it, its links' included."""
        return (self.mesh, *self.meshes, *(mesh for link in self.links for mesh in link.meshes))

    @property
    def rests_any_way(self) -> bool:
        """Whether a hand may put it down in any way in which it lies steadily; see `rests`."""
        if self.rests is not None:
            return self.rests == "any"
        if self.shape is not None:
            return self.shape.family in _SOLID
        rings = any(isinstance(part, Ring) for part in self.collision)
        hollow = rings or self.preposition == "in" or self.support is not None
        return not hollow and self.cloth is None and not self.links and not self.handles

    @property
    def mesh_sets(self) -> tuple[str, ...]:
        """The asset sets that its files lie in, sorted; what is made from sizes needs none.

        Its collision meshes lie in the set of `mesh`.
        """
        return tuple(sorted({mesh.set for mesh in self.all_meshes} - {MADE}))

    @property
    def needs_meshes(self) -> bool:
        """Whether it collides by mesh files, so that primitives cannot stand in for them."""
        parts = (*self.collision, *(part for link in self.links for part in link.collision))
        return any(isinstance(part, HullPart | SdfPart) for part in parts)

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
                case HullPart() | SdfPart():
                    discs.extend(part.around.discs)
                case Ring():
                    discs.append((0.0, 0.0, max(part.inner[0], part.outer[0])))
        return tuple(discs)

    @property
    def support_height(self) -> float:
        """Height over the origin of the surface on which something put into the middle comes to lie, m."""
        if self.support is not None:
            return self.support
        return max((top for part in self.collision if (top := _flat_top(part)) is not None), default=0.0)

    @property
    def carries(self) -> bool:
        """Whether something can be put onto it, or into it: it has a flat top, or a floor."""
        return self.support is not None or any(_flat_top(part) is not None for part in self.collision)


def _flat_top(part: CollisionPart) -> float | None:
    """Height of a primitive's flat upper face over the object's origin, m; None if it has none."""
    match part:
        case Cylinder():
            return part.centre[2] + part.half_height
        case Box():
            return part.centre[2] + part.half_size[2]
        case _:
            return None
