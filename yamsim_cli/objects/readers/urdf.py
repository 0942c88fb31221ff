"""Read a URDF file's links and joints. Each link's frame is its parent joint's.

Source: wiki.ros.org/urdf/XML, elements link, joint and material.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from yamsim_cli.core.files.untrusted.confined_folder import ConfinedFolder
from yamsim_cli.core.files.untrusted.refusals import RefusedError
from yamsim_cli.core.geometry.se3 import Array, pose

from .kinematic_tree import JointDescription, LinkDescription, build_parts, joint_range, make_mass_properties
from .meshes import make_material, mesh_surfaces
from .object_parts import MassProperties, ObjectDescription, Surface, SurfaceMaterial
from .primitive_shapes import collision_shape, primitive_surface
from .untrusted_xml import Element, inertia_matrix, parse_number, parse_numbers, parse_untrusted_xml, rotation_from_rpy

_JOINT_TYPES = {"revolute": "hinge", "continuous": "hinge", "prismatic": "slide"}
_WORLD = "world"


def read_urdf(data: bytes, folder: ConfinedFolder, base: Path) -> ObjectDescription:
    """Read a URDF file. Raises `RefusedError` if it is damaged or not supported."""
    root = parse_untrusted_xml(data)
    if root.tag != "robot":
        raise RefusedError("damaged", f"its root is <{root.tag}>, not <robot>")
    palette = {m.get("name", ""): found for m in root.findall("material") if (found := _read_material(m, folder, base))}
    notes = ["<mimic> is not supported: the joint moves independently"] if root.find("joint/mimic") is not None else []
    links = {name: element for element in root.findall("link") if (name := element.get("name", ""))}
    joints = root.findall("joint")
    poses = _link_poses(links, joints)
    made = [
        _read_link(element, poses[name], folder, base, palette) for name, element in links.items() if name != _WORLD
    ]
    parts, fixed = build_parts(made, [_read_joint(element) for element in joints])
    return ObjectDescription(root.get("name", ""), parts, fixed, notes=tuple(notes))


def _parent_and_child(joint: Element) -> tuple[str, str]:
    parent, child = joint.find("parent"), joint.find("child")
    if parent is None or child is None:
        raise RefusedError("damaged", f"joint {joint.get('name')!r} has no parent or no child")
    return parent.get("link", ""), child.get("link", "")


def _link_poses(links: dict[str, Element], joints: list[Element]) -> dict[str, Array]:
    """Return link name -> pose (4, 4) in the root link's frame with joints at 0."""
    above = {child: (parent, joint) for joint in joints for parent, child in (_parent_and_child(joint),)}
    known: dict[str, Array] = {}
    for name in links:
        chain, at = [], name
        while at in above and at not in known:
            chain.append(at)
            at = above[at][0]
            if len(chain) > len(links):
                raise RefusedError("cycle", "its joints form a loop")
        T = known.get(at, np.eye(4))
        for link in reversed(chain):
            T = T @ _origin_pose(above[link][1])
            known[link] = T
        known.setdefault(name, T)
    return known


def _origin_pose(element: Element) -> Array:
    origin = element.find("origin")
    if origin is None:
        return np.eye(4)
    return pose(
        parse_numbers(origin.get("xyz"), 3, (0.0,) * 3),
        rotation_from_rpy(*parse_numbers(origin.get("rpy"), 3, (0.0,) * 3)),
    )


def _read_material(element: Element, folder: ConfinedFolder, base: Path) -> SurfaceMaterial | None:
    colour, texture = element.find("color"), element.find("texture")
    if colour is None and texture is None:
        return None
    rgba = parse_numbers(None if colour is None else colour.get("rgba"), 4, (1.0,) * 4)
    return make_material(folder, rgba, "" if texture is None else texture.get("filename", ""), base)


def _read_link(
    element: Element, T: Array, folder: ConfinedFolder, base: Path, palette: dict[str, SurfaceMaterial]
) -> LinkDescription:
    link = LinkDescription(element.get("name", ""), T, _read_mass_properties(element.find("inertial")))
    for visual in element.findall("visual"):
        named = visual.find("material")
        material = None
        if named is not None:
            material = _read_material(named, folder, base) or palette.get(named.get("name", ""))
        link.visual_surfaces += [
            surface.transform(_origin_pose(visual)) for surface in _visual_surfaces(visual, folder, base, material)
        ]
    for collision in element.findall("collision"):
        found = _read_primitive(collision)
        if found is None:
            link.shapes += [
                s.transform(_origin_pose(collision)) for s in _visual_surfaces(collision, folder, base, None)
            ]
        else:
            link.shapes.append(collision_shape(*found, _origin_pose(collision)))
    return link


def _visual_surfaces(
    element: Element, folder: ConfinedFolder, base: Path, material: SurfaceMaterial | None
) -> list[Surface]:
    mesh = element.find("geometry/mesh")
    if mesh is not None:
        scale = parse_numbers(mesh.get("scale"), 3, (1.0, 1.0, 1.0))
        return mesh_surfaces(folder, mesh.get("filename", ""), base, scale, material)
    found = _read_primitive(element)
    return [] if found is None else [primitive_surface(*found, material or SurfaceMaterial())]


def _read_primitive(element: Element) -> tuple[str, Array] | None:
    if (found := element.find("geometry/box")) is not None:
        return "box", np.array(parse_numbers(found.get("size"), 3)) / 2
    if (found := element.find("geometry/sphere")) is not None:
        return "sphere", np.array([parse_number(found.get("radius"))])
    for kind in ("cylinder", "capsule"):
        if (found := element.find(f"geometry/{kind}")) is not None:
            return kind, np.array([parse_number(found.get("radius")), parse_number(found.get("length")) / 2])
    return None


def _read_mass_properties(inertial: Element | None) -> MassProperties | None:
    if inertial is None:
        return None
    T, elements = _origin_pose(inertial), ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    tensor = inertia_matrix(*(parse_number(_child_attribute(inertial, "inertia", key), 0.0) for key in elements))
    mass = parse_number(_child_attribute(inertial, "mass", "value"), 0.0)
    return make_mass_properties(mass, T[:3, 3], T[:3, :3] @ tensor @ T[:3, :3].T)


def _child_attribute(element: Element, tag: str, name: str) -> str | None:
    child = element.find(tag)
    return None if child is None else child.get(name)


def _read_joint(element: Element) -> JointDescription:
    name, kind = element.get("name", ""), element.get("type", "")
    parent, child = _parent_and_child(element)
    above = None if parent == _WORLD else parent
    if kind == "fixed":
        return JointDescription(name, above, child, None)
    if kind not in _JOINT_TYPES:
        raise RefusedError("joint-kind", f"joint {name!r} is {kind!r}; valid: fixed, {', '.join(_JOINT_TYPES)}")
    low, high = -math.inf, math.inf
    if kind != "continuous":
        if element.find("limit") is None:
            raise RefusedError("damaged", f"joint {name!r} has no limit")
        low, high = (parse_number(_child_attribute(element, "limit", end), 0.0) for end in ("lower", "upper"))
    moves: dict[str, Any] = {
        "type": _JOINT_TYPES[kind],
        "axis": parse_numbers(_child_attribute(element, "axis", "xyz"), 3, (1.0, 0.0, 0.0)),
        "range": joint_range(low, high, turns=kind != "prismatic", name=name),
        "damping": parse_number(_child_attribute(element, "dynamics", "damping"), 0.0),
        "friction": parse_number(_child_attribute(element, "dynamics", "friction"), 0.0),
    }
    return JointDescription(name, above, child, moves)
