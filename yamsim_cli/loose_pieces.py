"""Loose pieces in hollow objects, such as dry pasta in a cup: their configs, and their poses before they settle.

A piece is a free body whose collision geometry is one capsule or sphere. Pieces are no objects of a task: goals, skills
and frames do not name them, and collision checks of planned motions ignore them.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from .core.config.objects.object_config import ObjectConfig
from .core.config.objects.primitives import Capsule, Ring, Sphere
from .core.config.objects.shapes import ContainerShape
from .core.config.program_task import ProgramTask
from .core.config.task_objects import Filling
from .core.errors import UsageError
from .core.geometry.se3 import Array, quat_from_rotation, rotation_between

_FACTOR_DIGITS = 4  # decimals of the factor by which pieces are enlarged
_SPACING = 2.06  # radii, between the axes of neighbouring pieces in a layer
_LAYER_HEIGHT = 1.78  # radii, between layers that are offset by half a spacing: their axes are 2.06 radii apart
_GAP = 0.0003  # m, between pieces in a row, and between pieces and the floor
# Friction in the direction of sliding alone. Torsional and rolling friction of a kitchen object keep it from rolling
# off a table, and double the time of the solver.
_CONDIM = 3
# Time constant of the contacts (`solref`), s: two steps of 1/480 s, the longest step in use. MuJoCo is not stable below
# two steps. Kitchen objects have 6 ms.
_PUSH_OUT_S = 0.0042


def piece_name_prefix(filled: str) -> str:
    """Return the beginning of the names of an object's loose pieces."""
    return f"{filled}_piece_"


def loose_pieces(task: ProgramTask) -> dict[str, tuple[ObjectConfig, ...]]:
    """Return filled object -> the configs of its pieces, which are named `OBJECT_piece_1` and so on.

    Together, the pieces have exactly the mass that the filling asks for. Raises UsageError for a piece or a hollow
    object of an unsuitable shape.
    """
    return {
        item.name: _make_pieces(item.name, role.filled, task)
        for role in task.things.values()
        if role.filled is not None
        for item in role.of
    }


def stacked_poses(task: ProgramTask, name: str) -> Array:
    """Return the pose (n, 7), position and quaternion, of each piece in the frame of the filled object.

    Pieces lie in layers without contact. The physics of a start lets them settle. Raises UsageError if the object does
    not hold all of them.
    """
    vessel = next(item for item in task.objects if item.name == name)
    pieces = loose_pieces(task)[name]
    start, end, radius = _axis_of(pieces[0], task)
    length = float(np.linalg.norm(end - start)) + 2 * radius
    room = _room_in(vessel, task)
    length_mm = next(role.filled for role in task.things.values() if vessel in role.of and role.filled).length_mm
    middle = np.zeros(3)
    if length_mm is not None:
        if room.is_round:
            raise UsageError(
                f"task {task.name!r}: the {name} is round, so `length_mm` does not apply to its filling; remove it"
            )
        half = min(length_mm / 2000, float(room.half_widths[:, 1].min()))
        middle[1] = half - room.half_widths[:, 1].min()
        room.half_widths[:, 1] = half
    # First with rows in the middle, as in earlier recordings. Only if these do not hold all pieces, beside the middle.
    held: list[Array] = []
    for shifted in (False, True):
        layouts = [
            list(itertools.islice(_places(room, axis, length, radius, shifted), len(pieces))) for axis in range(3)
        ]
        held = max((held, *layouts), key=len)
        if len(held) == len(pieces):
            break
    else:
        grams = 1000 * pieces[0].inertia.mass * len(held)
        raise UsageError(
            f"task {task.name!r}: the {name} holds about {grams:.0f} g of {len(pieces) * pieces[0].inertia.mass_g:.0f} "
            "g; give less in `filled.grams`, or fill a larger object"
        )
    axis = next(k for k, places in enumerate(layouts) if len(places) == len(pieces))
    direction = (end - start) / np.linalg.norm(end - start) if length > 2 * radius else np.eye(3)[axis]
    # A capsule looks the same from both ends, so an opposite direction needs no turn.
    target = np.eye(3)[axis] * (-1.0 if direction[axis] < 0 else 1.0)
    R = rotation_between(direction, target)
    quat = quat_from_rotation(R)
    return np.array([(*(place + middle - R @ (start + end) / 2), *quat) for place in layouts[axis]])


def piece_count(filling: Filling) -> tuple[int, float]:
    """Return the number of pieces of a filling, and the factor of their lengths if fewer and larger ones are needed."""
    wanted = max(1, round(filling.grams / filling.of.inertia.mass_g))
    count = min(wanted, filling.max_pieces)
    return count, round((wanted / count) ** (1 / 3), _FACTOR_DIGITS)


def _make_pieces(name: str, filling: Filling, task: ProgramTask) -> tuple[ObjectConfig, ...]:
    _axis_of(filling.of, task)
    count, factor = piece_count(filling)
    try:
        one = filling.of.scaled(factor)
    except ValueError as error:
        raise UsageError(f"task {task.name!r}: {error}; give more pieces in `filled.max_pieces`") from error
    share = filling.grams / count / one.inertia.mass_g
    moments: Any = tuple(share * moment for moment in one.inertia.diagonal)
    inertia = one.inertia.model_copy(update={"mass_g": filling.grams / count, "diagonal": moments})
    contact = one.contact.model_copy(update={"condim": _CONDIM, "push_out_s": _PUSH_OUT_S})
    # Without `shape`, the primitive is visible, and scenes need no mesh for each piece.
    made = one.model_copy(update={"shape": None, "inertia": inertia, "contact": contact, "meshes": ()})
    return tuple(made.with_name(f"{piece_name_prefix(name)}{k + 1}") for k in range(count))


def _axis_of(piece: ObjectConfig, task: ProgramTask) -> tuple[Array, Array, float]:
    """Return the ends (3,) of a piece's axis in its frame, and its radius, m."""
    match piece.collision:
        case (Capsule() as part,):
            return np.array(part.start), np.array(part.end), part.radius
        case (Sphere() as part,):
            return np.array(part.centre), np.array(part.centre), part.radius
    raise UsageError(
        f"task {task.name!r}: the {piece.name} cannot be a piece in `filled`; give an object with one capsule or one "
        "sphere as its collision geometry, such as kitchen_dry_pasta"
    )


@dataclass(frozen=True)
class _Room:
    """The space in a hollow object, m.

    Attributes:
        heights: (n,) of the wall's points, increasing, the floor's first and the rim's last.
        half_widths: (n, 2) along x and y at these heights; both are the radius of a round object.
        is_round: whether the horizontal section is a circle.
    """

    heights: Array
    half_widths: Array
    is_round: bool

    def half_width(self, low: float, high: float, k: int) -> float:
        """Return the smallest half width along axis `k` between two heights."""
        at = np.concatenate([[low, high], self.heights[(self.heights > low) & (self.heights < high)]])
        return float(np.interp(at, self.heights, self.half_widths[:, k]).min())


def _room_in(vessel: ObjectConfig, task: ProgramTask) -> _Room:
    rings = [part for part in vessel.collision if isinstance(part, Ring)]
    if isinstance(vessel.shape, ContainerShape) and vessel.shape.cells == 1:
        wall, taper = vessel.shape.wall_mm / 1000, vessel.shape.taper_mm / 1000
        x, y, height = (side / 1000 for side in vessel.shape.size_mm)
        inside = np.array([x, y]) / 2 - wall - vessel.shape.lip_mm / 1000
        # Capsules of a container are bars along the long edges of its floor: see `kitchenbench.pasta`.
        bars = max((part.radius for part in vessel.collision if isinstance(part, Capsule)), default=0.0)
        return _Room(np.array([wall, height]), np.array([inside - taper - (bars, 0.0), inside]), False)
    if not rings or vessel.preposition != "in":
        raise UsageError(
            f"task {task.name!r}: the {vessel.name} cannot be `filled`; fill an object whose `shape` is a deep vessel "
            "or a container without compartments"
        )
    # (n, 2) radius and height of the inner surface; a ring's boxes lie outside of it.
    wall_points = np.array(sorted({point for ring in rings for point in (ring.inner, ring.outer)}, key=lambda p: p[1]))
    return _Room(wall_points[:, 1], np.repeat(wall_points[:, :1], 2, axis=1), True)


def _places(room: _Room, axis: int, length: float, radius: float, shifted: bool) -> Iterator[Array]:
    """Yield the middles (3,) of pieces parallel to `axis`, layer by layer, as long as the middles are below the rim.

    Args:
        length, radius: of a piece with its round ends, m.
        shifted: whether the first layer's rows, instead of the second's, are half a spacing beside the middle; of
            vertical pieces, the rows of every layer.
    """
    tall, step = (length, length + _GAP) if axis == 2 else (2 * radius, _LAYER_HEIGHT * radius)
    low = float(room.heights[0]) + _GAP
    for layer in itertools.count():
        middle = low + tall / 2
        if middle > room.heights[-1]:
            return
        x, y = (room.half_width(low, low + tall, k) - _GAP for k in (0, 1))
        along, across = (x, y) if axis != 1 else (y, x)
        cell = _SPACING * radius if axis == 2 else length + _GAP
        step_across = _SPACING * radius
        # Vertical pieces stand on the layer below, so their rows are not offset.
        offset = step_across / 2 if (axis != 2 and layer % 2) != shifted else 0.0
        reach = int((across - radius) / step_across + 1.5) if across > radius else 0
        for side in np.arange(-reach, reach + 1) * step_across + offset:
            if abs(side) > across - radius:
                continue
            half = math.sqrt(max(along**2 - (abs(side) + radius) ** 2, 0.0)) if room.is_round else along
            for place in _centred_grid(half - (radius if axis == 2 else length / 2), cell):
                yield np.array((place, side, middle) if axis != 1 else (side, place, middle))
        low += step


def _centred_grid(half: float, step: float) -> Array:
    """Return evenly spaced numbers around 0 that are -half to half at most; none if `half` is negative."""
    count = int(2 * half / step + 1e-9) + 1 if half >= 0 else 0
    numbers: Array = (np.arange(count, dtype=np.float64) - (count - 1) / 2) * step
    return numbers
