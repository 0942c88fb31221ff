"""Where a scene of the benchmark asks for its things in our world, and where those go that cannot be there."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from kitchenbench.sim.blueprint import SceneBlueprint, SceneObject

from ..core.attempt.simulator import Simulator
from ..core.geometry.se3 import Array, inverse, pose, rotation_z
from ..core.sim.world import world_of
from ..core.tasks.casting import gap, outline
from .catalog import COMPARTMENT
from .linen import FOLD

#: The bench's origin lies so far ahead of the middle between the arms' bases, and so far to its left, m. Its scenes
#: begin there, and go on to the right: so both arms' bases are where most of the things are, each on its side of x = 0.
AHEAD, BESIDE = 0.35, 0.25
#: Of scenes with cloth, which lies around the origin and takes both arms, in the middle between them.
CLOTH_AHEAD, CLOTH_BESIDE = 0.45, 0.0

# What gives way to something does so in such steps, to a rack until it is so far beside it, m.
_STEP, _BESIDE = 0.002, 0.005
# The walls of a tray; and so much room beside them, for fingers, has what would lie on one, if there is as much; m.
_WALL, _FINGERS = 0.005, (0.010, 0.003)
# So much farther it may lie from where it was asked for, if it lies on nothing else there, m.
_ALONE = 0.02


def origin(blueprint: SceneBlueprint) -> tuple[float, float]:
    """Where the origin of a scene's bench lies in `world`, m."""
    return (CLOTH_AHEAD, CLOTH_BESIDE) if blueprint.target_kind == FOLD else (AHEAD, BESIDE)


def T_in_world(item: SceneObject, blueprint: SceneBlueprint) -> Array:
    """Where a blueprint asks for an object: pose (4, 4) in `world`, at the height of the bench's frame.

    The bench's frame has x to the right, y ahead and z up; it lies on the table, `AHEAD` of the arms' bases and
    `BESIDE` the middle between them, or where cloth is to be folded in the middle.
    """
    T_item = pose((item.x_cm / 100, item.y_cm / 100, 0.0), rotation_z(math.radians(item.yaw_deg)))
    if item.parent is None:
        return pose((*origin(blueprint), 0.0), rotation_z(-math.pi / 2)) @ T_item
    parent = next(other for other in blueprint.objects if other.name == item.parent)
    return T_in_world(parent, blueprint) @ T_item


def free_places(simulator: Simulator, blueprint: SceneBlueprint) -> dict[str, Array]:
    """Where a blueprint asks for its things (4, 4), but of those that would stand in a rack's wire, or lie on a tray's
    wall: these are beside it. Large things come first, since others may lie on them.

    Args:
        simulator: of a scene with the same things.
    """
    wanted = {item.name: T_in_world(item, blueprint) for item in blueprint.objects if item.asset != COMPARTMENT}
    world = world_of(simulator.scene, simulator.replica.data, ())
    room = {name: world.block(name) for name in wanted}
    area = {name: float(np.prod((block[1] - block[0])[:2])) for name, block in room.items()}
    places = {name: wanted[name].copy() for name in sorted(wanted, key=lambda name: -area[name])}
    for rack in blueprint.roles.get("rack", ()):
        for name, T in places.items():
            if name == rack:
                continue
            away = math.copysign(_STEP, T[1, 3] - places[rack][1, 3])
            while gap(outline(room[name], T), outline(room[rack], places[rack])) < _BESIDE:
                T[1, 3] += away
    for tray in blueprint.roles.get("tray", ()):
        middles = [item.x_cm / 100 for item in blueprint.objects if item.parent == tray]
        for name in places:
            free = [] if name == tray else _beside_walls(places[name], room[name], places[tray], room[tray], middles)
            if free:
                others = [outline(room[other], places[other]) for other in places if other not in (name, tray)]
                places[name] = min(free, key=partial(_trouble, places[name], room[name], others))
                _make_room(name, places, wanted, room, tray)
    return places


def _make_room(
    name: str, places: dict[str, Array], wanted: Mapping[str, Array], room: Mapping[str, Array], tray: str
) -> None:
    """Move those beside a tray that would now lie under a thing, and were not asked to, until they lie beside it."""
    for other, T in places.items():
        if other in (name, tray) or gap(outline(room[other], T), outline(room[tray], places[tray])) < 0:
            continue
        if gap(outline(room[other], wanted[other]), outline(room[name], wanted[name])) < 0:
            continue
        before, away = T[1, 3], math.copysign(_STEP, T[1, 3] - places[name][1, 3])
        while gap(outline(room[other], T), outline(room[name], places[name])) < _STEP:
            T[1, 3] += away
        if T[1, 3] != before:
            _make_room(other, places, wanted, room, tray)


def _trouble(T_asked: Array, block: Array, others: Sequence[Array], T: Array) -> float:
    """How far a thing at (4, 4) is from where it was asked for, m, and more for each other thing that it lies on."""
    overlaps = sum(gap(outline(block, T), other) < 0 for other in others)
    return float(np.linalg.norm(T[:2, 3] - T_asked[:2, 3])) + _ALONE * overlaps


def _beside_walls(T: Array, block: Array, T_tray: Array, tray: Array, middles: Sequence[float]) -> list[Array]:
    """Where a thing (4, 4) can lie that would lie on a wall of a tray: in its cells, or beside it; the nearest first.

    Args:
        T: where it is asked for (4, 4). Where that is beside all walls, there is no need for others.
        block, tray: corners (2, 3) of the blocks around both, in their frames, m.
        middles: of the tray's cells, x in its frame, m.
    """
    T_in_tray = inverse(T_tray) @ T
    half = np.abs(T_in_tray[:2, :2]) @ ((block[1] - block[0])[:2] / 2)
    outer = (tray[1] - tray[0])[:2] / 2
    cell = np.array([outer[0] / len(middles), outer[1]]) - _WALL
    place, cells = T_in_tray[:2, 3], [np.array((middle, 0.0)) for middle in middles]
    if (np.abs(place) >= outer + half).any() or any((np.abs(place - middle) <= cell - half).all() for middle in cells):
        return []
    free = []
    for fingers in _FINGERS:
        room = np.maximum(cell - half - fingers, 0.0)
        free += [np.clip(place, middle - room, middle + room) for middle in cells]
        free += [np.array((side * (outer[0] + half[0] + fingers), place[1])) for side in (-1.0, 1.0)]
    found = []
    for there in sorted(free, key=lambda there: float(np.linalg.norm(there - place))):
        moved = T.copy()
        moved[:2, 3] += T_tray[:2, :2] @ (there - place)
        found.append(moved)
    return found
