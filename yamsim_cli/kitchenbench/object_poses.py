"""Poses of a KitchenBench scene's objects in `world`, displaced where the required pose is not feasible."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from kitchenbench.sim.blueprint import SceneBlueprint, SceneObject

from ..core.episode.simulator import Simulator
from ..core.geometry.se3 import Array, invert_pose, pose, rotation_z
from ..core.scene.start_sampling import footprint_corners, footprint_distance
from ..core.sim.sim_world import make_sim_world
from .goal_kinds import GoalKind
from .lids import LID, SNAP_ASSET
from .pasta import is_body, is_pile

#: Position of the blueprints' origin in `world`: ahead and to the left of the midpoint between the arms' bases, m.
#: Scenes extend from there to the right, so this centres most objects before the arms.
AHEAD, BESIDE = 0.35, 0.25
#: Position of that origin, m, for scenes with cloth, which lies around the origin and needs both arms.
CLOTH_AHEAD, CLOTH_BESIDE = 0.45, 0.0

#: Position of that origin, m, for containers with lids, which stand around it and need both arms.
LID_AHEAD, LID_BESIDE = 0.38, 0.0

#: Position of that origin, m, for screw lids: the left hand points down onto a lid, and the right hand comes from the
#: side. In the middle between the arms, their wrist cameras would touch.
SCREW_AHEAD, SCREW_BESIDE = 0.34, 0.20
#: Position of that origin, m, for snap lids: both hands point down, onto the lid and onto an ear of the container.
SNAP_AHEAD, SNAP_BESIDE = 0.30, 0.0

#: Position of that origin, m, for pouring: a carton higher than the parked hands stands between them, and an arm
#: can tilt it by 135 degrees or more over the vessel. At x = 0.45 m, this would be 120 degrees.
POUR_AHEAD, POUR_BESIDE = 0.33, -0.08

#: Position of that origin, m, for scooping: the left arm reaches the tool, the pile and the container. Where the
#: container's x is beyond `_FAR_CM`, the arm tilts a cup over it only if the origin is nearer to the arms.
SCOOP_AHEAD, FAR_SCOOP_AHEAD, SCOOP_BESIDE = 0.28, 0.22, 0.31
_FAR_CM = 19.0  # cm, from the origin: `far-container` begins at 20, and the other scenes end at 18

_STEP = 0.002  # m, of displacements
_RACK_GAP = 0.005  # m, between a rack and a displaced object
_BESIDE_GAP = 0.03  # m, between a container and its lid beside it, and between a vessel and what stands beside it
_WRIST_GAP = 0.06  # m, between a dish and the container beside it: the wrist's camera passes there
_WALL_THICKNESS = 0.005  # m, thickness of a tray's walls
_FINGER_CLEARANCES = (0.010, 0.003)  # m, between a wall and a displaced object, in the order tried
_MAX_OVERLAP_SHIFT = 0.02  # m, accepted displacement to avoid an overlap with another object


def origin_in_world(blueprint: SceneBlueprint) -> tuple[float, float]:
    """Return the position of a blueprint's origin in `world`, m."""
    if blueprint.target_kind == GoalKind.FOLD:
        return (CLOTH_AHEAD, CLOTH_BESIDE)
    if blueprint.target_kind == GoalKind.OPEN:
        snaps = any(item.asset == SNAP_ASSET for item in blueprint.objects)
        return (SNAP_AHEAD, SNAP_BESIDE) if snaps else (SCREW_AHEAD, SCREW_BESIDE)
    if blueprint.target_kind == GoalKind.POUR:
        return (POUR_AHEAD, POUR_BESIDE)
    if blueprint.target_kind == GoalKind.SCOOP:
        far = any(item.role == "container" and item.x_cm > _FAR_CM for item in blueprint.objects)
        return (FAR_SCOOP_AHEAD if far else SCOOP_AHEAD, SCOOP_BESIDE)
    return (LID_AHEAD, LID_BESIDE) if blueprint.target_kind == GoalKind.SEAL else (AHEAD, BESIDE)


def T_in_world(item: SceneObject, blueprint: SceneBlueprint) -> Array:
    """Return the required pose (4, 4) of an object in `world`, with z = 0 at the height of the table.

    A blueprint's frame has x to the right, y ahead and z up. Its origin is at `origin_in_world`.
    """
    # The dish of a pile extends to the left and right, and its pieces lie at its left end.
    yaw = math.radians(item.yaw_deg) - (math.pi / 2 if is_pile(item) else 0.0)
    T_item = pose((item.x_cm / 100, item.y_cm / 100, 0.0), rotation_z(yaw))
    if item.parent is None:
        return pose((*origin_in_world(blueprint), 0.0), rotation_z(-math.pi / 2)) @ T_item
    parent = next(other for other in blueprint.objects if other.name == item.parent)
    return T_in_world(parent, blueprint) @ T_item


def feasible_poses(simulator: Simulator, blueprint: SceneBlueprint) -> dict[str, Array]:
    """Return name -> pose (4, 4) of a blueprint's objects in `world`, as required where that is feasible.

    Objects in a rack's wire or on a tray's wall are placed beside it. Large objects come first: others may lie on them.
    """
    wanted = {item.name: T_in_world(item, blueprint) for item in blueprint.objects if is_body(item)}
    world = make_sim_world(simulator.scene, simulator.state_replay.data, ())
    boxes = {name: world.local_box(name) for name in wanted}
    area = {name: float(np.prod((box[1] - box[0])[:2])) for name, box in boxes.items()}
    places = {name: wanted[name].copy() for name in sorted(wanted, key=lambda name: -area[name])}
    for rack in blueprint.roles.get("rack", ()):
        for name in places:
            if name != rack:
                _put_beside(places, boxes, name, rack, _RACK_GAP)
    # A lid on its container would count as sealed, and a source must not stand in the vessel.
    if blueprint.target_kind == GoalKind.SEAL:
        _put_beside(places, boxes, blueprint.roles[LID][0], blueprint.roles["container"][0])
    if blueprint.target_kind == GoalKind.POUR:
        _put_beside(places, boxes, blueprint.roles["source"][0], blueprint.roles["vessel"][0])
    if blueprint.target_kind == GoalKind.SCOOP:
        for role, gap in (("tool", _BESIDE_GAP), ("container", _WRIST_GAP)):
            _put_beside(places, boxes, blueprint.roles[role][0], blueprint.roles["substance"][0], gap)
    for tray in blueprint.roles.get("tray", ()):
        middles = [item.x_cm / 100 for item in blueprint.objects if item.parent == tray]
        for name in places:
            free = [] if name == tray else _beside_walls(places[name], boxes[name], places[tray], boxes[tray], middles)
            if free:
                others = [
                    footprint_corners(boxes[other], places[other]) for other in places if other not in (name, tray)
                ]
                places[name] = min(free, key=partial(_displacement_cost, places[name], boxes[name], others))
                _displace_from_tray(name, places, wanted, boxes, tray)
    return places


def _put_beside(
    places: dict[str, Array], boxes: Mapping[str, Array], name: str, other: str, gap: float = _BESIDE_GAP
) -> None:
    """Displace an object along y until its footprint is `gap` or more from the footprint of `other`, m."""
    T = places[name]
    away = math.copysign(_STEP, T[1, 3] - places[other][1, 3])
    while _gap_between(places, boxes, name, other) < gap:
        T[1, 3] += away


def _gap_between(poses: Mapping[str, Array], boxes: Mapping[str, Array], name: str, other: str) -> float:
    """Return the distance between the footprints of two objects, m; negative if they overlap."""
    return footprint_distance(*(footprint_corners(boxes[one], poses[one]) for one in (name, other)))


def _displace_from_tray(
    name: str, places: dict[str, Array], wanted: Mapping[str, Array], boxes: Mapping[str, Array], tray: str
) -> None:
    """Displace objects beside a tray that would lie under another one, unless the blueprint requires that."""
    for other, T in places.items():
        if (
            other in (name, tray)
            or _gap_between(places, boxes, other, tray) < 0
            or _gap_between(wanted, boxes, other, name) < 0
        ):
            continue
        y = T[1, 3]
        _put_beside(places, boxes, other, name, _STEP)
        if T[1, 3] != y:
            _displace_from_tray(other, places, wanted, boxes, tray)


def _displacement_cost(T_required: Array, box: Array, others: Sequence[Array], T: Array) -> float:
    """Return the distance of a pose (4, 4) from the required one, m, plus `_MAX_OVERLAP_SHIFT` for each overlap."""
    overlaps = sum(footprint_distance(footprint_corners(box, T), other) < 0 for other in others)
    return float(np.linalg.norm(T[:2, 3] - T_required[:2, 3])) + _MAX_OVERLAP_SHIFT * overlaps


def _beside_walls(T: Array, box: Array, T_tray: Array, tray: Array, middles: Sequence[float]) -> list[Array]:
    """Return poses (4, 4) of an object in a tray's compartments or beside the tray, the nearest first.

    Args:
        T: required pose (4, 4). If the object overlaps no wall there, the result is empty.
        box, tray: corners (2, 3) of both bounding boxes, in their own frames, m.
        middles: of the tray's compartments, x in its frame, m.
    """
    T_in_tray = invert_pose(T_tray) @ T
    half = np.abs(T_in_tray[:2, :2]) @ ((box[1] - box[0])[:2] / 2)
    outer = (tray[1] - tray[0])[:2] / 2
    cell = np.array([outer[0] / len(middles), outer[1]]) - _WALL_THICKNESS
    place, cells = T_in_tray[:2, 3], [np.array((middle, 0.0)) for middle in middles]
    if (np.abs(place) >= outer + half).any() or any((np.abs(place - middle) <= cell - half).all() for middle in cells):
        return []
    free = []
    for fingers in _FINGER_CLEARANCES:
        room = np.maximum(cell - half - fingers, 0.0)
        free += [np.clip(place, middle - room, middle + room) for middle in cells]
        free += [np.array((side * (outer[0] + half[0] + fingers), place[1])) for side in (-1.0, 1.0)]
    found = []
    for there in sorted(free, key=lambda there: float(np.linalg.norm(there - place))):
        moved = T.copy()
        moved[:2, 3] += T_tray[:2, :2] @ (there - place)
        found.append(moved)
    return found
