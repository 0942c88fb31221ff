from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Iterator, Mapping
from pathlib import PurePosixPath

from ..errors import ConfigError
from ..files.untrusted.refusals import RefusedError
from ..geometry.se3 import pose_from_quat, quat_from_rotation
from .dynamics import JointDynamics, MeasuredArmDynamics
from .finray.segment_chain import add_fingers, get_or_add_child
from .models import ArmModel, Element, Gripper, GripperFit, JointChange, Mjcf, Placement, parse_root

# Sections that are merged into the arm's MJCF, besides body and default classes.
_MERGED_SECTIONS = ("asset", "equality", "tendon", "contact", "actuator", "sensor")
# Only an arm may have these. A keyframe fits only one model, so keyframes are not allowed.
_ARM_SECTIONS = ("option", "size", "visual", "statistic", "custom")

# Elements that read files or load plugins, which MJCFs of robots must not do. Includes are expanded before.
_FORBIDDEN_ELEMENTS = ("include", "plugin", "extension", "attach", "model", "hfield", "skin", "flexcomp", "composite")

# Sites that every gripper must have: where the fingers meet, and the hand frame whose pose is recorded.
_SITES = ("pinch_site", "grasp_site")

# Attributes outside `worldbody` that name a body.
_BODY_ATTRIBUTES = ("body", "body1", "body2")

# Field of `JointChange` or `JointDynamics` -> element and attribute in MJCF.
_ATTRIBUTES = {
    "range": ("joint", "range"),
    "armature": ("joint", "armature"),
    "damping": ("joint", "damping"),
    "frictionloss": ("joint", "frictionloss"),
    "kp": ("drive", "kp"),
    "kv": ("drive", "kv"),
    "torque": ("drive", "forcerange"),
}
_TIP_SITE = "pinch_site"  # of the additional mass `tip_mass_g` of identified dynamics
_MIN_INERTIA = 1e-9  # kg m2, of a point mass: MuJoCo needs an inertia above 0


def merge_gripper(arm: ArmModel, gripper: Gripper, fit: GripperFit) -> Element:
    """Return the MJCF of an arm with a gripper, or raise ConfigError.

    The gripper's default classes get the gripper's name as prefix. Assets that are equal in both files are merged.
    """
    root, hand = parse_mjcf(arm.mjcf), parse_mjcf(gripper.mjcf)
    if gripper.finray is not None:
        for foot in gripper.finray.feet:
            find_body(hand, foot, gripper.mjcf)
        add_fingers(hand, gripper.name, gripper.finray)
    _check_sections(root, arm.mjcf, (*_MERGED_SECTIONS, *_ARM_SECTIONS))
    _check_sections(hand, gripper.mjcf, _MERGED_SECTIONS)
    if (ours := _merged_attributes(root, "compiler")) != (theirs := _merged_attributes(hand, "compiler")):
        raise ConfigError(f"{gripper.mjcf.file}: <compiler> has {theirs}, but {arm.mjcf.file} {ours}; make them equal")
    flange = find_body(root, arm.flange, arm.mjcf)
    frame = _gripper_frame(hand, gripper.mjcf)
    _check_sites(frame, gripper.mjcf)
    _check_names(root, frame, arm.mjcf, gripper.mjcf)
    _prefix_classes(hand, gripper.name)
    _rename_body(hand, frame.get("name", ""), arm.flange)
    _attach_gripper_frame(flange, frame, fit.mount)
    _append_section(root, hand, "default")
    _add_assets(root, hand, arm.mjcf, gripper.mjcf)
    for one, other in fit.excludes:
        get_or_add_child(root, "contact").append(Element("exclude", {"body1": one, "body2": other}))
    for section in _MERGED_SECTIONS[1:]:
        _append_section(root, hand, section)
    _change_joints(root, arm, fit.joints)
    return root


def parse_mjcf(mjcf: Mjcf) -> Element:
    """Return the root element of an MJCF.

    Raises ConfigError if the text is no MJCF, declares entities, or names files other than meshes `<set>/<file>`.
    """
    try:
        root = parse_root(mjcf.text)
    except RefusedError as error:
        raise ConfigError(f"{mjcf.file}: {error}") from error
    if root.tag != "mujoco":
        raise ConfigError(f"{mjcf.file}: begins with <{root.tag}>; an MJCF begins with <mujoco>")
    _check_files(root, mjcf)
    return root


def _check_files(root: Element, mjcf: Mjcf) -> None:
    """MuJoCo must open no file by itself: an MJCF may only name meshes as `<set>/<file>`."""
    for element in root.iter():
        if element.tag in _FORBIDDEN_ELEMENTS:
            raise ConfigError(f"{mjcf.file}: <{element.tag}> is not supported here; write its content into this file")
        for key, value in element.attrib.items():
            if key.endswith("dir") and element.tag == "compiler":
                raise ConfigError(f"{mjcf.file}: <compiler> has {key} {value!r}; leave it out: meshes are <set>/<file>")
            if not key.startswith("file"):
                continue
            if element.tag != "mesh":
                raise ConfigError(f"{mjcf.file}: <{element.tag}> names the file {value!r}; valid: mesh files")
            path = PurePosixPath(value)
            if "\\" in value or path.is_absolute() or ".." in path.parts or len(path.parts) < 2:
                raise ConfigError(f"{mjcf.file}: a mesh names the file {value!r}; valid: <set>/<file>, without ..")


def find_body(root: Element, name: str, mjcf: Mjcf) -> Element:
    """Return the body called `name`, or raise ConfigError."""
    bodies = {found.get("name", ""): found for found in root.iter("body")}
    if name not in bodies:
        raise ConfigError(f"{mjcf.file}: has no body {name!r}; its bodies: {', '.join(bodies) or 'none'}")
    return bodies[name]


def find_joint(root: Element, name: str, mjcf: Mjcf) -> Element:
    """Return the joint called `name` in `worldbody`, or raise ConfigError."""
    joints = {
        found.get("name", ""): found for part in _section_elements(root, "worldbody") for found in part.iter("joint")
    }
    if name not in joints:
        raise ConfigError(f"{mjcf.file}: has no joint {name!r}; its joints: {', '.join(joints) or 'none'}")
    return joints[name]


def find_position_drive(root: Element, joint: str, mjcf: Mjcf) -> Element:
    """Return a joint's only actuator, or raise ConfigError if it is no <position> with a name."""
    found = [element for element in _section_elements(root, "actuator") if element.get("joint") == joint]
    if len(found) != 1 or found[0].tag != "position" or not found[0].get("name"):
        raise ConfigError(f"{mjcf.file}: joint {joint!r} needs one <position> actuator with a name of its own")
    return found[0]


def format_numbers(values: Iterable[float]) -> str:
    """Return numbers as an MJCF attribute, without loss of precision."""
    return " ".join(repr(float(value)).removesuffix(".0") for value in values)


def _check_sections(root: Element, mjcf: Mjcf, allowed: Iterable[str]) -> None:
    valid = ("compiler", "default", "worldbody", *allowed)
    for section in root:
        if section.tag not in valid:
            raise ConfigError(f"{mjcf.file}: <{section.tag}> is not allowed here; valid: {', '.join(sorted(valid))}")
    for default in root.findall("default"):
        for element in default:
            if element.tag != "default":
                raise ConfigError(
                    f"{mjcf.file}: <default> has <{element.tag}> in no class, which would change other models too; "
                    "put it into a <default class=...>"
                )


def _merged_attributes(root: Element, tag: str) -> dict[str, str]:
    return {key: value for element in root.findall(tag) for key, value in sorted(element.attrib.items())}


def _gripper_frame(hand: Element, mjcf: Mjcf) -> Element:
    bodies = list(_section_elements(hand, "worldbody"))
    if len(bodies) != 1 or bodies[0].tag != "body" or not bodies[0].get("name"):
        raise ConfigError(f"{mjcf.file}: <worldbody> must have exactly one body, the gripper's frame, with a name")
    frame = bodies[0]
    if extra := sorted(set(frame.attrib) - {"name", "childclass"}):
        raise ConfigError(
            f"{mjcf.file}: body {frame.get('name')!r} becomes part of the flange and cannot have {', '.join(extra)}; "
            "give its pose with `mount`"
        )
    if frame.find("joint") is not None or frame.find("freejoint") is not None:
        raise ConfigError(f"{mjcf.file}: body {frame.get('name')!r} has a joint; it becomes part of the flange")
    return frame


def _check_sites(frame: Element, mjcf: Mjcf) -> None:
    found = {site.get("name") for site in frame.iter("site")}
    for name in _SITES:
        if name not in found:
            raise ConfigError(
                f"{mjcf.file}: has no site {name!r}; add <site name={name!r} pos=... quat=.../> to body "
                f"{frame.get('name')!r}: z into the grasp, y along the closing direction"
            )


def _check_names(root: Element, frame: Element, arms: Mjcf, grippers: Mjcf) -> None:
    used = {
        (element.tag, element.get("name"))
        for part in _section_elements(root, "worldbody")
        for element in part.iter()
        if element.get("name")
    }
    for element in (part for child in frame for part in child.iter()):
        if (element.tag, element.get("name")) in used:
            raise ConfigError(
                f"{grippers.file}: {arms.file} also has a {element.tag} {element.get('name')!r}; rename it"
            )


def _prefix_classes(hand: Element, name: str) -> None:
    for element in hand.iter():
        for key in ("class", "childclass"):
            if key in element.attrib:
                element.set(key, f"{name}_{element.get(key)}")


def _rename_body(hand: Element, name: str, new: str) -> None:
    for section in hand:
        if section.tag != "worldbody":
            for element in section.iter():
                for key in _BODY_ATTRIBUTES:
                    if element.get(key) == name:
                        element.set(key, new)


def _attach_gripper_frame(flange: Element, frame: Element, mount: Placement) -> None:
    inside = Element("frame")
    if childclass := frame.get("childclass"):
        inside.set("childclass", childclass)
    moved = mount != Placement()
    if moved:
        inside.set("pos", format_numbers(mount.position))
        inside.set("quat", format_numbers(mount.quat))
    for element in frame:
        if element.tag != "inertial":
            inside.append(element)
            continue
        for own in flange.findall("inertial"):
            flange.remove(own)
        if moved:
            _transform_inertial(element, mount)
        flange.insert(0, element)
    if len(inside):
        flange.append(inside)


def _transform_inertial(inertial: Element, mount: Placement) -> None:
    place, turn = (
        [float(number) for number in inertial.get(key, default).split()]
        for key, default in (("pos", "0 0 0"), ("quat", "1 0 0 0"))
    )
    T = mount.T @ pose_from_quat(place, turn)
    inertial.set("pos", format_numbers(T[:3, 3]))
    inertial.set("quat", format_numbers(quat_from_rotation(T[:3, :3])))


def _section_elements(root: Element, section: str) -> Iterator[Element]:
    for found in root.findall(section):
        yield from found


def _append_section(root: Element, hand: Element, section: str) -> None:
    if parts := list(_section_elements(hand, section)):
        get_or_add_child(root, section).extend(parts)


def _add_assets(root: Element, hand: Element, arms: Mjcf, grippers: Mjcf) -> None:
    known = {(element.tag, element.get("name")): element for element in _section_elements(root, "asset")}
    for element in _section_elements(hand, "asset"):
        same = known.get((element.tag, element.get("name")))
        if same is None:
            get_or_add_child(root, "asset").append(element)
        elif same.attrib != element.attrib:
            raise ConfigError(
                f"{grippers.file}: <{element.tag}> {element.get('name')!r} differs from that in {arms.file}; rename it"
            )


def _change_joints(root: Element, arm: ArmModel, changes: Mapping[str, JointChange]) -> None:
    names = [limits.name for limits in arm.joints]
    for name in changes:
        if name not in names:
            raise ConfigError(f"{arm.name}: a gripper changes an unknown joint {name!r}; valid: {', '.join(names)}")
    for limits in arm.joints:
        if "range" in find_joint(root, limits.name, arm.mjcf).attrib:
            raise ConfigError(
                f"{arm.mjcf.file}: joint {limits.name!r} has a range; leave it out, because model.yaml gives it"
            )
        change = changes.get(limits.name, JointChange())
        _set_joint(root, arm, limits.name, change.model_copy(update={"range": change.range or limits.range}))


def write_dynamics(root: Element, arm: ArmModel, gripper: Gripper, dynamics: MeasuredArmDynamics) -> None:
    """Write an arm's dynamics into the merged MJCF of arm and gripper, or raise ConfigError.

    Gravity factors, encoder offsets, sensor errors and delays have no attribute in MJCF, and are not written.
    """
    for limits in arm.joints:
        _set_joint(root, arm, limits.name, dynamics.joint(limits.name))
    if not dynamics.tip_mass_g:
        return
    for parent in root.iter():
        for site in parent.findall("site"):
            if site.get("name") == _TIP_SITE:
                body = ElementTree.SubElement(parent, "body", {"name": "tip_mass", "pos": site.get("pos", "0 0 0")})
                mass, inertia = format_numbers((dynamics.tip_mass_g / 1000,)), format_numbers([_MIN_INERTIA] * 3)
                ElementTree.SubElement(body, "inertial", {"pos": "0 0 0", "mass": mass, "diaginertia": inertia})
                return
    raise ConfigError(f"{gripper.mjcf.file}: has no site {_TIP_SITE!r}, which tip_mass_g needs")


def _set_joint(root: Element, arm: ArmModel, name: str, values: JointChange | JointDynamics) -> None:
    parts = {"joint": find_joint(root, name, arm.mjcf), "drive": find_position_drive(root, name, arm.mjcf)}
    for key, (part, attribute) in _ATTRIBUTES.items():
        value = getattr(values, key, None)
        if value is not None:
            written = (-value, value) if key == "torque" else value if isinstance(value, tuple) else (value,)
            parts[part].set(attribute, format_numbers(written))


def coupling_ratio(root: Element, one: str, other: str) -> float:
    """Return position of joint `one` / position of joint `other`, as an equality couples them; 1 without equality."""
    for element in _section_elements(root, "equality"):
        factor = float(element.get("polycoef", "0 1 0 0 0").split()[1])
        match element.get("joint1"), element.get("joint2"):
            case (first, second) if element.tag == "joint" and (first, second) == (one, other):
                return factor
            case (first, second) if element.tag == "joint" and (first, second) == (other, one):
                return 1.0 / factor
    return 1.0
