"""Read an SDFormat file with one model of links, joints and relative frames.

Source: sdformat.org/spec, versions 1.4 to 1.12, elements model, link, joint, geometry, material and include.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from yamsim_cli.core.files.untrusted.confined_folder import ConfinedFolder
from yamsim_cli.core.files.untrusted.refusals import RefusedError
from yamsim_cli.core.geometry.se3 import Array, invert_pose, pose, pose_from_quat

from .kinematic_tree import (
    JointDescription,
    LinkDescription,
    build_parts,
    handle_from_frame,
    joint_range,
    make_mass_properties,
)
from .meshes import make_material, mesh_surfaces
from .object_parts import MassProperties, ObjectDescription, Surface, SurfaceMaterial
from .primitive_shapes import collision_shape, primitive_surface
from .untrusted_xml import Element, inertia_matrix, parse_number, parse_numbers, parse_untrusted_xml, rotation_from_rpy

_MAX_INCLUDE_DEPTH = 8  # levels of included models
_JOINT_KINDS = {"revolute": "hinge", "continuous": "hinge", "prismatic": "slide", "screw": "screw"}


def read_sdf(data: bytes, folder: ConfinedFolder, base: Path) -> ObjectDescription:
    """Read an SDFormat file. Raises `RefusedError` if it is damaged or no config can express it."""
    model, where = _find_model(data, folder, base, ())
    reader = _ModelReader(folder, where)
    links, joints = reader.read_model(model)
    parts, fixed = build_parts(links, joints)
    static = (model.findtext("static") or "").strip() in ("true", "1")
    notes = tuple(dict.fromkeys(reader.notes))
    return ObjectDescription(model.get("name", ""), parts, fixed or static, friction=reader.friction, notes=notes)


def _find_model(data: bytes, folder: ConfinedFolder, base: Path, seen_files: tuple[Path, ...]) -> tuple[Element, Path]:
    root = parse_untrusted_xml(data)
    if root.tag != "sdf":
        raise RefusedError("damaged", f"its root is <{root.tag}>, not <sdf>")
    place = root.find("world") if root.find("model") is None and root.find("world") is not None else root
    assert place is not None
    models = [*place.findall("model"), *place.findall("include")]
    if len(models) != 1:
        kind = "empty" if not models else "several-things"
        raise RefusedError(kind, f"it holds {len(models)} models: keep one")
    if models[0].tag == "include":
        return _find_included_model(models[0], folder, base, seen_files)
    return models[0], base


def _find_included_model(
    include: Element, folder: ConfinedFolder, base: Path, seen_files: tuple[Path, ...]
) -> tuple[Element, Path]:
    uri = (include.findtext("uri") or "").strip()
    try:
        path = folder.find(uri, base)
    except RefusedError as error:
        if error.code == "outside":
            raise
        path = folder.find(f"{uri}/model.sdf", base)
    if path in seen_files or len(seen_files) >= _MAX_INCLUDE_DEPTH:
        raise RefusedError(
            "cycle", f"{uri!r} includes itself, or is included more than {_MAX_INCLUDE_DEPTH} levels deep"
        )
    return _find_model(folder.read(path.name, path.parent), folder, path.parent, (*seen_files, path))


class _ModelReader:
    def __init__(self, folder: ConfinedFolder, base: Path) -> None:
        self._folder, self._base = folder, base
        self.notes: list[str] = []
        self.friction: float | None = None

    def read_model(self, model: Element) -> tuple[list[LinkDescription], list[JointDescription]]:
        for tag in ("include", "model"):
            if model.find(tag) is not None:
                name = model.get("name")
                raise RefusedError(
                    "several-things", f"model {name!r} contains another <{tag}>: merge them into one model"
                )
        frames = _ModelFrames(model)
        links = [self._read_link(element, frames) for element in model.findall("link")]
        by_name = {link.name: link for link in links}
        joints = [self._read_joint(element, frames) for element in model.findall("joint")]
        for element in model.findall("frame"):
            self._add_handle(element, frames, by_name, links)
        return links, joints

    def _read_link(self, element: Element, frames: _ModelFrames) -> LinkDescription:
        name = _name_of(element)
        link = LinkDescription(name, frames.T_in_model(name))
        link.weight = _read_mass_properties(element.find("inertial"))
        for visual in element.findall("visual"):
            surfaces = self._visual_surfaces(visual, self._read_material(visual))
            link.visual_surfaces += [surface.transform(_pose_of(visual)) for surface in surfaces]
        for collision in element.findall("collision"):
            link.shapes += self._collision_shapes(collision)
            mu = collision.findtext("surface/friction/ode/mu")
            if mu is not None:
                self.friction = parse_number(mu)
        return link

    def _visual_surfaces(self, element: Element, material: SurfaceMaterial | None) -> list[Surface]:
        geometry = element.find("geometry")
        if geometry is None:
            return []
        mesh = geometry.find("mesh")
        if mesh is not None:
            return self._read_mesh(mesh, material)
        found = _read_primitive(geometry)
        if found is None:
            self.notes.append(f"left out: {', '.join(child.tag for child in geometry) or 'an empty geometry'}")
            return []
        return [primitive_surface(*found, material or SurfaceMaterial())]

    def _read_mesh(self, mesh: Element, material: SurfaceMaterial | None) -> list[Surface]:
        scale = parse_numbers(mesh.findtext("scale"), 3, (1.0, 1.0, 1.0))
        if mesh.find("submesh") is not None:
            self.notes.append("submesh is not supported: the whole mesh is used")
        uri = (mesh.findtext("uri") or mesh.findtext("filename") or "").strip()
        return mesh_surfaces(self._folder, uri, self._base, scale, material)

    def _collision_shapes(self, element: Element) -> list[Any]:
        geometry, T = element.find("geometry"), _pose_of(element)
        if geometry is None:
            return []
        mesh = geometry.find("mesh")
        if mesh is not None:
            return [surface.transform(T) for surface in self._read_mesh(mesh, None)]
        found = _read_primitive(geometry)
        return [] if found is None else [collision_shape(*found, T)]

    def _read_joint(self, element: Element, frames: _ModelFrames) -> JointDescription:
        name, kind = _name_of(element), element.get("type", "")
        parent, child = ((element.findtext(tag) or "").strip() for tag in ("parent", "child"))
        parent_link, child_link = frames.link_of(parent), frames.link_of(child)
        if child_link is None:
            raise RefusedError("damaged", f"joint {name!r} has no child")
        if kind == "fixed":
            return JointDescription(name, parent_link, child_link, None)
        if kind not in _JOINT_KINDS:
            raise RefusedError("joint-kind", f"joint {name!r} is {kind!r}; valid: fixed, {', '.join(_JOINT_KINDS)}")
        T = invert_pose(frames.T_in_model(child_link)) @ frames.T_in_model(name)
        axis = element.find("axis")
        if axis is None:
            raise RefusedError("damaged", f"joint {name!r} has no axis")
        along = axis.find("xyz")
        xyz = np.array(parse_numbers(None if along is None else along.text, 3, (0.0, 0.0, 1.0)))
        within = "" if along is None else along.get("expressed_in", "")
        R = (
            T[:3, :3]
            if not within
            else (invert_pose(frames.T_in_model(child_link)) @ frames.T_in_model(within))[:3, :3]
        )
        return JointDescription(
            name, parent_link, child_link, _joint_data(element, axis, _JOINT_KINDS[kind], R @ xyz, T[:3, 3])
        )

    def _add_handle(
        self, element: Element, frames: _ModelFrames, by_name: dict[str, LinkDescription], links: list[LinkDescription]
    ) -> None:
        name = _name_of(element)
        owner = frames.link_of(element.get("attached_to", "") or frames.reference_frame(name))
        if not name.lower().startswith("handle") or (owner or links[0].name) not in by_name:
            return
        link = by_name[owner or links[0].name]
        T = invert_pose(link.T) @ frames.T_in_model(name)
        link.handles.append(handle_from_frame(name.replace("-", "_"), T))

    def _read_material(self, visual: Element) -> SurfaceMaterial | None:
        element = visual.find("material")
        if element is None:
            return None
        if element.find("script") is not None:
            self.notes.append("material scripts are not supported: colours may be missing")
        albedo = (element.findtext("pbr/metal/albedo_map") or element.findtext("pbr/specular/albedo_map") or "").strip()
        diffuse = element.findtext("diffuse")
        if not albedo and diffuse is None:
            return None
        colour = parse_numbers(diffuse, len((diffuse or "1 1 1 1").split()), (1.0,) * 4)
        return make_material(self._folder, colour, albedo, self._base)


def _read_mass_properties(inertial: Element | None) -> MassProperties | None:
    if inertial is None or inertial.find("mass") is None:
        return None
    T, elements = _pose_of(inertial), ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    tensor = inertia_matrix(*(parse_number(inertial.findtext(f"inertia/{key}"), 0.0) for key in elements))
    return make_mass_properties(parse_number(inertial.findtext("mass")), T[:3, 3], T[:3, :3] @ tensor @ T[:3, :3].T)


def _read_primitive(geometry: Element) -> tuple[str, Array] | None:
    """Return a <geometry>'s `kind` and `size` for `collision_shape`; None if it is no primitive."""
    if (found := geometry.find("box")) is not None:
        return "box", np.array(parse_numbers(found.findtext("size"), 3)) / 2
    if (found := geometry.find("sphere")) is not None:
        return "sphere", np.array([parse_number(found.findtext("radius"))])
    if (found := geometry.find("ellipsoid")) is not None:
        return "ellipsoid", np.array(parse_numbers(found.findtext("radii"), 3))
    for kind in ("cylinder", "capsule"):
        if (found := geometry.find(kind)) is not None:
            return kind, np.array([parse_number(found.findtext("radius")), parse_number(found.findtext("length")) / 2])
    return None


def _joint_data(element: Element, axis: Element, kind: str, direction: Array, position: Array) -> dict[str, Any]:
    turns = kind != "slide"
    low, high = (
        parse_number(axis.findtext(f"limit/{end}"), open_end)
        for end, open_end in (("lower", -math.inf), ("upper", math.inf))
    )
    moves = {
        "type": kind,
        "axis": direction.tolist(),
        "position": position.tolist(),
        "range": joint_range(low, high, turns=turns, name=_name_of(element)),
        "damping": parse_number(axis.findtext("dynamics/damping"), 0.0),
        "friction": parse_number(axis.findtext("dynamics/friction"), 0.0),
    }
    if kind == "screw":
        # `screw_thread_pitch` is in metres per turn, the older `thread_pitch` in negative radians per metre.
        lead = element.findtext("screw_thread_pitch")
        old = parse_number(element.findtext("thread_pitch"), 1.0)
        moves["pitch"] = parse_number(lead) if lead else -2 * math.pi / old if old else 0.0
    return moves


class _ModelFrames:
    """Poses of all named elements in the model's frame; unnamed or duplicate ones raise `RefusedError`."""

    def __init__(self, model: Element) -> None:
        # Name -> pose (4, 4), and the frame to which it is relative; "" is the model's.
        self._frames: dict[str, tuple[Array, str]] = {}
        self._attached: dict[str, str] = {}
        self._links = {_name_of(element) for element in model.findall("link")}
        for element in model.findall("link"):
            self._add_frame(element, "")
        for element in model.findall("frame"):
            attached = element.get("attached_to", "")
            self._attached[_name_of(element)] = attached
            self._add_frame(element, attached)
        for element in model.findall("joint"):
            # A joint's pose is relative to its child link.
            child = (element.findtext("child") or "").strip()
            self._attached[_name_of(element)] = child
            self._add_frame(element, child)
        self._known: dict[str, Array] = {}

    def _add_frame(self, element: Element, default: str) -> None:
        name, pose_element = _name_of(element), element.find("pose")
        if name in self._frames:
            raise RefusedError("damaged", f"two elements have the name {name!r}")
        if pose_element is not None:
            default = pose_element.get("relative_to") or pose_element.get("frame") or default
        self._frames[name] = _pose_of(element), default

    def reference_frame(self, name: str) -> str:
        return self._frames[name][1]

    def T_in_model(self, name: str, path: tuple[str, ...] = ()) -> Array:
        """Return a pose (4, 4) in the model's frame."""
        if name in ("", "__model__"):
            return np.eye(4)
        if name not in self._frames:
            raise RefusedError("damaged", f"a pose is relative to {name!r}, which does not exist")
        if name in path:
            raise RefusedError("cycle", f"the poses of {' and '.join(path[:4])} are relative to each other")
        if name not in self._known:
            T, relative_to = self._frames[name]
            self._known[name] = self.T_in_model(relative_to, (*path, name)) @ T
        return self._known[name]

    def link_of(self, name: str) -> str | None:
        """Return a frame's link; None for the world."""
        steps = 0
        while name not in self._links:
            if name in ("world", "__model__", ""):
                return None
            if name not in self._attached:
                raise RefusedError("damaged", f"a joint names {name!r}, which does not exist")
            name, steps = self._attached[name], steps + 1
            if steps > len(self._attached):
                raise RefusedError("cycle", f"frames are attached to each other around {name!r}")
        return name


def _name_of(element: Element) -> str:
    name = element.get("name", "").strip()
    if not name:
        raise RefusedError("damaged", f"a <{element.tag}> has no name")
    return name


def _pose_of(element: Element) -> Array:
    found = element.find("pose")
    if found is None:
        return np.eye(4)
    if found.get("rotation_format") == "quat_xyzw":
        x, y, z, qx, qy, qz, qw = parse_numbers(found.text, 7, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
        if math.hypot(qx, qy, qz, qw) < 1e-9:
            raise RefusedError("impossible", "it has a quaternion of zeros")
        return pose_from_quat((x, y, z), (qw, qx, qy, qz))
    x, y, z, roll, pitch, yaw = parse_numbers(found.text, 6, (0.0,) * 6)
    factor = math.pi / 180 if found.get("degrees") in ("true", "1") else 1.0
    return pose((x, y, z), rotation_from_rpy(roll * factor, pitch * factor, yaw * factor))
