"""How an arm moves otherwise than its model, written into its MJCF: all of it that an MJCF can say."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree

from ..errors import ConfigError
from . import mjcf
from .dynamics import Dynamics, JointDynamics
from .models import ArmModel, Gripper

# Key of a joint's dynamics -> the element that has it, and as which attribute.
_KEYS = {
    "armature": ("joint", "armature"),
    "damping": ("joint", "damping"),
    "frictionloss": ("joint", "frictionloss"),
    "kp": ("drive", "kp"),
    "kv": ("drive", "kv"),
}
_TIP = "pinch_site"
# A point's inertia, kg m2, since no body may have none.
_POINT = 1e-9


def write_dynamics(root: ElementTree.Element, arm: ArmModel, gripper: Gripper, dynamics: Dynamics) -> None:
    """Write into the MJCF of an arm with its gripper how it moves.

    Gravity factors, offsets and what sensors do are no part of an MJCF. A command's delay is put in where a scene is
    stepped: it needs what was told before, which a model alone has not.

    Raises:
        ConfigError: there is a mass at the tip, and no site to put it.
    """
    for limits in arm.joints:
        parts = {"joint": mjcf.joint(root, limits.name, arm.mjcf), "drive": mjcf.drive(root, limits.name, arm.mjcf)}
        said = dynamics.joints.get(limits.name, JointDynamics())
        for key, (part, attribute) in _KEYS.items():
            if (value := getattr(said, key)) is not None:
                parts[part].set(attribute, mjcf.numbers((value,)))
    if dynamics.tip_mass_g:
        _weigh(root, gripper, dynamics.tip_mass_g / 1000)


def _weigh(root: ElementTree.Element, gripper: Gripper, mass: float) -> None:
    for parent in root.iter():
        for site in parent.findall("site"):
            if site.get("name") == _TIP:
                body = ElementTree.SubElement(parent, "body", {"name": "tip_mass", "pos": site.get("pos", "0 0 0")})
                inertia = mjcf.numbers([_POINT] * 3)
                point = {"pos": "0 0 0", "mass": mjcf.numbers((mass,)), "diaginertia": inertia}
                ElementTree.SubElement(body, "inertial", point)
                return
    raise ConfigError(f"{gripper.mjcf.file}: has no site {_TIP!r}, where tip_mass_g is to be")
