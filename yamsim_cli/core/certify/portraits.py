"""Pictures of a thing by itself: as it is seen, what touches of it, and where its weight is."""

from __future__ import annotations

import mujoco
import numpy as np

from ..scene.things.looks import HIDDEN_GROUP, SEEN_GROUP
from .outcome import View
from .subject import Subject, bare_spec, compiled, with_camera

_MARK = (0.85, 0.15, 0.10, 1.0)
# Through what is seen shines the mark of its weight.
_THIN = 0.35


def portrait(looked: Subject, caption: str, *, steep: float = 0.75) -> View:
    """The thing as it stands; `steep` is how high the camera is for its distance."""
    return _taken(_spec(looked, steep), caption)


def touching(looked: Subject) -> View:
    """What touches of it, in place of what is seen."""
    view = _taken(_spec(looked, 0.75), "what touches")
    touches = (view.model.geom_contype > 0) | (view.model.geom_conaffinity > 0)
    view.model.geom_group[:] = np.where(touches, SEEN_GROUP, HIDDEN_GROUP)
    return view


def weighted(looked: Subject, *, block: bool) -> View:
    """The thing, thin, and its centre of mass; or the block that is as hard to turn as it is."""
    inertia = looked.item.inertia
    spec = _spec(looked, 0.75)
    size = np.full(3, 0.03 * float(np.linalg.norm(np.ptp(looked.touching, axis=0))))
    if block:
        # Of an even block the moments are m (b2 + c2) / 12, and so on.
        moments = np.array(inertia.diagonal)
        size = np.sqrt(np.maximum(6 * (moments.sum() - 2 * moments) / inertia.mass, 1e-8)) / 2
    kind = mujoco.mjtGeom.mjGEOM_BOX if block else mujoco.mjtGeom.mjGEOM_SPHERE
    spec.body(looked.item.name).add_geom(
        type=kind, size=size, pos=inertia.centre, quat=np.array(inertia.quat) / np.linalg.norm(inertia.quat),
        rgba=_MARK, contype=0, conaffinity=0, mass=0, group=SEEN_GROUP, name="certificate_mark",
    )  # fmt: skip
    for material in spec.materials:
        material.rgba = (*material.rgba[:3], _THIN)
    return _taken(spec, "as hard to turn as this block" if block else "its centre of mass")


def _spec(looked: Subject, steep: float) -> mujoco.MjSpec:
    points = looked.surface[0] if looked.shown else looked.touching
    low, high = points.min(axis=0), points.max(axis=0)
    size = float(np.linalg.norm(high - low))
    return with_camera(bare_spec(looked.item, looked.meshes), (low + high) / 2, size, steep)


def _taken(spec: mujoco.MjSpec, caption: str) -> View:
    model = compiled(spec)
    return View(model, model.qpos0.copy(), caption)
