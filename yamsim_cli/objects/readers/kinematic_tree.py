"""Convert links and joints of an SDF, URDF or MJCF file to rigid parts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from yamsim_cli.core.files.untrusted.refusals import RefusedError
from yamsim_cli.core.geometry.se3 import Array, invert_pose

from .object_parts import MassProperties, RigidPart, Surface

_MAX_LINKS = 64
_UNLIMITED_DEG = 1800.0  # degrees each way, of a hinge without limits; more than a hand can turn
_HANDLE_OPENING = 0.01  # m, of each finger; files give only a handle's frame


@dataclass
class LinkDescription:
    """A link, and its pose `T` (4, 4) in the model's frame with joints at 0."""

    name: str
    T: Array
    weight: MassProperties | None = None
    visual_surfaces: list[Surface] = field(default_factory=list)
    shapes: list[Mapping[str, Any] | Surface] = field(default_factory=list)
    handles: list[Mapping[str, Any]] = field(default_factory=list)


@dataclass(frozen=True)
class JointDescription:
    """A joint between two links.

    Attributes:
        parent: None for the world.
        moves: data of a `core.config.objects.articulation.LinkJoint` in the child's frame; None if fixed.
    """

    name: str
    parent: str | None
    child: str
    moves: Mapping[str, Any] | None


def build_parts(
    links: Sequence[LinkDescription], joints: Sequence[JointDescription]
) -> tuple[tuple[RigidPart, ...], bool]:
    """Return an object's parts, parents first, and whether its base is fixed to the world.

    Fixed joints merge links into one part. Raises `RefusedError` for 0 or too many links, or no single tree.
    """
    if not links:
        raise RefusedError("empty", "it has no link")
    if len(links) > _MAX_LINKS:
        raise RefusedError("too-large", f"it has {len(links)} links; at most {_MAX_LINKS}")
    by_name, root, fixed = _find_root(links, joints)
    order, owner = _breadth_first(root.name, joints), {root.name: root}
    kept: list[tuple[LinkDescription, JointDescription | None]] = [(root, None)]
    for joint in order:
        link, parent = by_name[joint.child], owner[joint.parent or ""]
        if joint.moves is None:
            _merge_link(parent, link)
            owner[link.name] = parent
        else:
            owner[link.name] = link
            kept.append((link, joint))
    place = {link.name: k for k, (link, _) in enumerate(kept)}
    parts = []
    for link, above in kept:
        part = RigidPart(
            link.name,
            parent=None,
            T_in_parent=np.eye(4),
            weight=link.weight,
            looks=tuple(link.visual_surfaces),
            shapes=tuple(link.shapes) or None,
            handles=tuple(link.handles),
        )
        if above is not None:
            parent = owner[above.parent or ""]
            T = invert_pose(parent.T) @ link.T
            part = replace(part, parent=place[parent.name], T_in_parent=T, joint=above.moves)
        parts.append(part)
    return tuple(parts), fixed


def _find_root(
    links: Sequence[LinkDescription], joints: Sequence[JointDescription]
) -> tuple[dict[str, LinkDescription], LinkDescription, bool]:
    by_name = {link.name: link for link in links}
    if len(by_name) < len(links):
        raise RefusedError("damaged", "two of its links have the same name")
    above: dict[str, JointDescription] = {}
    for joint in joints:
        for name in (joint.child, *((joint.parent,) if joint.parent is not None else ())):
            if name not in by_name:
                raise RefusedError("damaged", f"joint {joint.name!r} names link {name!r}, which does not exist")
        if joint.child in above:
            raise RefusedError("damaged", f"link {joint.child!r} has two parent joints: loops are not supported")
        above[joint.child] = joint
    for link in links:
        at, steps = link.name, 0
        while at in above and above[at].parent is not None:
            at, steps = above[at].parent or "", steps + 1
            if steps > len(links):
                raise RefusedError("cycle", "its joints form a loop")
    roots = [link for link in links if link.name not in above or above[link.name].parent is None]
    if len(roots) > 1:
        names = ", ".join(link.name for link in roots[:5])
        raise RefusedError("several-things", f"it has {len(roots)} objects that no joint connects ({names}): keep one")
    root = roots[0]
    fixed = root.name in above
    if fixed and above[root.name].moves is not None:
        raise RefusedError("joint-kind", f"link {root.name!r} moves relative to the world: give it a base link")
    return by_name, root, fixed


def _breadth_first(root: str, joints: Sequence[JointDescription]) -> list[JointDescription]:
    found: list[JointDescription] = []
    wave = [root]
    while wave:
        nexts = [joint for name in wave for joint in joints if joint.parent == name]
        found += nexts
        wave = [joint.child for joint in nexts]
    return found


def _merge_link(parent: LinkDescription, link: LinkDescription) -> None:
    T = invert_pose(parent.T) @ link.T
    parent.visual_surfaces += [surface.transform(T) for surface in link.visual_surfaces]
    parent.shapes += [transform_shape(shape, T) for shape in link.shapes]
    parent.handles += [transform_handle(handle, T) for handle in link.handles]
    if link.weight is not None:
        moved = transform_mass_properties(link.weight, T)
        parent.weight = moved if parent.weight is None else _add_mass_properties(parent.weight, moved)


def transform_handle(handle: Mapping[str, Any], T: Array) -> Mapping[str, Any]:
    """Return a handle in the frame in which the handle's present frame has the pose T (4, 4)."""
    moved = {key: (T[:3, :3] @ handle[key]).tolist() for key in ("approach", "axis")}
    return {**handle, **moved, "position": (T @ [*handle["position"], 1.0])[:3].tolist()}


def transform_shape(shape: Mapping[str, Any] | Surface, T: Array) -> Mapping[str, Any] | Surface:
    """Return a shape in the frame in which its present frame has the pose T (4, 4)."""
    from .primitive_shapes import collision_shape

    if isinstance(shape, Surface):
        return shape.transform(T)
    at = np.eye(4)
    match shape["type"]:
        case "capsule":
            ends = {key: (T @ [*shape[key], 1.0])[:3].tolist() for key in ("start", "end")}
            return {**shape, **ends}
        case "sphere":
            return {**shape, "centre": (T @ [*shape["centre"], 1.0])[:3].tolist()}
        case "cylinder":
            at[:3, 3] = shape["centre"]
            return collision_shape("cylinder", np.array([shape["radius"], shape["half_height"]]), T @ at)
        case _:
            angle = np.radians(shape.get("yaw_deg", 0.0))
            at[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
            at[:3, 3] = shape["centre"]
            return collision_shape("box", np.array(shape["half_size"]), T @ at)


def transform_mass_properties(weight: MassProperties, T: Array) -> MassProperties:
    """Return mass properties in the frame in which their present frame has the pose T (4, 4)."""
    R = T[:3, :3]
    return MassProperties(weight.mass, (T @ [*weight.centre, 1.0])[:3], R @ weight.tensor @ R.T)


def _add_mass_properties(first: MassProperties, second: MassProperties) -> MassProperties:
    mass = first.mass + second.mass
    centre = (first.mass * first.centre + second.mass * second.centre) / max(mass, 1e-12)
    tensor = np.zeros((3, 3))
    for weight in (first, second):
        d = weight.centre - centre
        tensor += weight.tensor + weight.mass * (d @ d * np.eye(3) - np.outer(d, d))
    return MassProperties(mass, centre, tensor)


def make_mass_properties(mass: float, centre: Array, tensor: Array) -> MassProperties | None:
    """Combine mass (kg), centre (3,), m, and inertia (3, 3), kg m2; None if the mass is 0.

    Raises `RefusedError` for a mass below 0 or above 10,000 kg.
    """
    if mass == 0:
        return None
    if not 0 < mass <= 1e4:
        raise RefusedError("impossible", f"its mass is {mass:g} kg")
    return MassProperties(mass, np.asarray(centre, np.float64), np.asarray(tensor, np.float64))


def joint_range(low: float, high: float, *, turns: bool, name: str) -> list[float]:
    """Return a range, m or degrees, from limits, m or rad. An unlimited hinge gets 5 turns each way."""
    if not turns:
        if not (abs(low) <= 2 and abs(high) <= 2):
            raise RefusedError("impossible", f"joint {name!r} slides from {low:g} to {high:g} m")
        ends = [low, high]
    else:
        ends = [max(math.degrees(low), -_UNLIMITED_DEG), min(math.degrees(high), _UNLIMITED_DEG)]
    if not ends[0] < ends[1]:
        raise RefusedError("impossible", f"joint {name!r} has an empty range: {low:g} to {high:g}")
    return ends


def handle_from_frame(name: str, T: Array) -> Mapping[str, Any]:
    """Return a handle for a frame (4, 4) in a link: z is the approach, y the fingers' closing axis."""
    position, approach, axis = (column.tolist() for column in (T[:3, 3], T[:3, 2], T[:3, 1]))
    return {"name": name, "position": position, "approach": approach, "axis": axis, "opening": _HANDLE_OPENING}
