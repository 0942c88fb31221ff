"""Fin-ray fingers in an MJCF: chains of rigid segments on sprung hinges, and springs that couple the hinges."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from itertools import combinations
from xml.etree.ElementTree import Element, SubElement

from .finger import FinRay, hinge_coupling_springs, hinge_stiffness
from .finger_meshes import segment_file

# s, oscillation period / (2 pi) of each spring with its armature. Long enough for timesteps of 2 ms; a segment of 1 g
# alone would swing within 0.1 ms. Short enough that the armatures add only a dozen grams to a grasped object.
_OSCILLATION_TIME = 3e-3


def add_fingers(root: Element, name: str, finger: FinRay) -> None:
    """Add both fingers to a gripper's MJCF; the gripper and its asset set are called `name`.

    The MJCF must have default classes: `pad` and `wall` for boxes of front and back walls, `rib` for boxes of ribs
    without collisions, and `soft` for meshes. Each foot must be a body without a joint, else KeyError is raised. Its
    origin lies on the outer face of the front wall at the base. Its x axis points to the tip, its y axis to the other
    finger.
    """
    bodies = {body.get("name"): body for body in root.iter("body")}
    assets, tendons, contacts = (get_or_add_child(root, tag) for tag in ("asset", "tendon", "contact"))
    for k in range(finger.segment_count):
        SubElement(assets, "mesh", name=_mesh_name(name, k), file=f"{name}/{segment_file(k)}")
    segments: list[str] = []
    for foot in finger.feet:
        segments += _add_segment_chain(bodies[foot], foot, name, finger)
        for spring, lengths in enumerate(hinge_coupling_springs(finger), start=1):
            tendons.append(_coupling_spring(f"{foot}_slip_{spring}", foot, lengths, finger))
    # Springs model collisions within a finger, and the two fingers do not cross.
    hand = [body.get("name", "") for body in _feet_and_ancestors(root, finger.feet)]
    for one, other in [*combinations(segments, 2), *((body, segment) for body in hand for segment in segments)]:
        SubElement(contacts, "exclude", body1=one, body2=other)


def _add_segment_chain(foot: Element, prefix: str, gripper: str, finger: FinRay) -> Iterator[str]:
    body, at = foot, (0.0, -finger.wall_thickness / 2, 0.0)
    for k, stiffness in enumerate(hinge_stiffness(finger)):
        body = SubElement(body, "body", name=f"{prefix}_segment_{k + 1}", pos=_join_numbers(at), gravcomp="1")
        SubElement(
            body,
            "joint",
            {"name": _hinge_name(prefix, k), "type": "hinge", "axis": "0 0 1"}
            | _joint_spring_attributes(stiffness, finger),
        )
        SubElement(body, "geom", {"name": f"{prefix}_look_{k + 1}", "class": "soft", "mesh": _mesh_name(gripper, k)})
        for what, size, middle, turn in _segment_boxes(finger, k):
            mass = finger.density_kg_m3 * math.prod(size)
            SubElement(
                body,
                "geom",
                {
                    "name": f"{prefix}_collide_{what}_{k + 1}",
                    "class": "wall" if what == "tip" else what,
                    "size": _join_numbers(length / 2 for length in size),
                    "pos": _join_numbers((*middle, 0.0)),
                    "quat": _join_numbers((math.cos(turn / 2), 0.0, 0.0, math.sin(turn / 2))),
                    "mass": _join_numbers([mass]),
                },
            )
        at = (finger.rib_spacing, 0.0, 0.0)
        yield body.get("name", "")


def _segment_boxes(
    finger: FinRay, k: int
) -> Iterator[tuple[str, tuple[float, float, float], tuple[float, float], float]]:
    """Yield the boxes of a segment: class, size (m), middle (x, y) and rotation (rad) in the hinge frame's plane."""
    wall, bay, width = finger.wall_thickness, finger.rib_spacing, finger.width
    low, high = (float(finger.wall_spacing(bay * (k + end))) for end in (0, 1))
    yield "pad", (bay, wall, width), (bay / 2, 0.0), 0.0
    yield "wall", (math.hypot(bay, low - high), wall, width), (bay / 2, -(low + high) / 2), math.atan2(low - high, bay)
    if k:
        yield "rib", (finger.rib_thickness, low - wall, width), (finger.rib_thickness / 2, -low / 2), 0.0
    if k == finger.segment_count - 1:
        yield "tip", (2 * wall, high, width), (bay - wall, -high / 2), 0.0


def _joint_spring_attributes(stiffness: float, finger: FinRay) -> dict[str, str]:
    numbers = {"stiffness": 1.0, "damping": finger.relaxation_time, "armature": _OSCILLATION_TIME**2}
    return {key: _join_numbers([stiffness * value]) for key, value in numbers.items()}


def _coupling_spring(name: str, prefix: str, lengths: Iterable[float], finger: FinRay) -> Element:
    """Return a tendon as a spring of 1 N/m; its elongation is the sum of `lengths` (m) times the hinges' angles."""
    spring = Element("fixed", {"name": name, "springlength": "0"} | _joint_spring_attributes(1.0, finger))
    for k, length in enumerate(lengths):
        if length:
            SubElement(spring, "joint", joint=_hinge_name(prefix, k), coef=_join_numbers([length]))
    return spring


def _feet_and_ancestors(root: Element, feet: Iterable[str]) -> Iterator[Element]:
    parents = {child: parent for parent in root.iter() for child in parent}
    wanted = [body for body in root.iter("body") if body.get("name") in tuple(feet)]
    seen: list[Element] = []
    for body in wanted:
        while body in parents:
            if body.tag == "body" and body not in seen:
                seen.append(body)
                yield body
            body = parents[body]


def get_or_add_child(root: Element, tag: str) -> Element:
    """Return the child of `root` with a tag; add the child if missing."""
    found = root.find(tag)
    return SubElement(root, tag) if found is None else found


def _mesh_name(gripper: str, k: int) -> str:
    return f"{gripper}_segment_{k + 1}"


def _hinge_name(prefix: str, k: int) -> str:
    return f"{prefix}_bend_{k + 1}"


def _join_numbers(values: Iterable[float]) -> str:
    # More digits would differ between machines.
    return " ".join(f"{value:.9g}" for value in values)
