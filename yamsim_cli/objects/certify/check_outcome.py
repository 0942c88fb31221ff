"""Describe a check's outcome by figures, a note, and scenes to picture."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.scene.objects.object_geoms import HIDDEN_GROUP, VISIBLE_GROUP

from .tested_object import TestedObject, add_view_camera, compile_or_raise, object_spec

_MARKER_RGBA = (0.85, 0.15, 0.10, 1.0)  # of the sphere or box that shows mass properties
_OBJECT_OPACITY = 0.35  # the object around that shape


@dataclass(frozen=True)
class CheckView:
    """A scene with joint positions, for its camera `view`."""

    model: mujoco.MjModel
    qpos: Array
    caption: str


@dataclass(frozen=True)
class CheckOutcome:
    """The outcome of one check.

    Attributes:
        ok: None if the check was skipped.
        figures: name -> value; names end in the unit.
        note: the fault, or why the check was skipped.
        views: to be rendered as pictures.
    """

    ok: bool | None
    figures: Mapping[str, float | int | str] = field(default_factory=dict)
    note: str = ""
    views: tuple[CheckView, ...] = ()


def skipped_outcome(why: str) -> CheckOutcome:
    """Return the outcome of a check that cannot run."""
    return CheckOutcome(None, note=why)


def round_significant(value: Any, digits: int = 4) -> float:
    """Round to significant digits."""
    return float(f"{float(value):.{digits}g}")


def object_view(tested_object: TestedObject, caption: str, *, steep: float = 0.75) -> CheckView:
    """View the object in its initial pose; a negative `steep` looks up from below."""
    return _initial_view(_scene_spec(tested_object, steep), caption)


def collision_view(tested_object: TestedObject) -> CheckView:
    """Return a view of the collision geoms."""
    view = _initial_view(_scene_spec(tested_object, 0.75), "collision parts")
    touches = (view.model.geom_contype > 0) | (view.model.geom_conaffinity > 0)
    view.model.geom_group[:] = np.where(touches, VISIBLE_GROUP, HIDDEN_GROUP)
    return view


def inertia_view(tested_object: TestedObject, *, block: bool) -> CheckView:
    """View the transparent object with its centre of mass, or if `block` a box of equal inertia."""
    inertia = tested_object.item.inertia
    spec = _scene_spec(tested_object, 0.75)
    size = np.full(3, 0.03 * tested_object.bounding_diagonal)
    if block:
        # A box with edges a, b and c has the moment m (b2 + c2) / 12 about the axis along a.
        moments = np.array(inertia.diagonal)
        size = np.sqrt(np.maximum(6 * (moments.sum() - 2 * moments) / inertia.mass, 1e-8)) / 2
    kind = mujoco.mjtGeom.mjGEOM_BOX if block else mujoco.mjtGeom.mjGEOM_SPHERE
    spec.body(tested_object.item.name).add_geom(
        type=kind, size=size, pos=inertia.centre, quat=np.array(inertia.quat) / np.linalg.norm(inertia.quat),
        rgba=_MARKER_RGBA, contype=0, conaffinity=0, mass=0, group=VISIBLE_GROUP, name="certificate_mark",
    )  # fmt: skip
    for material in spec.materials:
        material.rgba = (*material.rgba[:3], _OBJECT_OPACITY)
    return _initial_view(spec, "box of equal inertia" if block else "centre of mass")


def _scene_spec(tested_object: TestedObject, steep: float) -> mujoco.MjSpec:
    low, high = tested_object.surface_points.min(axis=0), tested_object.surface_points.max(axis=0)
    size = float(np.linalg.norm(high - low))
    return add_view_camera(object_spec(tested_object.item, tested_object.meshes), (low + high) / 2, size, steep)


def _initial_view(spec: mujoco.MjSpec, caption: str) -> CheckView:
    model = compile_or_raise(spec)
    return CheckView(model, model.qpos0.copy(), caption)
