"""SDFormat: one model, its links and joints, with frames told relative to each other.

Source: sdformat.org/spec, versions 1.4 to 1.12, elements model, link, joint, geometry, material and include.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from ..geometry.se3 import Array, inverse
from ..untrusted.jail import Folder
from ..untrusted.refusals import RefusedError
from .looks import mesh_surfaces, plain_material
from .parts import Material, ReadThing, Surface, Weight
from .sdf_frames import Frames, name_of, pose_of
from .solids import seen, touching
from .tree import Joint, Link, bounded, checked_weight, parts_of
from .xml import Element, number, numbers, parse

_DEEPEST_INCLUDE = 8
# How far a finger stands from a handle's middle where a file only marks it, m.
_HANDLE_OPENING = 0.01


def read_sdf(data: bytes, folder: Folder, base: Path) -> ReadThing:
    """The thing that an SDFormat file describes.

    Raises:
        RefusedError: it is damaged, holds several models, or what no config can say.
    """
    model, where = _model(data, folder, base, ())
    reader = _Reader(folder)
    links, joints = reader.model(model, where)
    parts, fixed = parts_of(links, joints)
    static = (model.findtext("static") or "").strip() in ("true", "1")
    notes = tuple(dict.fromkeys(reader.notes))
    return ReadThing(model.get("name", ""), parts, fixed or static, friction=reader.friction, notes=notes)


def _model(data: bytes, folder: Folder, base: Path, seen_files: tuple[Path, ...]) -> tuple[Element, Path]:
    root = parse(data)
    if root.tag != "sdf":
        raise RefusedError("damaged", f"its root is <{root.tag}>, not <sdf>")
    place = root.find("world") if root.find("model") is None and root.find("world") is not None else root
    assert place is not None
    models = [*place.findall("model"), *place.findall("include")]
    if len(models) != 1:
        kind = "empty" if not models else "several-things"
        raise RefusedError(kind, f"it holds {len(models)} models: keep one")
    if models[0].tag == "include":
        return _included(models[0], folder, base, seen_files)
    return models[0], base


def _included(include: Element, folder: Folder, base: Path, seen_files: tuple[Path, ...]) -> tuple[Element, Path]:
    """The model that an include names: an SDF file, or a folder with `model.config`, or just `model.sdf`."""
    uri = (include.findtext("uri") or "").strip()
    path: Path | None = None
    for name in (uri, f"{uri}/model.sdf"):
        try:
            path = folder.find(name, base)
            break
        except RefusedError as error:
            if error.code == "outside" or (name != uri and error.code == "missing"):
                raise
    assert path is not None
    if path in seen_files or len(seen_files) >= _DEEPEST_INCLUDE:
        raise RefusedError("cycle", f"{uri!r} includes itself, or more than {_DEEPEST_INCLUDE} levels deep")
    return _model(folder.read(path.name, path.parent), folder, path.parent, (*seen_files, path))


class _Reader:
    def __init__(self, folder: Folder) -> None:
        self._folder = folder
        self.notes: list[str] = []
        self.friction: float | None = None

    def model(self, model: Element, base: Path, level: int = 0) -> tuple[list[Link], list[Joint]]:
        if level > _DEEPEST_INCLUDE:
            raise RefusedError("cycle", "models lie in models too deeply")
        for tag in ("include", "model"):
            if model.find(tag) is not None:
                raise RefusedError(
                    "several-things", f"model {model.get('name')!r} holds another <{tag}>: put it into one"
                )
        frames = Frames(model)
        links = [self._link(element, frames, base) for element in model.findall("link")]
        by_name = {link.name: link for link in links}
        joints = [self._joint(element, frames) for element in model.findall("joint")]
        for element in model.findall("frame"):
            self._handle(element, frames, by_name, links)
        return links, joints

    def _link(self, element: Element, frames: Frames, base: Path) -> Link:
        name = name_of(element)
        link = Link(name, frames.T(name))
        link.weight = _weight(element.find("inertial"))
        for visual in element.findall("visual"):
            surfaces = self._surfaces(visual, _material(visual, self, base), base)
            link.looks += [surface.moved(pose_of(visual)) for surface in surfaces]
        for collision in element.findall("collision"):
            link.shapes += self._shapes(collision, base)
            mu = collision.findtext("surface/friction/ode/mu")
            if mu is not None:
                self.friction = number(mu)
        return link

    def _surfaces(self, element: Element, material: Material | None, base: Path) -> list[Surface]:
        geometry = element.find("geometry")
        if geometry is None:
            return []
        mesh = geometry.find("mesh")
        if mesh is not None:
            return self._mesh(mesh, material, base)
        found = _plain(geometry)
        if found is None:
            self.notes.append(f"left out: {', '.join(child.tag for child in geometry) or 'an empty geometry'}")
            return []
        return [seen(*found, material or Material())]

    def _mesh(self, mesh: Element, material: Material | None, base: Path) -> list[Surface]:
        scale = numbers(mesh.findtext("scale"), 3, (1.0, 1.0, 1.0))
        if mesh.find("submesh") is not None:
            self.notes.append("submesh: the whole mesh was taken")
        uri = (mesh.findtext("uri") or mesh.findtext("filename") or "").strip()
        return mesh_surfaces(self._folder, uri, base, scale, material)

    def _shapes(self, element: Element, base: Path) -> list[Any]:
        geometry, T = element.find("geometry"), pose_of(element)
        if geometry is None:
            return []
        mesh = geometry.find("mesh")
        if mesh is not None:
            return [surface.moved(T) for surface in self._mesh(mesh, None, base)]
        found = _plain(geometry)
        return [] if found is None else [touching(*found, T)]

    def _joint(self, element: Element, frames: Frames) -> Joint:
        name, kind = name_of(element), element.get("type", "")
        parent, child = ((element.findtext(tag) or "").strip() for tag in ("parent", "child"))
        parent_link, child_link = frames.link_of(parent), frames.link_of(child)
        if child_link is None:
            raise RefusedError("damaged", f"joint {name!r} has no child")
        if kind == "fixed":
            return Joint(name, parent_link, child_link, None)
        types = {"revolute": "hinge", "continuous": "hinge", "prismatic": "slide", "screw": "screw"}
        if kind not in types:
            raise RefusedError("joint-kind", f"joint {name!r} is {kind!r}; valid: fixed, {', '.join(types)}")
        T = inverse(frames.T(child_link)) @ frames.T(name)
        axis = element.find("axis")
        if axis is None:
            raise RefusedError("damaged", f"joint {name!r} has no axis")
        along = axis.find("xyz")
        xyz = np.array(numbers(None if along is None else along.text, 3, (0.0, 0.0, 1.0)))
        within = "" if along is None else along.get("expressed_in", "")
        R = T[:3, :3] if not within else (inverse(frames.T(child_link)) @ frames.T(within))[:3, :3]
        return Joint(name, parent_link, child_link, _moves(element, axis, types[kind], R @ xyz, T[:3, 3]))

    def _handle(self, element: Element, frames: Frames, by_name: dict[str, Link], links: list[Link]) -> None:
        """A frame called `handle...` marks where a hand takes hold: z into it, y along the closing axis."""
        name = name_of(element)
        owner = frames.link_of(element.get("attached_to", "") or frames.relative(name))
        if not name.lower().startswith("handle") or (owner or links[0].name) not in by_name:
            return
        link = by_name[owner or links[0].name]
        T = inverse(link.T) @ frames.T(name)
        link.handles.append(
            {
                "name": name.replace("-", "_"),
                "position": T[:3, 3].tolist(),
                "approach": T[:3, 2].tolist(),
                "axis": T[:3, 1].tolist(),
                "opening": _HANDLE_OPENING,
            }
        )


def _weight(inertial: Element | None) -> Weight | None:
    if inertial is None or inertial.find("mass") is None:
        return None
    T, told = pose_of(inertial), inertial.find("inertia")
    value = {
        key: number(None if told is None else told.findtext(key), default)
        for key, default in (("ixx", 0.0), ("iyy", 0.0), ("izz", 0.0), ("ixy", 0.0), ("ixz", 0.0), ("iyz", 0.0))
    }
    tensor = np.array(
        [
            [value["ixx"], value["ixy"], value["ixz"]],
            [value["ixy"], value["iyy"], value["iyz"]],
            [value["ixz"], value["iyz"], value["izz"]],
        ]
    )
    return checked_weight(number(inertial.findtext("mass")), T[:3, 3], T[:3, :3] @ tensor @ T[:3, :3].T)


def _plain(geometry: Element) -> tuple[str, Array] | None:
    """Kind and size of a plain body, see `solids.touching`."""
    if (found := geometry.find("box")) is not None:
        return "box", np.array(numbers(found.findtext("size"), 3)) / 2
    if (found := geometry.find("sphere")) is not None:
        return "sphere", np.array([number(found.findtext("radius"))])
    if (found := geometry.find("ellipsoid")) is not None:
        return "ellipsoid", np.array(numbers(found.findtext("radii"), 3))
    for kind in ("cylinder", "capsule"):
        if (found := geometry.find(kind)) is not None:
            return kind, np.array([number(found.findtext("radius")), number(found.findtext("length")) / 2])
    return None


def _material(visual: Element, reader: _Reader, base: Path) -> Material | None:
    element = visual.find("material")
    if element is None:
        return None
    if element.find("script") is not None:
        reader.notes.append("material scripts are not read: colours may be missing")
    albedo = (element.findtext("pbr/metal/albedo_map") or element.findtext("pbr/specular/albedo_map") or "").strip()
    diffuse = element.findtext("diffuse")
    if not albedo and diffuse is None:
        return None
    colour = numbers(diffuse, len((diffuse or "1 1 1 1").split()), (1.0,) * 4)
    return plain_material(reader._folder, colour, albedo, base)


def _moves(element: Element, axis: Element, kind: str, direction: Array, position: Array) -> dict[str, Any]:
    turns = kind != "slide"
    low, high = (number(axis.findtext(f"limit/{end}"), sign * math.inf) if axis.findtext(f"limit/{end}") else sign
                 * math.inf for end, sign in (("lower", -1), ("upper", 1)))  # fmt: skip
    moves = {
        "type": kind,
        "axis": direction.tolist(),
        "position": position.tolist(),
        "range": bounded(low, high, turns=turns, name=name_of(element)),
        "damping": number(axis.findtext("dynamics/damping"), 0.0),
        "friction": number(axis.findtext("dynamics/friction"), 0.0),
    }
    if kind == "screw":
        # The older word counts turns a metre, negative; the newer one metres a turn.
        lead = element.findtext("screw_thread_pitch")
        old = number(element.findtext("thread_pitch"), 1.0)
        moves["pitch"] = number(lead) if lead else -2 * math.pi / old if old else 0.0
    return moves
