"""A composed scene in the MJCF of MuJoCo 3.3, which all later versions and dm_control read too, with the same physics.

MuJoCo writes MJCF of its own version, which is translated here. Frames become part of their children's poses, and
values whose defaults differ between versions are written out. A scene that 3.3 cannot express is refused.
"""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Iterator

import mujoco
import numpy as np

from ..errors import UsageError
from ..geometry.se3 import Array
from .mjcf_3_3 import ATTRIBUTES, CLASS_ELEMENTS, OPTIONAL, VALUES

Element = ElementTree.Element


def classic_xml(spec: mujoco.MjSpec, model: mujoco.MjModel) -> str:
    """The MJCF of a scene for MuJoCo 3.3 and newer; numbers are written in full, so that none is rounded.

    Args:
        model: the compiled `spec`.

    Raises:
        UsageError: the scene holds something that 3.3 does not know.
    """
    root = ElementTree.fromstring(_as_authored(spec))
    _say_defaults(root, model)
    for body, number in zip(root.iter("body"), range(1, model.nbody), strict=True):
        _say_inertia(body, model, number)
    _unroll(_child(root, "worldbody"))
    for light in root.iter("light"):
        _say_direction(light)
    for number, actuator in enumerate(_child(root, "actuator")):
        if model.actuator_ctrllimited[number]:
            actuator.set("ctrlrange", _text(model.actuator_ctrlrange[number]))
    _reduce(root, spec.modelname)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _as_authored(spec: mujoco.MjSpec) -> str:
    """MuJoCo's own MJCF of the scene with all digits; for a compiled spec it would round to six."""
    compiler = spec.compiler
    before = compiler.savecompiled, compiler.savecanonical
    try:
        compiler.savecompiled, compiler.savecanonical = False, True
        text: str = spec.to_xml()
    finally:
        compiler.savecompiled, compiler.savecanonical = before
    return text


def _say_defaults(root: Element, model: mujoco.MjModel) -> None:
    """Write out the values whose defaults differ between versions.

    `island` is left out. It is on by default since 3.3.6, and only solves the same equations in parts. If it is
    written, older versions colour each moving body by its island.
    """
    option = _child(root, "option")
    option.set("ccd_iterations", str(model.opt.ccd_iterations))
    # Since 3.8 a pair of convex geoms may touch at several points. Source: MuJoCo's changelog.
    several = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_MULTICCD
    _child(option, "flag").set("multiccd", "enable" if several else "disable")
    # 4.0 has a third value for the headlight, which looks the same as 1.
    _child(_child(root, "visual"), "headlight").set("active", "1" if model.vis.headlight.active else "0")


def _say_inertia(body: Element, model: mujoco.MjModel, number: int) -> None:
    """Write out that a body weighs nothing; otherwise MuJoCo 3.3.5 looks for the centre of its massless geoms."""
    if model.body_mass[number] == 0 and body.find("inertial") is None:
        place = {"pos": _text(model.body_ipos[number]), "quat": _text(model.body_iquat[number])}
        body.insert(0, ElementTree.Element("inertial", {**place, "mass": "0", "diaginertia": "0 0 0"}))


def _say_direction(light: Element) -> None:
    """Write a light's type as the one attribute that 3.3.0 has for it."""
    kind = light.get("type")
    if kind in ("directional", "spot"):
        del light.attrib["type"]
        light.set("directional", "true" if kind == "directional" else "false")


def _unroll(parent: Element) -> None:
    """Replace every frame by its children, which take over its pose and class, in place."""
    for child in parent:
        _unroll(child)
    parent[:] = [item for child in parent for item in (_moved(child) if child.tag == "frame" else [child])]


def _moved(frame: Element) -> Iterator[Element]:
    position, quat = _numbers(frame, "pos", "0 0 0"), _numbers(frame, "quat", "1 0 0 0")
    for child in frame:
        if name := frame.get("childclass"):
            attribute = "childclass" if child.tag == "body" else "class"
            child.set(attribute, child.get(attribute, name))
        child.set("pos", _text(position + _turned(_numbers(child, "pos", "0 0 0"), quat)))
        match child.tag:
            case "light":
                child.set("dir", _text(_turned(_numbers(child, "dir", "0 0 -1"), quat)))
            case "joint":
                child.set("axis", _text(_turned(_numbers(child, "axis", "0 0 1"), quat)))
            case _:
                turn = np.empty(4)
                mujoco.mju_mulQuat(turn, quat, _numbers(child, "quat", "1 0 0 0"))
                child.set("quat", _text(turn))
        yield child


def _reduce(root: Element, scene: str) -> None:
    """Remove the attributes that 3.3 does not need, and refuse those that it does not know."""
    for where, element in _walk(root):
        if where not in ATTRIBUTES:
            raise UsageError(_unknown(scene, f"<{element.tag}>"))
        known, optional, values = ATTRIBUTES[where], OPTIONAL.get(where, {}), VALUES.get(where, {})
        for name, value in list(element.attrib.items()):
            if name in optional and ((harmless := optional[name]) is None or value in harmless):
                del element.attrib[name]
            elif name not in known or value not in values.get(name, {value}):
                raise UsageError(_unknown(scene, f'{name}="{value}" of <{element.tag}> {element.get("name", "")}'))


def _unknown(scene: str, what: str) -> str:
    return f"scene {scene!r} has {what.strip()}, which MuJoCo 3.3 does not read, or otherwise: write it with --mujoco 4"


def _walk(root: Element) -> Iterator[tuple[str, Element]]:
    """Every element, with its key in the tables."""
    yield root.tag, root
    for section in root:
        for element in section.iter():
            yield _key(section, element), element


def _key(section: Element, element: Element) -> str:
    if element is section or element.tag == "default":
        return element.tag
    if section.tag == "default":
        return CLASS_ELEMENTS.get(element.tag, f"default/{element.tag}")
    return f"{section.tag}/{element.tag}"


def _child(parent: Element, tag: str) -> Element:
    """The child with this tag; made if there is none."""
    found = parent.find(tag)
    return ElementTree.SubElement(parent, tag) if found is None else found


def _turned(vector: Array, quat: Array) -> Array:
    out = np.empty(3)
    mujoco.mju_rotVecQuat(out, vector, quat)
    return out


def _numbers(element: Element, name: str, default: str) -> Array:
    return np.array([float(number) for number in element.get(name, default).split()])


def _text(numbers: Iterable[float]) -> str:
    """Numbers as text that reads back to the same values; -0 is written as 0."""
    return " ".join(repr(float(number) + 0.0).removesuffix(".0") for number in numbers)
