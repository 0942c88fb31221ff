"""Whether things are sorted: in a row by their kinds, or each into the container of its kind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import ClassVar, Literal

from pydantic import Field, model_validator

from ...documents.units import Distance
from ..cast import Cast
from ..measure import Measure, either
from ..world import World
from .base import Predicate
from .inside import Inside

_AXES = {"x": 0, "y": 1}


class Sorted(Predicate):
    """The things of a role lie in a row by their kinds, or each in the container of its kind.

    Attributes:
        things: a role that several play.
        order: of a row: kinds of things, in the direction in which the axis counts up.
        axis: of `world`, along which the row lies.
        apart: how far the origins of neighbours of different kinds have to lie apart along the axis, m.
        line: how far apart the origins may lie across the axis, m; without, that does not matter.
        into: rather, kind of thing -> role of its container.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("things",)
    things: str
    order: tuple[str, ...] = ()
    axis: Literal["x", "y"] = "y"
    apart: Distance = 0.0
    line: Distance | None = None
    into: Mapping[str, str] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _one_of_both(self) -> Sorted:
        if bool(self.order) == bool(self.into):
            raise ValueError("give either `order` or `into`")
        return self

    def roles(self) -> tuple[tuple[str, str], ...]:
        """See `Predicate`."""
        return (("things", self.things), *((f"into.{kind}", role) for kind, role in self.into.items()))

    def measures(self, world: World, cast: Cast) -> list[Measure]:
        """See `Predicate`."""
        if self.into:
            return [self._in_its_own(world, cast, thing) for thing in cast.of(self.things)]
        names = [thing for kind in self.order for thing in cast.of(self.things) if cast.kinds[thing] == kind]
        strangers = [thing for thing in cast.of(self.things) if thing not in names]
        if strangers:
            return [
                either(f"sorted({thing})", False, f"its kind {cast.kinds[thing]} is not in `order`")
                for thing in strangers
            ]
        along = {name: float(world.pose(name)[_AXES[self.axis], 3]) for name in names}
        found = [
            self._after(along, one, other)
            for one in names
            for other in names
            if self.order.index(cast.kinds[one]) + 1 == self.order.index(cast.kinds[other])
        ]
        return found if self.line is None else [*found, self._in_line(world, names, self.line)]

    def _in_line(self, world: World, names: Sequence[str], most: float) -> Measure:
        across = [float(world.pose(name)[1 - _AXES[self.axis], 3]) for name in names]
        spread = max(across) - min(across)
        return Measure(f"sorted({self.things}, in line)", most - spread, "m", f"{spread * 1000:.0f} mm across the row")

    def _after(self, along: Mapping[str, float], one: str, other: str) -> Measure:
        gap = along[other] - along[one]
        return Measure(f"sorted({one}, {other})", gap - self.apart, "m", f"{gap * 1000:.0f} mm along {self.axis}")

    def _in_its_own(self, world: World, cast: Cast, thing: str) -> Measure:
        kind = cast.kinds[thing]
        if kind not in self.into:
            return either(f"sorted({thing})", False, f"no container for a {kind}")
        return Inside(thing=thing, container=self.into[kind]).measures(world, cast)[0]
