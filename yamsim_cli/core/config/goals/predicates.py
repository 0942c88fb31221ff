"""The predicates of goals: each measures the margin by which a relation between objects holds."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from ...files.documents.units import Distance, Place, QuantityBounds, Share
from ...geometry.se3 import Array, invert_pose
from ..objects.object_config import ObjectConfig
from .cloth_predicates import Folded, FoldedSmall, Spread
from .measure import GoalMeasure, binary_measure
from .predicate import PerObjectPredicate, PerPairPredicate, Predicate, failure_if_held
from .role_assignment import RoleAssignment
from .world import TABLE, GoalWorld

_Grams = Annotated[FiniteFloat, QuantityBounds("g", 0, 1e4)]
_ReceiverSide = Literal["left", "right", "either"]


def _depth_inside_box_xy(world: GoalWorld, upper: str, lower: str) -> float:
    """Return how far (m) the middle of `upper` lies inside the bounding box of `lower` from above; negative outside."""
    first, last = world.aabb(upper)
    middle = (first + last) / 2
    low, high = world.aabb(lower)
    return float(min(*(middle[:2] - low[:2]), *(high[:2] - middle[:2])))


def _bottom_height(world: GoalWorld, thing: str) -> float:
    return float(world.aabb(thing)[0][2])


def _top_height(world: GoalWorld, thing: str) -> float:
    return float(world.aabb(thing)[1][2])


class On(PerPairPredicate):
    """Each object touches its surface, the object's middle lies above the surface, and no hand holds the object.

    Attributes:
        thing, surface: roles; the surface may be `table`.
        inside: least distance of the object's middle from the edge of the surface's outline, m.
        radius: instead of `inside`, the largest horizontal distance between the two origins, m. An object that also
            touches the table leans against the surface, and fails.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "surface")
    TABLE_ARGUMENTS: ClassVar[tuple[str, ...]] = ("surface",)
    IN_HAND: ClassVar[bool | None] = False
    surface: str
    inside: Distance = 0.0
    radius: Distance | None = None

    def _measure_pair(self, world: GoalWorld, thing: str, other: str) -> GoalMeasure:
        what = f"on({thing}, {other})"
        if held := failure_if_held(world, thing, what):
            return held
        if not world.are_touching(thing, other):
            return binary_measure(what, False, "they do not touch")
        if other == TABLE:
            return binary_measure(what, True)
        if self.radius is not None:
            if world.are_touching(thing, TABLE):
                return binary_measure(what, False, "it touches the table")
            apart = world.pose(thing)[:2, 3] - world.pose(other)[:2, 3]
            distance = float((apart @ apart) ** 0.5)
            return GoalMeasure(what, self.radius - distance, "m", f"{distance * 1000:.0f} mm from the middle")
        inside = _depth_inside_box_xy(world, thing, other)
        return GoalMeasure(what, inside - self.inside, "m", f"its middle {inside * 1000:.0f} mm inside the outline")


class Inside(PerPairPredicate):
    """At least a share of each object's volume lies in its container's interior, and no hand holds the object.

    Attributes:
        thing, container: roles.
        share: the least share, 0..1.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "container")
    REGION_ARGUMENTS: ClassVar[tuple[str, ...]] = ("container",)
    container: str
    share: Annotated[Share, Field(gt=0)] = 0.8

    def _measure_pair(self, world: GoalWorld, thing: str, other: str) -> GoalMeasure:
        what = f"in({thing}, {other})"
        if held := failure_if_held(world, thing, what):
            return held
        share = world.volume_fraction_inside(thing, other)
        return GoalMeasure(what, share - self.share, "share", f"{share:.0%} of it inside, of {self.share:.0%} asked")


class Stacked(Predicate):
    """The objects of a role stand on or in each other, the middle of each above the object below.

    Attributes:
        things: a role of several objects.
        order: "any", or "given": from the role's first object, the lowest, to its last.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("things",)
    things: str
    order: Literal["any", "given"] = "any"

    def measures(self, world: GoalWorld, roles: RoleAssignment) -> list[GoalMeasure]:
        """Return a measure for each object and the object below it."""
        names = list(roles.objects_of(self.things))
        if self.order == "any":
            names.sort(key=lambda name: _bottom_height(world, name))
        return [self._measure_pair(world, lower, upper) for lower, upper in pairwise(names)]

    @staticmethod
    def _measure_pair(world: GoalWorld, lower: str, upper: str) -> GoalMeasure:
        what = f"stacked({upper} on {lower})"
        if held := failure_if_held(world, upper, what):
            return held
        if not world.are_touching(upper, lower):
            return binary_measure(what, False, "they do not touch")
        if _bottom_height(world, upper) <= _bottom_height(world, lower):
            return binary_measure(what, False, "it is not above the other")
        inside = _depth_inside_box_xy(world, upper, lower)
        return GoalMeasure(what, inside, "m", f"its middle {inside * 1000:.0f} mm inside the lower one's outline")


class Over(PerPairPredicate):
    """The middle of each object's bounding box lies above its surface's box; its bottom is near the surface's top.

    Unlike `on`, `over` needs no contact and lets a hand hold the object: the bounding box of a plate ends at its rim.

    Attributes:
        thing, surface: roles; the surface may be `table`.
        gap: largest vertical distance between bottom and top, m.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "surface")
    TABLE_ARGUMENTS: ClassVar[tuple[str, ...]] = ("surface",)
    surface: str
    gap: Distance = 0.02

    def _measure_pair(self, world: GoalWorld, thing: str, other: str) -> GoalMeasure:
        inside = _depth_inside_box_xy(world, thing, other)
        apart = _bottom_height(world, thing) - _top_height(world, other)
        detail = f"{inside * 1000:.0f} mm inside the outline, {apart * 1000:.0f} mm above the top"
        return GoalMeasure(f"over({thing}, {other})", min(inside, self.gap - abs(apart)), "m", detail)


class Piled(Predicate):
    """The bounding boxes of objects form a pile: the middle of each lies above the next lower box.

    Bottoms differ in height: a cup may stand in the cup below. Unlike `stacked`, `piled` needs no contact and lets a
    hand hold an object.

    Attributes:
        things: roles; all objects of these roles form one pile.
        gap: largest distance of a bottom above the top of the object below, m.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("things",)
    things: Annotated[tuple[str, ...], Field(min_length=1)]
    gap: Distance = 0.02

    def measures(self, world: GoalWorld, roles: RoleAssignment) -> list[GoalMeasure]:
        """Return a measure for each object and the object below it."""
        names = sorted(
            (name for role in self.things for name in roles.objects_of(role)),
            key=lambda name: _bottom_height(world, name),
        )
        return [self._measure_pair(world, lower, upper) for lower, upper in pairwise(names)]

    def roles(self) -> tuple[tuple[str, str], ...]:
        """Return pairs of an argument that names a role, and the role."""
        return tuple(("things", role) for role in self.things)

    def _measure_pair(self, world: GoalWorld, lower: str, upper: str) -> GoalMeasure:
        inside, higher = (
            _depth_inside_box_xy(world, upper, lower),
            _bottom_height(world, upper) - _bottom_height(world, lower),
        )
        apart = _bottom_height(world, upper) - _top_height(world, lower)
        margin = min(inside, self.gap - apart)
        if higher <= 0:
            margin = min(margin, -1e-9)  # of two objects with equal bottoms, neither is on the other
        detail = f"{inside * 1000:.0f} mm inside the outline, {apart * 1000:.0f} mm above the top"
        return GoalMeasure(f"piled({upper} on {lower})", margin, "m", detail)


class Upright(PerObjectPredicate):
    """The z axis of each object points up.

    Attributes:
        thing: a role.
        tilt_deg: largest angle between the z axis and the vertical.
    """

    tilt_deg: Annotated[FiniteFloat, Field(gt=0, lt=180)] = 15.0

    def _measure_object(self, world: GoalWorld, thing: str) -> GoalMeasure:
        up = float(world.pose(thing)[2, 2])
        tilt = math.degrees(math.acos(max(-1.0, min(1.0, up))))
        return GoalMeasure(f"upright({thing})", self.tilt_deg - tilt, "deg", f"it leans by {tilt:.1f} deg")


# Side -> its direction (x, y) in `world`, seen from the robot's base.
_SIDE_DIRECTIONS = {"left": (0.0, 1.0), "right": (0.0, -1.0), "front": (-1.0, 0.0), "behind": (1.0, 0.0)}


class Near(Predicate):
    """Each object's origin is within a horizontal `radius` of another object's origin or of a place, and on a `side`.

    Sides are axes of `world`, seen from the robot's base: `left` is +y, `right` -y, `behind` +x (farther away) and
    `front` -x (nearer). A side is a quarter circle: 45 degrees to either side of its axis.

    Attributes:
        thing, other: roles.
        place: instead of another object, x and y in `world`, m.
        radius: largest distance, m.
        side: side of the other object or of the place: `left`, `right`, `front` or `behind`; any side if left out.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "other")
    thing: str
    other: str | None = None
    place: tuple[Place, Place] | None = None
    radius: Annotated[Distance, Field(gt=0)]
    side: Literal["left", "right", "front", "behind"] | None = None

    @model_validator(mode="after")
    def _exactly_one_given(self) -> Near:
        if (self.other is None) == (self.place is None):
            raise ValueError("give either `other` or `place`")
        return self

    def measures(self, world: GoalWorld, roles: RoleAssignment) -> list[GoalMeasure]:
        """Return a measure for each object and its counterpart or the place."""
        if self.other is None:
            return [
                self._measure_distance(world, thing, "place", np.array(self.place))
                for thing in roles.objects_of(self.thing)
            ]
        return [
            self._measure_distance(world, thing, other, world.pose(other)[:2, 3])
            for thing, other in roles.object_pairs(self.thing, self.other)
        ]

    def _measure_distance(self, world: GoalWorld, thing: str, other: str, place: Array) -> GoalMeasure:
        off = world.pose(thing)[:2, 3] - place
        distance = float(np.linalg.norm(off))
        margin, detail = self.radius - distance, f"{distance * 1000:.0f} mm away"
        if self.side is None:
            return GoalMeasure(f"near({thing}, {other})", margin, "m", detail)
        axis = np.array(_SIDE_DIRECTIONS[self.side])
        along, across = float(off @ axis), abs(float(axis[0] * off[1] - axis[1] * off[0]))
        inside = (along - across) / math.sqrt(2)  # m, distance from the nearer edge of the quarter circle
        detail += f", {along * 1000:.0f} mm of it to the side {self.side!r}"
        return GoalMeasure(f"near({thing}, {other}, {self.side})", min(margin, inside), "m", detail)


class Above(PerPairPredicate):
    """Each object's lowest point is higher than another object's highest point.

    Attributes:
        thing, other: roles; the other may be `table`.
        by: least difference in height, m.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "other")
    TABLE_ARGUMENTS: ClassVar[tuple[str, ...]] = ("other",)
    other: str
    by: Distance = 0.0

    def _measure_pair(self, world: GoalWorld, thing: str, other: str) -> GoalMeasure:
        height = _bottom_height(world, thing) - _top_height(world, other)
        return GoalMeasure(f"above({thing}, {other})", height - self.by, "m", f"{height * 1000:.0f} mm over it")


class HeldBy(PerObjectPredicate):
    """A hand holds each object: by contacts of both fingers, by a weld, or, for cloth, by a constraint.

    Attributes:
        thing: a role.
        arm: the side of the hand; "both" needs both hands at the same time.
    """

    IN_HAND: ClassVar[bool | None] = True
    arm: Literal["left", "right", "either", "both"] = "either"

    def _measure_object(self, world: GoalWorld, thing: str) -> GoalMeasure:
        holders = world.holding_sides(thing)
        match self.arm:
            case "either":
                holds = bool(holders)
            case "both":
                holds = len(holders) == 2
            case side:
                holds = holders == {side}
        detail = f"held by the {' and the '.join(sorted(holders))} hand" if holders else "no hand holds it"
        return binary_measure(f"held_by({thing}, {self.arm})", holds, detail)


class HandedOver(PerObjectPredicate):
    """Each object went from one hand to the other in the air, and has not been put down since.

    Attributes:
        thing: a role.
        to: side of the hand that has to receive the object.
    """

    IN_HAND: ClassVar[bool | None] = True
    to: _ReceiverSide = "either"

    def _measure_object(self, world: GoalWorld, thing: str) -> GoalMeasure:
        hands = world.holders_since_rest(thing)
        receivers = [receiver for giver, receiver in pairwise(hands) if giver != receiver]
        holds = bool(receivers) if self.to == "either" else self.to in receivers
        return binary_measure(f"handed_over({thing}, {self.to})", holds, f"held by: {', '.join(hands) or 'no hand'}")


class WasHandedOver(PerObjectPredicate):
    """Each object went from one hand to the other in the air since the attempt began. It may lie down now.

    Attributes:
        thing: a role.
        to: side of the hand that has to receive the object.
    """

    to: _ReceiverSide = "either"

    def _measure_object(self, world: GoalWorld, thing: str) -> GoalMeasure:
        passed = world.handovers(thing)
        detail = ", ".join(f"from {giver} to {receiver}" for giver, receiver in passed) or "never from hand to hand"
        holds = any(self.to in ("either", receiver) for _, receiver in passed)
        return binary_measure(f"was_handed_over({thing}, {self.to})", holds, detail)


class Sorted(Predicate):
    """The objects of a role lie in a row ordered by kind (name of their config), or each in the container of its kind.

    Attributes:
        things: a role of several objects.
        order: kinds of objects in the row, in the positive direction of the axis.
        axis: axis of `world` along which the row lies.
        apart: least distance along the axis between origins of neighbouring kinds, m.
        line: largest distance across the axis between two origins, m; if left out, the distance does not matter.
        into: instead of a row, kind of object -> role of its container.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("things",)
    REGION_ARGUMENTS: ClassVar[tuple[str, ...]] = ("into",)
    things: str
    order: tuple[str, ...] = ()
    axis: Literal["x", "y"] = "y"
    apart: Distance = 0.0
    line: Distance | None = None
    into: Mapping[str, str] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _exactly_one_given(self) -> Sorted:
        if bool(self.order) == bool(self.into):
            raise ValueError("give either `order` or `into`")
        return self

    def roles(self) -> tuple[tuple[str, str], ...]:
        """Return pairs of an argument that names a role, and the role."""
        return (("things", self.things), *((f"into.{kind}", role) for kind, role in self.into.items()))

    def measures(self, world: GoalWorld, roles: RoleAssignment) -> list[GoalMeasure]:
        """Return measures of neighbours and of the row, or a measure of each object in its container."""
        things = roles.objects_of(self.things)
        if self.into:
            return [self._measure_in_container(world, roles, thing) for thing in things]
        if strangers := [thing for thing in things if roles.config_names[thing] not in self.order]:
            return [
                binary_measure(f"sorted({thing})", False, f"its kind {roles.config_names[thing]} is not in `order`")
                for thing in strangers
            ]
        rank = {thing: self.order.index(roles.config_names[thing]) for thing in things}
        names = sorted(things, key=lambda thing: rank[thing])
        along, across = ("xy".index(self.axis), "yx".index(self.axis))
        places = {name: world.pose(name)[:2, 3] for name in names}
        found = [
            self._measure_gap(one, other, float(places[other][along]) - float(places[one][along]))
            for one in names
            for other in names
            if rank[one] + 1 == rank[other]
        ]
        if self.line is not None:
            width = float(np.ptp([places[name][across] for name in names]))
            what = f"sorted({self.things}, in line)"
            found.append(GoalMeasure(what, self.line - width, "m", f"{width * 1000:.0f} mm across the row"))
        return found

    def _measure_gap(self, one: str, other: str, gap: float) -> GoalMeasure:
        return GoalMeasure(f"sorted({one}, {other})", gap - self.apart, "m", f"{gap * 1000:.0f} mm along {self.axis}")

    def _measure_in_container(self, world: GoalWorld, roles: RoleAssignment, thing: str) -> GoalMeasure:
        kind = roles.config_names[thing]
        if kind not in self.into:
            return binary_measure(f"sorted({thing})", False, f"no container for a {kind}")
        return Inside(thing=thing, container=self.into[kind]).measures(world, roles)[0]


class Open(PerObjectPredicate):
    """A joint of each object is open by at least, or at most, a share of its range.

    Attributes:
        thing: a role.
        joint: the link's name, such as `drawer`.
        share: share of the joint's range, 0..1.
        side: "least": open by at least `share`; "most": open by at most `share`.
    """

    joint: str
    share: Share = 0.7
    side: Literal["least", "most"] = "least"

    def _measure_object(self, world: GoalWorld, thing: str) -> GoalMeasure:
        opening = world.joint_opening(thing, self.joint)
        margin = opening - self.share if self.side == "least" else self.share - opening
        return GoalMeasure(f"open({thing}, {self.joint})", margin, "share", f"open by {opening:.0%}")


class Swapped(Predicate):
    """Each of two objects lies at the other object's start, seen from above.

    Attributes:
        thing, other: roles.
        radius: largest horizontal distance from the other's start, m.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "other")
    thing: str
    other: str
    radius: Annotated[Distance, Field(gt=0)] = 0.03

    def measures(self, world: GoalWorld, roles: RoleAssignment) -> list[GoalMeasure]:
        """Return the measure of each of the two objects at the other's start."""
        one, other = roles.object_of(self.thing), roles.object_of(self.other)
        return [self._measure_distance(world, one, other), self._measure_distance(world, other, one)]

    def _measure_distance(self, world: GoalWorld, thing: str, other: str) -> GoalMeasure:
        off = float(np.linalg.norm(world.pose(thing)[:2, 3] - world.start_pose(other)[:2, 3]))
        detail = f"{off * 1000:.0f} mm from where the {other} started"
        return GoalMeasure(f"swapped({thing}, {other})", self.radius - off, "m", detail)


class Hung(PerPairPredicate):
    """A peg goes through an eye of each object, the object does not touch the table, and no hand holds it.

    A swinging object leaves the peg for moments, and needs no contact. The goal's hold time excludes falling objects.

    Attributes:
        thing, onto: roles of the hanging object and of the object with the peg.
        eye, peg: names of their handles. The eye's handle lies in the middle of the opening, and points through it. The
            peg's handle lies at the tip, and points towards the root.
        radius: largest distance between the peg's axis and the middle of the eye, m.
        depth: least distance of the eye behind the tip, m.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "onto")
    IN_HAND: ClassVar[bool | None] = False
    onto: str
    eye: str = "eye"
    peg: str = "peg"
    radius: Distance = 0.022
    depth: Distance = 0.015

    def missing_handle(self, possible_objects: Callable[[str], Sequence[ObjectConfig]]) -> tuple[str, str] | None:
        """Return an argument and the reason if one of its possible objects has no such handle; else None."""
        for argument, role, handle in (("thing", self.thing, self.eye), ("onto", self.onto, self.peg)):
            for item in possible_objects(role):
                if handle not in (names := [known_handle.name for known_handle in item.handles]):
                    known = ", ".join(names) or "(none)"
                    return argument, f"the {item.name} has no handle {handle!r}; valid: {known}"
        return None

    def _measure_pair(self, world: GoalWorld, thing: str, other: str) -> GoalMeasure:
        what = f"hung({thing}, {other})"
        if held := failure_if_held(world, thing, what):
            return held
        if world.are_touching(thing, TABLE):
            return binary_measure(what, False, "it touches the table")
        T_eye_in_peg = invert_pose(world.handle_pose(other, self.peg)) @ world.handle_pose(thing, self.eye)
        (x, y, z), through = T_eye_in_peg[:3, 3], T_eye_in_peg[:3, 2]
        # The peg is the z axis. It meets the eye's plane at z = `behind`, or never if parallel to the plane.
        behind = float(T_eye_in_peg[:3, 3] @ through / through[2]) if abs(through[2]) > 1e-6 else -np.inf
        off = float(np.linalg.norm((x, y, z - behind)))
        detail = f"the peg {off * 1000:.0f} mm beside the eye's middle, its tip {behind * 1000:.0f} mm through"
        return GoalMeasure(what, min(self.radius - off, behind - self.depth), "m", detail)


class Contains(Predicate):
    """The loose pieces in a container weigh between `least_g` and `most_g`; a piece counts if its centre is inside.

    Attributes:
        container: a role or a region; the masses in several containers are added.
        pieces_of: the role whose `filled` defines the pieces.
        least_g, most_g: the limits of the mass, g. At least one of them is given.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("container", "pieces_of")
    REGION_ARGUMENTS: ClassVar[tuple[str, ...]] = ("container",)
    container: str
    pieces_of: str
    least_g: _Grams = 0.0
    most_g: _Grams | None = None

    @model_validator(mode="after")
    def _range_is_valid(self) -> Contains:
        if not self.least_g and self.most_g is None:
            raise ValueError("give `least_g`, `most_g` or both")
        if self.most_g is not None and self.least_g > self.most_g:
            raise ValueError(f"`least_g` {self.least_g:g} is above `most_g` {self.most_g:g}; swap them")
        return self

    def measures(self, world: GoalWorld, roles: RoleAssignment) -> list[GoalMeasure]:
        """Return the measure of the mass in the containers."""
        grams = sum(
            world.grams_inside(filled, container)
            for filled in roles.objects_of(self.pieces_of)
            for container in roles.objects_of(self.container)
        )
        most = math.inf if self.most_g is None else self.most_g
        margin = min(grams - self.least_g, most - grams)
        wanted = f"at least {self.least_g:g} g" if most == math.inf else f"{self.least_g:g} to {most:g} g"
        return [GoalMeasure(f"contains({self.container})", margin, "g", f"{grams:.1f} g inside, {wanted} asked")]


PREDICATES: Mapping[str, type[Predicate]] = {
    "on": On,
    "in": Inside,
    "stacked": Stacked,
    "over": Over,
    "piled": Piled,
    "upright": Upright,
    "near": Near,
    "above": Above,
    "held_by": HeldBy,
    "handed_over": HandedOver,
    "was_handed_over": WasHandedOver,
    "sorted": Sorted,
    "open": Open,
    "swapped": Swapped,
    "hung": Hung,
    "folded": Folded,
    "spread": Spread,
    "folded_small": FoldedSmall,
    "contains": Contains,
}
