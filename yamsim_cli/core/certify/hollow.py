"""Whether what is seen to be hollow is: a ball dropped in stays in."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from ..geometry.columns import columns, water_level
from ..geometry.se3 import Array
from ..scene.breakdown import breakdown
from .looks import NO_LOOKS
from .outcome import Outcome, View, short, unchecked
from .subject import Subject, compiled, grounded_spec, with_camera

_CELLS = 56
# What holds water so deep, with room for a ball of this radius, is hollow, m.
_DEEP, _ROOM = 0.010, 0.0045
# A dent holds less than this share of the block around the thing.
_DENT = 0.02
# The ball is hard, so that it does not sink through a thin floor: s.
_HARD = (0.004, 1.0)
_MOST_RADIUS = 0.015
_FROM = 0.03
_SECONDS = 2.0
# A ball is in when its lowest point is this share of the water's depth over the floor.
_IN = 0.5
_DENSITY = 1000.0


@dataclass(frozen=True)
class Hollow:
    """The deepest place where water would stand.

    Attributes:
        place: where a ball is dropped (2,), m.
        floor, level: heights of the ground there, and of the water, m.
        room: how far that place is from anything, m.
        wet: columns (n, 3) of this pond: their places and floors, m.
    """

    place: Array
    floor: float
    level: float
    room: float
    wet: Array


def hollow_of(looked: Subject) -> Hollow | None:
    """The hollow of a thing as it stands; None where it has none."""
    grid = columns(looked.surface, _CELLS)
    level = water_level(grid.top)
    there = np.isfinite(grid.top)
    depth = np.where(there, level - np.where(there, grid.top, 0.0), 0.0)
    if depth.max(initial=0.0) < _DEEP:
        return None
    block = float(np.prod(np.ptp(looked.surface[0], axis=0)))
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


def ball(looked: Subject) -> Outcome:
    """Whether a ball that is dropped into its hollow comes to lie in there."""
    if not looked.shown:
        return unchecked(NO_LOOKS)
    found = hollow_of(looked)
    if found is None:
        return unchecked("nothing would stay in it: it has no hollow")
    radius = min(0.7 * found.room, _MOST_RADIUS)
    size = float(np.linalg.norm(np.ptp(looked.touching, axis=0)))
    spec = with_camera(grounded_spec(looked), (0, 0, size * 0.2), size, steep=1.2)
    high = max(found.level, float(looked.touching[:, 2].max())) + _FROM
    body = spec.worldbody.add_body(name="certificate_ball", pos=[*found.place, high + looked.item.rest_height])
    body.add_freejoint(name="certificate_ball")
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], density=_DENSITY, rgba=[0.9, 0.2, 0.1, 1],
        friction=[0.8, 0.005, 0.0005], condim=4, solref=_HARD, priority=1,
    )  # fmt: skip
    model = compiled(spec)
    data = mujoco.MjData(model)
    at = model.joint(looked.item.name).qposadr[0]
    data.qpos[at + 2] = looked.item.rest_height
    for _ in range(round(_SECONDS / model.opt.timestep)):
        mujoco.mj_step(model, data)
    views = (View(model, data.qpos.copy(), "a ball dropped in"),)
    figures = {
        "depth_mm": short((found.level - found.floor) * 1000, 3),
        "ball_mm": short(2000 * radius, 3),
    }
    if (fault := breakdown(data)) is not None:
        return Outcome(False, figures, f"physics broke down: {fault}", views)
    thing = data.body(looked.item.name)
    inside = thing.xmat.reshape(3, 3).T @ (data.body("certificate_ball").xpos - thing.xpos)
    nearest = found.wet[np.linalg.norm(found.wet[:, :2] - inside[:2], axis=1).argmin()]
    aside = float(np.linalg.norm(nearest[:2] - inside[:2]))
    # Where the floor is not level, the ball rests beside its lowest place.
    over = float(inside[2] - radius - max(nearest[2], found.floor))
    limit = _IN * (found.level - found.floor)
    figures |= {"over_floor_mm": short(over * 1000, 3), "aside_mm": short(aside * 1000, 3)}
    if aside > 2 * radius + 0.002:
        return Outcome(False, figures, "the ball lies beside it", views)
    if over > limit:
        return Outcome(
            False, figures, f"the ball stays {over * 1000:.3g} mm over its floor: what is seen hollow is not", views
        )
    if over < -0.25 * radius - 0.004:
        return Outcome(False, figures, f"the ball went through its floor by {-over * 1000:.3g} mm", views)
    return Outcome(True, figures, views=views)
