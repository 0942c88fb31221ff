"""From links and joints, as description files have them, to parts that move on each other."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..geometry.se3 import Array, inverse
from ..untrusted.refusals import RefusedError
from .parts import Part, Surface, Weight

MOST_LINKS = 64
# Of a hinge that has no stops, degrees: some turns are enough for anything that a hand can do.
ENDLESS_DEG = 1800.0


@dataclass
class Link:
    """A link with all that hangs on it; its pose (4, 4) in the model with every joint at 0."""

    name: str
    T: Array
    weight: Weight | None = None
    looks: list[Surface] = field(default_factory=list)
    shapes: list[Mapping[str, Any] | Surface] = field(default_factory=list)
    handles: list[Mapping[str, Any]] = field(default_factory=list)


@dataclass(frozen=True)
class Joint:
    """A joint: links by name, parent None for the world.

    Attributes:
        moves: as `config.things.articulation.LinkJoint` takes it, in the child's frame; None where it is fixed.
    """

    name: str
    parent: str | None
    child: str
    moves: Mapping[str, Any] | None


def parts_of(links: Sequence[Link], joints: Sequence[Joint]) -> tuple[tuple[Part, ...], bool]:
    """The parts, parents first, and whether the base is fixed to the world. Links joined rigidly become one part.

    Raises:
        RefusedError: they are no tree, or several, or too many.
    """
    if not links:
        raise RefusedError("empty", "it has no link")
    if len(links) > MOST_LINKS:
        raise RefusedError("too-large", f"it has {len(links)} links; at most {MOST_LINKS}")
    by_name, root, fixed = _rooted(links, joints)
    order, owner = _order(root.name, joints), {root.name: root}
    kept: list[tuple[Link, Joint | None]] = [(root, None)]
    for joint in order:
        link, parent = by_name[joint.child], owner[joint.parent or ""]
        if joint.moves is None:
            _merge(parent, link)
            owner[link.name] = parent
        else:
            owner[link.name] = link
            kept.append((link, joint))
    place = {link.name: k for k, (link, _) in enumerate(kept)}
    parts = []
    for link, from_above in kept:
        parent_link = owner[from_above.parent or ""] if from_above is not None else None
        parts.append(
            Part(
                link.name,
                None if parent_link is None else place[parent_link.name],
                np.eye(4) if parent_link is None else inverse(parent_link.T) @ link.T,
                None if from_above is None else from_above.moves,
                link.weight,
                tuple(link.looks),
                tuple(link.shapes) or None,
                tuple(link.handles),
            )
        )
    return tuple(parts), fixed


def _rooted(links: Sequence[Link], joints: Sequence[Joint]) -> tuple[dict[str, Link], Link, bool]:
    """Name -> link, the link that all others hang on, and whether that is fixed to the world.

    Raises:
        RefusedError: they are no tree, or several.
    """
    by_name = {link.name: link for link in links}
    if len(by_name) < len(links):
        raise RefusedError("damaged", "two of its links have the same name")
    above: dict[str, Joint] = {}
    for joint in joints:
        for name in (joint.child, *((joint.parent,) if joint.parent is not None else ())):
            if name not in by_name:
                raise RefusedError("damaged", f"joint {joint.name!r} names link {name!r}, which is not there")
        if joint.child in above:
            raise RefusedError("damaged", f"link {joint.child!r} hangs on two joints: loops are not read")
        above[joint.child] = joint
    for link in links:
        at, steps = link.name, 0
        while at in above and above[at].parent is not None:
            at, steps = above[at].parent or "", steps + 1
            if steps > len(links):
                raise RefusedError("cycle", "its joints form a circle")
    roots = [link for link in links if link.name not in above or above[link.name].parent is None]
    if len(roots) > 1:
        names = ", ".join(link.name for link in roots[:5])
        raise RefusedError("several-things", f"it holds {len(roots)} things that nothing joins ({names}): keep one")
    root = roots[0]
    fixed = root.name in above
    if fixed and above[root.name].moves is not None:
        raise RefusedError("joint-kind", f"link {root.name!r} moves on the world: give it a base link")
    return by_name, root, fixed


def _order(root: str, joints: Sequence[Joint]) -> list[Joint]:
    """Joints from the root outwards."""
    found: list[Joint] = []
    wave = [root]
    while wave:
        nexts = [joint for name in wave for joint in joints if joint.parent == name]
        found += nexts
        wave = [joint.child for joint in nexts]
    return found


def _merge(parent: Link, link: Link) -> None:
    """Make a link that is joined rigidly a part of its parent."""
    T = inverse(parent.T) @ link.T
    parent.looks += [surface.moved(T) for surface in link.looks]
    parent.shapes += [moved_shape(shape, T) for shape in link.shapes]
    parent.handles += [_moved_handle(handle, T) for handle in link.handles]
    if link.weight is not None:
        moved = moved_weight(link.weight, T)
        parent.weight = moved if parent.weight is None else joined([parent.weight, moved])


def _moved_handle(handle: Mapping[str, Any], T: Array) -> Mapping[str, Any]:
    moved = {key: (T[:3, :3] @ handle[key]).tolist() for key in ("approach", "axis")}
    return {**handle, **moved, "position": (T @ [*handle["position"], 1.0])[:3].tolist()}


def moved_shape(shape: Mapping[str, Any] | Surface, T: Array) -> Mapping[str, Any] | Surface:
    """What touches, at a pose."""
    from .solids import touching

    if isinstance(shape, Surface):
        return shape.moved(T)
    at = np.eye(4)
    match shape["type"]:
        case "capsule":
            ends = {key: (T @ [*shape[key], 1.0])[:3].tolist() for key in ("start", "end")}
            return {**shape, **ends}
        case "sphere":
            return {**shape, "centre": (T @ [*shape["centre"], 1.0])[:3].tolist()}
        case "cylinder":
            at[:3, 3] = shape["centre"]
            return touching("cylinder", np.array([shape["radius"], shape["half_height"]]), T @ at)
        case _:
            angle = np.radians(shape.get("yaw_deg", 0.0))
            at[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
            at[:3, 3] = shape["centre"]
            return touching("box", np.array(shape["half_size"]), T @ at)


def moved_weight(weight: Weight, T: Array) -> Weight:
    """A weight in another frame."""
    R = T[:3, :3]
    return Weight(weight.mass, (T @ [*weight.centre, 1.0])[:3], R @ weight.tensor @ R.T)


def joined(weights: Sequence[Weight]) -> Weight:
    """Several weights of one body as one."""
    mass = sum(weight.mass for weight in weights)
    centre = sum((weight.mass * weight.centre for weight in weights), np.zeros(3)) / max(mass, 1e-12)
    tensor = np.zeros((3, 3))
    for weight in weights:
        d = weight.centre - centre
        tensor += weight.tensor + weight.mass * (d @ d * np.eye(3) - np.outer(d, d))
    return replace(weights[0], mass=mass, centre=centre, tensor=tensor)


def checked_weight(mass: float, centre: Array, tensor: Array) -> Weight | None:
    """A weight as a file says it; None for one of nothing.

    Raises:
        RefusedError: it is none that a body can have.
    """
    if mass == 0:
        return None
    if not 0 < mass <= 1e4:
        raise RefusedError("impossible", f"it says a mass of {mass:g} kg")
    return Weight(mass, np.asarray(centre, np.float64), np.asarray(tensor, np.float64))


def bounded(low: float, high: float, *, turns: bool, name: str) -> list[float]:
    """Stops of a joint in a config's units, m or degrees, of a file's in m or rad; endless hinges get some turns."""
    if not turns:
        if not (abs(low) <= 2 and abs(high) <= 2):
            raise RefusedError("impossible", f"joint {name!r} slides from {low:g} to {high:g} m")
        ends = [low, high]
    else:
        ends = [max(math.degrees(low), -ENDLESS_DEG), min(math.degrees(high), ENDLESS_DEG)]
    if not ends[0] < ends[1]:
        raise RefusedError("impossible", f"joint {name!r} has no way to go: {low:g} to {high:g}")
    return ends
