"""The objects of a task: which ones have a role, what they contain, where they start, and regions of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, FiniteFloat, ValidationInfo, model_validator

from ..files.documents.config_base import Config, ConfigReference, ConflictError, Name
from ..files.documents.units import (
    Distance,
    Heading,
    HeadingRange,
    OffsetPoint,
    Place,
    QuantityBounds,
    Share,
    WorkspaceRange,
    is_recorded_config,
)
from .goals.world import TABLE
from .objects.object_config import ObjectConfig

# The first arm is `RecordConfig.arm`; the second is the other arm.
ActingOrder = Literal["first", "second"]
StartOrientation = Literal["upright", "lying", "upside_down"]

# drop height of a cloth, as a share of its half diagonal
_ClothDropHeight = Annotated[FiniteFloat, Field(ge=0.1, le=0.8)]
_RegionLength = Annotated[FiniteFloat, QuantityBounds("m", 1e-3, 2)]


class Filling(Config):
    """Loose pieces that a hollow object contains at its start.

    Attributes:
        of: object config of a piece, whose collision geometry is one capsule or one sphere.
        grams: total mass of the pieces.
        max_pieces: largest number of pieces. If more are needed, pieces are larger, and their total mass is the same.
        length_mm: length from a container's end at -y in which pieces lie at the start; without it, anywhere.
    """

    of: Annotated[ObjectConfig, ConfigReference("objects")]
    grams: Annotated[FiniteFloat, QuantityBounds("g", 1, 1000)]
    max_pieces: Annotated[int, Field(ge=1, le=300)] = 60
    length_mm: Annotated[FiniteFloat, QuantityBounds("mm", 1, 1000)] | None = None


class Role(Config):
    """The objects of a role, each sampled from a list of object configs.

    A config is sampled again only after all others: with a `count` equal to the list's length, each is used once.

    Attributes:
        of: the object configs to sample from.
        count: number of objects with the role.
        sizes: scale factors of lengths; each object gets one of them. Only for configs with a `shape`.
        named: source of an object's name in the scene and in records: its role or its config. Within a task's config,
            names are always roles.
        filled: the pieces in each of the objects, see `Filling`.
    """

    of: Annotated[tuple[ObjectConfig, ...], ConfigReference("objects"), Field(min_length=1)]
    count: Annotated[int, Field(ge=1, le=20)] = 1
    sizes: tuple[Annotated[FiniteFloat, QuantityBounds("times", 0.1, 10)], ...] = ()
    named: Literal["role", "object"] = "role"
    filled: Annotated[Filling | None, Field(exclude_if=lambda filled: filled is None)] = None

    @model_validator(mode="after")
    def _named_after_one_object(self) -> Role:
        if self.named == "object" and self.count > 1:
            raise ConflictError(
                f"`named: object` needs a role of one object, but this role has {self.count}; leave `named` out",
                ("named",),
                ("count",),
            )
        return self

    @model_validator(mode="after")
    def _every_size_can_be_made(self, info: ValidationInfo) -> Role:
        if is_recorded_config(info):
            return self
        for k, factor in enumerate(self.sizes):
            for item in self.of:
                try:
                    item.scaled(factor)
                except ValueError as error:
                    raise ConflictError(str(error), ("sizes", k)) from None
        return self

    @model_validator(mode="before")
    @classmethod
    def _single_object(cls, given: Any) -> Any:
        """Accept `of: plate` as `of: [plate]`."""
        single = isinstance(given, Mapping) and isinstance(given.get("of"), Mapping)
        return {**given, "of": [given["of"]]} if single else given


class ObjectStartRanges(Config):
    """Ranges from which the initial poses of a role's objects are sampled.

    Attributes:
        on: `table`, or a role whose first object supports the objects.
        x, y: range of the middle of an object's outline, m. On the table, coordinates are in `world`: x ahead of the
            arms, y to the left of the middle between them. Otherwise, they are in the frame of the object below.
        from_arm: if given, `y` is relative to the world y of this arm, see `RigConfig.margin`.
        yaw_deg: range of the heading.
        attitudes: possible stable poses of an object, equally probable.
        apart: least gap, seen from above, between an object's outline and the outlines of objects placed before, m.
        open: part of an articulated object -> range of its opening as a share; other parts are closed.
        crumpled: range of the height from which a cloth is dropped by one point, as a share of its half diagonal.
            Crumpling is light at 0.3 and moderate at 0.6. If left out, the cloth lies flat.
    """

    on: Name = TABLE
    from_arm: ActingOrder | None = None
    x: WorkspaceRange
    y: WorkspaceRange
    yaw_deg: HeadingRange = (-180, 180)
    attitudes: Annotated[tuple[StartOrientation, ...], Field(min_length=1)] = ("upright",)
    apart: Distance = 0.02
    open: Mapping[Name, tuple[Share, Share]] = Field(default_factory=dict)
    crumpled: tuple[_ClothDropHeight, _ClothDropHeight] | None = None

    @model_validator(mode="after")
    def _check_consistency(self) -> ObjectStartRanges:
        if self.crumpled is not None and self.crumpled[0] > self.crumpled[1]:
            low, high = self.crumpled
            raise ConflictError(f"a range is [low, high], so {low} must not be above {high}", ("crumpled",))
        if self.from_arm is not None and self.on != TABLE:
            raise ConflictError(
                f"a region on the {self.on} is in the frame of the {self.on}, not of an arm; remove `from_arm`",
                ("from_arm",),
            )
        return self

    def with_y_in_world(self, y: float) -> ObjectStartRanges:
        """Return the start with its range of y converted to `world`, given the world `y` (m) of the arm `from_arm`."""
        return self.model_copy(update={"from_arm": None, "y": (self.y[0] + y, self.y[1] + y)})


class Arrangement(Config):
    """Initial poses of all objects in one attempt, for a task that does not sample from regions.

    Attributes:
        seed: identifier of the poses in their source, such as a benchmark.
        places: object, named after its role -> x and y (m) of its origin in `world`, and its heading (degrees). Objects
            are placed in this order.
    """

    seed: Annotated[int, Field(ge=0)]
    places: Mapping[Name, tuple[Place, Place, Heading]]


class Region(Config):
    """A box-shaped region of an object, such as a compartment of a tray; goals and skills name it like an object.

    Attributes:
        of: role of the object.
        position: middle of the region's floor in the object's frame, m.
        yaw_deg: heading in the object's frame.
        size: lengths along the region's own axes, m.
    """

    of: str
    position: OffsetPoint
    yaw_deg: Heading = 0.0
    size: tuple[_RegionLength, _RegionLength, _RegionLength]


class TableArea(Config):
    """The rectangle in `world` that the table has to cover, m."""

    x: WorkspaceRange
    y: WorkspaceRange
