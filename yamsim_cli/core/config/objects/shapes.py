"""Shapes: the sizes (mm) and materials from which objects are generated."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import fields
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field, FiniteFloat, model_validator

from ...files.documents.config_base import Config, ConflictError, Rgba
from ...files.documents.units import QuantityBounds
from ...geometry.shape_generators import boxes, cutlery, pasta, vessels
from ...geometry.shape_generators.generated_shape import GeneratedShape

_Size = Annotated[FiniteFloat, QuantityBounds("mm", 1, 1000)]
_TineHeight = Annotated[FiniteFloat, QuantityBounds("mm", 25, 1000)]  # height of tines, which end above floor and rail
_WallThickness = Annotated[FiniteFloat, QuantityBounds("mm", 0.3, 50)]
_Length = Annotated[FiniteFloat, QuantityBounds("mm", 0, 500)]
_Share = Annotated[FiniteFloat, QuantityBounds("of 1", 0, 1)]
_Grams = Annotated[FiniteFloat, QuantityBounds("g", 0.5, 50_000)]
_BoxSize = tuple[_Size, _Size, _Size]

T = TypeVar("T")

MaterialName = Literal[
    "steel", "aluminium", "stoneware", "porcelain", "glass", "polypropylene", "nylon", "wood", "cardboard", "cotton",
    "durum", "fruit", "leaf", "paint",
]  # fmt: skip

#: Density of each material, kg/m3, rounded from material tables. Folded cotton contains air; paint counts as massless.
DENSITY: Mapping[MaterialName, float] = {
    "steel": 7900,
    "aluminium": 2700,
    "stoneware": 2300,
    "porcelain": 2400,
    "glass": 2500,
    "polypropylene": 905,
    "nylon": 1140,
    "wood": 680,
    "cardboard": 700,
    "cotton": 80,
    "durum": 1400,
    "fruit": 960,
    "leaf": 500,
    "paint": 0,
}


class Material(Config):
    """Material and appearance of a piece."""

    stuff: MaterialName
    rgba: Rgba
    specular: float = Field(default=0.3, ge=0, le=1)
    shininess: float = Field(default=0.4, ge=0, le=1)


class _Shape(Config):
    """Base of all shapes.

    Attributes:
        materials: role of a piece ("body", and "handle", "stalk" or "print" if the shape has one) -> its material.
        mass_g: total mass, such as of a full carton; if left out, the mass follows from the materials' densities.
    """

    materials: Mapping[str, Material]
    mass_g: _Grams | None = None

    def generated_shape(self) -> GeneratedShape:
        """Return the surfaces, collision primitives and grasps that follow from the sizes, in m."""
        return self._generate_shape()

    @abstractmethod
    def _generate_shape(self) -> GeneratedShape: ...

    @model_validator(mode="after")
    def _every_piece_has_a_material(self) -> _Shape:
        try:
            roles = {piece.role for piece in self.generated_shape().pieces}
        except (ValueError, IndexError, FloatingPointError):
            raise ValueError("these sizes contradict each other: a part would have no positive size") from None
        if missing := sorted(roles - set(self.materials)):
            raise ConflictError(f"materials: {', '.join(missing)} is missing", ("materials",))
        if unknown := sorted(set(self.materials) - roles):
            raise ConflictError(
                f"materials: unknown {', '.join(unknown)}; valid: {', '.join(sorted(roles))}", ("materials",)
            )
        return self


class VesselShape(_Shape):
    """An open round vessel such as a cup or bowl; `shape_generators.vessels.VesselSizes` describes its sizes."""

    family: Literal["vessel"]
    diameter_mm: _Size
    height_mm: _Size
    foot_mm: _Size
    wall_mm: _WallThickness
    flare: Annotated[FiniteFloat, QuantityBounds("a power", 0.1, 4)] = 1.0
    fillet_mm: _Length = 0.0
    neck_mm: _Size | None = None
    shoulder_mm: _Length = 0.0
    slope_mm: _Length = 0.0
    handles: Literal["none", "loop", "ears"] = "none"
    reach_mm: _Length = 0.0

    @model_validator(mode="after")
    def _require_inside(self) -> VesselShape:
        if 2 * self.wall_mm >= min(self.foot_mm, self.diameter_mm, self.neck_mm or self.foot_mm):
            raise ConflictError(f"wall_mm {self.wall_mm:g} leaves no interior", ("wall_mm",))
        if self.neck_mm is not None and self.shoulder_mm + self.slope_mm > self.height_mm - self.wall_mm:
            raise ConflictError("shoulder_mm and slope_mm reach above the rim", ("shoulder_mm",))
        return self

    def _generate_shape(self) -> GeneratedShape:
        return vessels.make_vessel(_in_metres(vessels.VesselSizes, self))


class CapShape(_Shape):
    """A round cap or screw lid, its hollow side down, with `grips` ridges around it."""

    family: Literal["cap"]
    diameter_mm: _Size
    height_mm: _Size
    wall_mm: _WallThickness
    grips: int = Field(default=0, ge=0, le=96)

    def _generate_shape(self) -> GeneratedShape:
        return vessels.make_cap(_metres(self.diameter_mm), _metres(self.height_mm), _metres(self.wall_mm), self.grips)


class FruitShape(_Shape):
    """A round fruit with a stalk, and with `lobes` whose height is a share `depth` of the radius."""

    family: Literal["fruit"]
    diameter_mm: _Size
    height_mm: _Size
    lobes: int = Field(default=0, ge=0, le=12)
    depth: Annotated[FiniteFloat, QuantityBounds("of 1", 0, 0.2)] = 0.0
    stalk_mm: _Length = 0.0

    def _generate_shape(self) -> GeneratedShape:
        return vessels.make_fruit(
            _metres(self.diameter_mm), _metres(self.height_mm), self.lobes, self.depth, _metres(self.stalk_mm)
        )


class ContainerShape(_Shape):
    """An open box, or a tray of `cells` compartments in a row; `shape_generators.boxes.Container` has its sizes."""

    family: Literal["container"]
    size_mm: _BoxSize
    wall_mm: _WallThickness
    corner_mm: _Length
    taper_mm: _Length = 0.0
    lip_mm: _Length = 0.0
    cells: int = Field(default=1, ge=1, le=12)

    def _generate_shape(self) -> GeneratedShape:
        return boxes.make_container(_in_metres(boxes.ContainerSizes, self))


class LidShape(_Shape):
    """A container's lid with an inner rim, `inset_mm` inside its edge, and a bar as a handle."""

    family: Literal["lid"]
    size_mm: _BoxSize
    corner_mm: _Length
    plate_mm: _WallThickness
    inset_mm: _WallThickness
    bar_mm: tuple[_Size, _Size]

    def _generate_shape(self) -> GeneratedShape:
        bar = (_metres(self.bar_mm[0]), _metres(self.bar_mm[1]))
        return boxes.make_lid(
            _size_in_metres(self.size_mm), _metres(self.corner_mm), _metres(self.plate_mm), _metres(self.inset_mm), bar
        )


class BlockShape(_Shape):
    """A closed box with round edges, and a printed `band` from a lower to an upper fraction of its height."""

    family: Literal["block"]
    size_mm: _BoxSize
    corner_mm: _Length
    edge_mm: _Length
    band: tuple[_Share, _Share] | None = None

    def _generate_shape(self) -> GeneratedShape:
        return boxes.make_block(
            _size_in_metres(self.size_mm), _metres(self.corner_mm), _metres(self.edge_mm), self.band
        )


class TextileShape(_Shape):
    """Folded cloth as a rigid body with `folds` visible layers."""

    family: Literal["textile"]
    size_mm: _BoxSize
    folds: int = Field(default=1, ge=1, le=16)

    def _generate_shape(self) -> GeneratedShape:
        return boxes.make_textile(_size_in_metres(self.size_mm), self.folds)


class RackShape(_Shape):
    """A dish rack of wire with `slots` slots between upright tines, each `slot_mm` wide.

    Attributes:
        tine_mm: height of the tines; the rack's height if left out.
    """

    family: Literal["rack"]
    size_mm: _BoxSize
    wire_mm: _WallThickness
    slots: int = Field(ge=1, le=40)
    slot_mm: _Size
    tine_mm: _TineHeight | None = None

    @model_validator(mode="after")
    def _slots_fit(self) -> RackShape:
        if self.slots * self.slot_mm > self.size_mm[0] - 40:
            raise ConflictError(f"{self.slots} slots of {self.slot_mm:g} mm are wider than the rack", ("slots",))
        if self.tine_mm is not None and self.tine_mm > self.size_mm[2]:
            raise ConflictError(
                f"tines of {self.tine_mm:g} mm are higher than the rack, {self.size_mm[2]:g} mm", ("tine_mm",)
            )
        return self

    def _generate_shape(self) -> GeneratedShape:
        tine = self.size_mm[2] if self.tine_mm is None else self.tine_mm
        return boxes.make_rack(
            boxes.RackSizes(
                _size_in_metres(self.size_mm), _metres(self.wire_mm), self.slots, _metres(self.slot_mm), _metres(tine)
            )
        )


class CutleryShape(_Shape):
    """A spoon, fork, knife or turner; `core.geometry.shape_generators.cutlery.Cutlery` describes its sizes."""

    family: Literal["cutlery"]
    kind: Literal["spoon", "fork", "knife", "turner"]
    size_mm: _BoxSize
    grip_mm: _Size
    thickness_mm: _WallThickness
    handle_mm: _WallThickness

    def _generate_shape(self) -> GeneratedShape:
        return cutlery.make_cutlery(_in_metres(cutlery.CutlerySizes, self))


class PastaShape(_Shape):
    """A piece of dry pasta: a tube, or a rod if `wall_mm` is 0."""

    family: Literal["pasta"]
    diameter_mm: _Size
    length_mm: _Size
    wall_mm: _Length = 0.0
    slant_deg: Annotated[FiniteFloat, QuantityBounds("degrees", 0, 60)] = 0.0
    ridges: int = Field(default=0, ge=0, le=40)

    def _generate_shape(self) -> GeneratedShape:
        return pasta.make_pasta(
            _metres(self.diameter_mm), _metres(self.length_mm), _metres(self.wall_mm), self.slant_deg, self.ridges
        )


def _metres(mm: float) -> float:
    return mm / 1000


def _in_metres(kind: type[T], shape: _Shape) -> T:
    """Return a geometry dataclass with the fields of a shape: `wall` is `wall_mm` in m."""
    dataclass: Any = kind
    values: dict[str, Any] = {}
    for field in fields(dataclass):
        mm = getattr(shape, f"{field.name}_mm", None)
        if mm is None:
            values[field.name] = getattr(shape, field.name, None)
        else:
            values[field.name] = _size_in_metres(mm) if isinstance(mm, tuple) else _metres(mm)
    made: T = dataclass(**values)
    return made


def _size_in_metres(mm: tuple[float, float, float]) -> tuple[float, float, float]:
    x, y, z = mm
    return x / 1000, y / 1000, z / 1000


Shape = Annotated[
    VesselShape
    | CapShape
    | FruitShape
    | ContainerShape
    | LidShape
    | BlockShape
    | TextileShape
    | RackShape
    | CutleryShape
    | PastaShape,
    Field(discriminator="family"),
]
