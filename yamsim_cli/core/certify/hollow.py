"""Whether a visible hollow is one in physics: a ball dropped in stays in."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from ..geometry.columns import columns, water_level
from ..geometry.se3 import Array
from ..scene.compiling import breakdown
from .outcome import Outcome, View, short, unchecked
from .static_checks import NO_MESHES
from .subject import Subject, compiled, grounded_spec, step, with_camera

_CELLS = 56  # columns of the height map along the longer side
_DEEP, _ROOM = 0.010, 0.0045  # m, least depth of a hollow, and least radius of a ball that fits in
_DENT = 0.02  # least volume of a hollow, as a share of the bounding box
_HARD = (0.004, 1.0)  # solref of the ball: hard, so that the ball does not sink through a thin floor
_MOST_RADIUS = 0.015  # m, of the ball
_FROM = 0.03  # m, height over the rim from which the ball is dropped
_SECONDS = 2.0
_IN = 0.5  # most height of the resting ball's lowest point over the floor, as a share of the depth
_DENSITY = 1000.0  # kg/m3, of the ball


@dataclass(frozen=True)
class Hollow:
    """The deepest place where water would stand.

    Attributes:
        place: where a ball is dropped (2,), m.
        floor, level: heights of the surface at that place, and of the water, m.
        room: distance of that place from the walls, m.
        wet: places and floors of the columns under this water (n, 3), m.
    """

    place: Array
    floor: float
    level: float
    room: float
    wet: Array


def hollow_of(subject: Subject) -> Hollow | None:
    """The hollow of a thing as it stands, or None."""
    grid = columns(subject.surface, _CELLS)
    level = water_level(grid.top)
    there = np.isfinite(grid.top)
    depth = np.where(there, level - np.where(there, grid.top, 0.0), 0.0)
    if depth.max(initial=0.0) < _DEEP:
        return None
    block = float(np.prod(np.ptp(subject.surface[0], axis=0)))
    if depth.sum() * grid.cell**2 < _DENT * block:
        return None
    i, j = np.unravel_index(int(depth.argmax()), depth.shape)
    water = level[i, j]
    deep = (depth > 0.6 * depth.max()) & (np.abs(level - water) < 1e-6)
    x, y = np.meshgrid(grid.x, grid.y, indexing="ij")
    dry = np.column_stack([x[~deep], y[~deep]])
    wet = np.column_stack([x[deep], y[deep]])
    room = np.sqrt(((wet[:, None] - dry[None]) ** 2).sum(axis=2).min(axis=1)) - grid.cell / 2
    best = int(room.argmax())
    if room[best] < _ROOM:
        return None
    pond = (depth > 1e-4) & (np.abs(level - water) < 1e-6)
    floors = np.column_stack([x[pond], y[pond], grid.top[pond]])
    return Hollow(wet[best], float(grid.top[deep][best]), float(water), float(room[best]), floors)


def ball(subject: Subject) -> Outcome:
    """Whether a ball that is dropped into the hollow comes to rest inside."""
    if not subject.looks:
        return unchecked(NO_MESHES)
    found = hollow_of(subject)
    if found is None:
        return unchecked("nothing would stay in it: it has no hollow")
    radius = min(0.7 * found.room, _MOST_RADIUS)
    spec = with_camera(grounded_spec(subject), (0, 0, subject.size * 0.2), subject.size, steep=1.2)
    high = max(found.level, float(subject.collision_points[:, 2].max())) + _FROM
    body = spec.worldbody.add_body(name="certificate_ball", pos=[*found.place, high + subject.item.rest_height])
    body.add_freejoint(name="certificate_ball")
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], density=_DENSITY, rgba=[0.9, 0.2, 0.1, 1],
        friction=[0.8, 0.005, 0.0005], condim=4, solref=_HARD, priority=1,
    )  # fmt: skip
    model = compiled(spec)
    data = mujoco.MjData(model)
    at = model.joint(subject.item.name).qposadr[0]
    data.qpos[at + 2] = subject.item.rest_height
    step(model, data, _SECONDS)
    views = (View(model, data.qpos.copy(), "a ball dropped in"),)
    figures = {"depth_mm": short((found.level - found.floor) * 1000, 3), "ball_mm": short(2000 * radius, 3)}
    if (fault := breakdown(data)) is not None:
        return Outcome(False, figures, f"physics broke down: {fault}", views)
    thing = data.body(subject.item.name)
    inside = thing.xmat.reshape(3, 3).T @ (data.body("certificate_ball").xpos - thing.xpos)
    nearest = found.wet[np.linalg.norm(found.wet[:, :2] - inside[:2], axis=1).argmin()]
    offset = float(np.linalg.norm(nearest[:2] - inside[:2]))
    # On a sloping floor the ball rests beside the lowest place.
    over = float(inside[2] - radius - max(nearest[2], found.floor))
    limit = _IN * (found.level - found.floor)
    figures |= {"over_floor_mm": short(over * 1000, 3), "aside_mm": short(offset * 1000, 3)}
    if offset > 2 * radius + 0.002:
        return Outcome(False, figures, "the ball lies beside it", views)
    if over > limit:
        note = f"the ball stays {over * 1000:.3g} mm over its floor: what is seen hollow is not"
        return Outcome(False, figures, note, views)
    if over < -0.25 * radius - 0.004:
        return Outcome(False, figures, f"the ball went through its floor by {-over * 1000:.3g} mm", views)
    return Outcome(True, figures, views=views)
