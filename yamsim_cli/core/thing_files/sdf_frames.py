"""Frames of SDFormat, which are told relative to each other."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..geometry.se3 import Array, pose, pose_from_quat
from ..untrusted.refusals import RefusedError
from .rotations import from_rpy
from .xml import Element, numbers


@dataclass(frozen=True)
class _Frame:
    """A pose told relative to another frame; "" is the model's own."""

    T: Array
    relative_to: str


class Frames:
    """Poses of all that has a name in a model, in the model's own frame.

    Raises:
        RefusedError: two things have the same name, or one has none.
    """

    def __init__(self, model: Element) -> None:
        self._frames: dict[str, _Frame] = {}
        self._attached: dict[str, str] = {}
        self._links = {name_of(element) for element in model.findall("link")}
        for element in model.findall("link"):
            self._add(element, "")
        for element in model.findall("frame"):
            attached = element.get("attached_to", "")
            self._attached[name_of(element)] = attached
            self._add(element, attached)
        for element in model.findall("joint"):
            # A joint's pose is told in its child's frame.
            child = (element.findtext("child") or "").strip()
            self._attached[name_of(element)] = child
            self._add(element, child)
        self._known: dict[str, Array] = {}

    def _add(self, element: Element, default: str) -> None:
        name, told = name_of(element), element.find("pose")
        if name in self._frames:
            raise RefusedError("damaged", f"two things are called {name!r}")
        relative = (told.get("relative_to") or told.get("frame") or default) if told is not None else default
        self._frames[name] = _Frame(pose_of(element), relative)

    def relative(self, name: str) -> str:
        """The frame in which the pose of another one is told."""
        return self._frames[name].relative_to

    def T(self, name: str, on_way: tuple[str, ...] = ()) -> Array:
        """Pose (4, 4) of a frame in the model's.

        Raises:
            RefusedError: it is not there, or told relative to itself.
        """
        if name in ("", "__model__"):
            return np.eye(4)
        if name not in self._frames:
            raise RefusedError("damaged", f"it tells a pose relative to {name!r}, which is not there")
        if name in on_way:
            raise RefusedError("cycle", f"the poses of {' and '.join(on_way[:4])} are told relative to each other")
        if name not in self._known:
            frame = self._frames[name]
            self._known[name] = self.T(frame.relative_to, (*on_way, name)) @ frame.T
        return self._known[name]

    def link_of(self, name: str) -> str | None:
        """The link that a frame belongs to; None for the world.

        Raises:
            RefusedError: it is not there, or belongs to itself.
        """
        steps = 0
        while name not in self._links:
            if name in ("world", "__model__", "") or name not in self._attached:
                if name not in ("world", "__model__", ""):
                    raise RefusedError("damaged", f"a joint names {name!r}, which is not there")
                return None
            name, steps = self._attached[name], steps + 1
            if steps > len(self._attached):
                raise RefusedError("cycle", f"frames are attached to each other around {name!r}")
        return name


def name_of(element: Element) -> str:
    """What an element is called.

    Raises:
        RefusedError: it has no name.
    """
    name = element.get("name", "").strip()
    if not name:
        raise RefusedError("damaged", f"a <{element.tag}> has no name")
    return name


def pose_of(element: Element) -> Array:
    """Pose (4, 4) that an element tells of itself, in whichever frame that is.

    Raises:
        RefusedError: it is none.
    """
    told = element.find("pose")
    if told is None:
        return np.eye(4)
    if told.get("rotation_format") == "quat_xyzw":
        x, y, z, qx, qy, qz, qw = numbers(told.text, 7, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
        if math.hypot(qx, qy, qz, qw) < 1e-9:
            raise RefusedError("impossible", "it has a rotation of zeros")
        return pose_from_quat((x, y, z), (qw, qx, qy, qz))
    x, y, z, roll, pitch, yaw = numbers(told.text, 6, (0.0,) * 6)
    factor = math.pi / 180 if told.get("degrees") in ("true", "1") else 1.0
    return pose((x, y, z), from_rpy(roll * factor, pitch * factor, yaw * factor))
