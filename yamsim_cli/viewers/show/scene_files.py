"""Converts a composed scene to `scene.xml` and all files that the XML names.

MuJoCo writes MJCF for its own version. This module translates it for MuJoCo 3.3, all later versions and dm_control. The
poses of `frame` elements are merged into their children, and values whose defaults differ between versions become
explicit. A scene that 3.3 cannot express is an error.
"""

from __future__ import annotations

import io
import xml.etree.ElementTree as ElementTree
import zipfile
from collections.abc import Iterable, Iterator
from typing import Literal

import mujoco
import numpy as np

from yamsim_cli.core.errors import UsageError
from yamsim_cli.core.geometry.se3 import Array

from .mjcf_3_3 import ATTRIBUTE_VALUES, ATTRIBUTES, CLASS_ELEMENTS, OPTIONAL_ATTRIBUTES

Reader = Literal["3.3", "4"]  # oldest MuJoCo version that must read the scene
Element = ElementTree.Element

_ZIP_DATE = (1980, 1, 1, 0, 0, 0)  # constant, so that equal scenes give equal bytes


def scene_files(spec: mujoco.MjSpec, model: mujoco.MjModel, reader: Reader = "3.3") -> dict[str, bytes]:
    """Return path -> content of a scene's files; `model` is the compiled `spec`. Equal specs give equal bytes."""
    named = {mesh.file for mesh in spec.meshes} | {texture.file for texture in spec.textures}
    files = {name: data for name, data in sorted(spec.assets.items()) if name in named}
    text = mujoco_3_3_xml(spec, model) if reader == "3.3" else spec.to_xml()
    return {"scene.xml": text.encode(), **files}


def zip_bytes(files: dict[str, bytes], folder: str) -> bytes:
    """Return a zip file. Equal files give equal bytes."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            entry = zipfile.ZipInfo(f"{folder}/{name}", _ZIP_DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, data)
    return stream.getvalue()


def mujoco_3_3_xml(spec: mujoco.MjSpec, model: mujoco.MjModel) -> str:
    """Return the MJCF for MuJoCo 3.3 and newer, in full precision; `model` is the compiled `spec`.

    Raise UsageError for an element, attribute or value that 3.3 does not know.
    """
    root = ElementTree.fromstring(_full_precision_mjcf(spec))
    _write_defaults(root, model)
    for body, number in zip(root.iter("body"), range(1, model.nbody), strict=True):
        _write_inertia(body, model, number)
    _unroll_frames(_find_or_add_child(root, "worldbody"))
    for light in root.iter("light"):
        _write_light_type(light)
    for number, actuator in enumerate(_find_or_add_child(root, "actuator")):
        if model.actuator_ctrllimited[number]:
            actuator.set("ctrlrange", _numbers_text(model.actuator_ctrlrange[number]))
    _remove_optional_attributes(root, spec.modelname)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _full_precision_mjcf(spec: mujoco.MjSpec) -> str:
    """Return the MJCF that MuJoCo writes for a spec, in full precision. A compiled spec would give six digits only."""
    compiler = spec.compiler
    before = compiler.savecompiled, compiler.savecanonical
    try:
        compiler.savecompiled, compiler.savecanonical = False, True
        text: str = spec.to_xml()
    finally:
        compiler.savecompiled, compiler.savecanonical = before
    return text


def _write_defaults(root: Element, model: mujoco.MjModel) -> None:
    """Make values explicit whose defaults differ between versions.

    `island`, on by default since 3.3.6, is left out. It only solves the same equations in parts. Older versions colour
    each moving body by its island.
    """
    option = _find_or_add_child(root, "option")
    option.set("ccd_iterations", str(model.opt.ccd_iterations))
    # Since 3.8 a pair of convex geoms may touch at several points. Source: MuJoCo's changelog.
    several = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_MULTICCD
    _find_or_add_child(option, "flag").set("multiccd", "enable" if several else "disable")
    # 4.0 has a third value for the headlight, which gives the same image as 1.
    _find_or_add_child(_find_or_add_child(root, "visual"), "headlight").set(
        "active", "1" if model.vis.headlight.active else "0"
    )


def _write_inertia(body: Element, model: mujoco.MjModel, number: int) -> None:
    """Make a mass of 0 explicit. Otherwise MuJoCo 3.3.5 computes the centre of massless geoms."""
    if model.body_mass[number] == 0 and body.find("inertial") is None:
        place = {"pos": _numbers_text(model.body_ipos[number]), "quat": _numbers_text(model.body_iquat[number])}
        body.insert(0, ElementTree.Element("inertial", {**place, "mass": "0", "diaginertia": "0 0 0"}))


def _write_light_type(light: Element) -> None:
    kind = light.get("type")
    if kind in ("directional", "spot"):
        del light.attrib["type"]
        light.set("directional", "true" if kind == "directional" else "false")


def _unroll_frames(parent: Element) -> None:
    """Replace every `frame` element by its children, with its pose and class applied to them."""
    for child in parent:
        _unroll_frames(child)
    parent[:] = [item for child in parent for item in (_children_in_frame(child) if child.tag == "frame" else [child])]


def _children_in_frame(frame: Element) -> Iterator[Element]:
    position, quat = _attribute_numbers(frame, "pos", "0 0 0"), _attribute_numbers(frame, "quat", "1 0 0 0")
    for child in frame:
        if name := frame.get("childclass"):
            attribute = "childclass" if child.tag == "body" else "class"
            child.set(attribute, child.get(attribute, name))
        child.set("pos", _numbers_text(position + _rotate_vector(_attribute_numbers(child, "pos", "0 0 0"), quat)))
        match child.tag:
            case "light":
                child.set("dir", _numbers_text(_rotate_vector(_attribute_numbers(child, "dir", "0 0 -1"), quat)))
            case "joint":
                child.set("axis", _numbers_text(_rotate_vector(_attribute_numbers(child, "axis", "0 0 1"), quat)))
            case _:
                turn = np.empty(4)
                mujoco.mju_mulQuat(turn, quat, _attribute_numbers(child, "quat", "1 0 0 0"))
                child.set("quat", _numbers_text(turn))
        yield child


def _remove_optional_attributes(root: Element, scene: str) -> None:
    """Remove attributes in `OPTIONAL`. Raise UsageError for anything else that MuJoCo 3.3 does not know."""
    for where, element in _walk_elements(root):
        if where not in ATTRIBUTES:
            raise UsageError(_unknown_feature_message(scene, f"<{element.tag}>"))
        known, optional, values = ATTRIBUTES[where], OPTIONAL_ATTRIBUTES.get(where, {}), ATTRIBUTE_VALUES.get(where, {})
        for name, value in list(element.attrib.items()):
            if name in optional and ((harmless := optional[name]) is None or value in harmless):
                del element.attrib[name]
            elif name not in known or value not in values.get(name, {value}):
                raise UsageError(
                    _unknown_feature_message(scene, f'{name}="{value}" of <{element.tag}> {element.get("name", "")}')
                )


def _unknown_feature_message(scene: str, what: str) -> str:
    return f"scene {scene!r} has {what.strip()}, which MuJoCo 3.3 lacks or reads differently: write it with --mujoco 4"


def _walk_elements(root: Element) -> Iterator[tuple[str, Element]]:
    yield root.tag, root
    for section in root:
        for element in section.iter():
            yield _element_key(section, element), element


def _element_key(section: Element, element: Element) -> str:
    if element is section or element.tag == "default":
        return element.tag
    if section.tag == "default":
        return CLASS_ELEMENTS.get(element.tag, f"default/{element.tag}")
    return f"{section.tag}/{element.tag}"


def _find_or_add_child(parent: Element, tag: str) -> Element:
    found = parent.find(tag)
    return ElementTree.SubElement(parent, tag) if found is None else found


def _rotate_vector(vector: Array, quat: Array) -> Array:
    out = np.empty(3)
    mujoco.mju_rotVecQuat(out, vector, quat)
    return out


def _attribute_numbers(element: Element, name: str, default: str) -> Array:
    return np.array([float(number) for number in element.get(name, default).split()])


def _numbers_text(numbers: Iterable[float]) -> str:
    """Convert without loss of precision; -0 becomes 0."""
    return " ".join(repr(float(number) + 0.0).removesuffix(".0") for number in numbers)
