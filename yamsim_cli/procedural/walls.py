"""Walls around a station."""

from __future__ import annotations

import math

import mujoco

WALL_MATERIAL = "walls"
_HALF_ROOM = 2.5  # m, half the room's edge: random views of `yamsim draw` stay within it
_HEIGHT = 2.6  # m, from the floor; a usual room
_HALF_THICKNESS = 0.05  # m

# Name of a wall -> direction from the room's middle, rad.
_WALLS = {f"wall_{k}": k * math.pi / 2 for k in range(4)}
WALL_NAMES = tuple(_WALLS)


def add_walls(spec: mujoco.MjSpec, floor: float, group: int) -> None:
    """Add four walls to a scene's spec, which touch nothing and cast no shadows.

    Args:
        floor: height of the floor in `world`, m.
        group: MuJoCo's group of the geoms.
    """
    spec.add_material(name=WALL_MATERIAL, specular=0.1, shininess=0.1)
    for name, angle in _WALLS.items():
        spec.worldbody.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=(_HALF_ROOM * math.cos(angle), _HALF_ROOM * math.sin(angle), floor + _HEIGHT / 2),
            quat=(math.cos(angle / 2), 0, 0, math.sin(angle / 2)),
            size=(_HALF_THICKNESS, _HALF_ROOM, _HEIGHT / 2),
            material=WALL_MATERIAL,
            group=group,
            contype=0,
            conaffinity=0,
            castshadow=False,
        )
