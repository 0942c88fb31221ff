from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..loft import Surface, loft, loft_closed, rounded_rectangle, translate_surface, tube
from ..se3 import Array
from .generated_shape import GeneratedShape, PrimitiveData, ShapeGrasp, ShapePiece, box_data, capsules_along

_RIM_DEPTH = 0.008  # m, of the finger pads' middle below a grasped rim
_MAX_DEPTH = 0.040  # m below the top; deeper, the palm would touch the top
_MAX_GRASP_WIDTH = 0.091  # m, object width between the pads


@dataclass(frozen=True)
class ContainerSizes:
    """Sizes of an open box, m.

    Attributes:
        size: outer size (x, y, z) at the rim, including the lip.
        wall: thickness of walls and floor.
        corner: outer radius of the vertical edges.
        taper: reduction of the half-width from the rim to the foot.
        cells: compartments along x.
        lip: overhang of the rim.
    """

    size: tuple[float, float, float]
    wall: float
    corner: float
    taper: float = 0.0
    cells: int = 1
    lip: float = 0.0


def make_container(size: ContainerSizes) -> GeneratedShape:
    """Return an open box or a tray with compartments."""
    x, y, height = size.size[0] / 2 - size.lip, size.size[1] / 2 - size.lip, size.size[2]
    wall, corner = size.wall, size.corner
    pieces = [ShapePiece("body", _open_box(size, x, y))]
    collision: list[PrimitiveData] = [
        box_data((0, 0, wall / 2), (2 * x - 2 * corner / 3, 2 * y - 2 * corner / 3, wall))
    ]
    collision += wall_boxes((x - size.taper / 2, y - size.taper / 2), (0.0, height), wall, corner)
    inner = 2 * x - wall
    for k in range(1, size.cells):
        at = -x + wall / 2 + k * inner / size.cells
        between = block_surface((wall, 2 * y - wall, height - wall), 0.0, wall / 4)
        pieces.append(ShapePiece("body", translate_surface(between, (at, 0, wall * 0.5))))
        collision.append(box_data((at, 0, height / 2 - wall * 0.25), (wall, 2 * y - wall, height - wall * 0.5)))
    if size.lip:
        collision += _lip_boxes(size, x, y)
    z = round(height - _RIM_DEPTH, 4)
    thick, flat = round(wall + size.lip, 4), not size.lip
    # Half-sizes to the middle of the collision walls.
    x, y = (round(half - size.taper / 2 - wall / 2, 4) for half in (x, y))
    grasps = [
        ShapeGrasp("rim", (0.0, y, z), 90.0, thick, flat, tilt_deg=0.0),
        ShapeGrasp("rim", (0.0, -y, z), 90.0, thick, flat, tilt_deg=0.0),
        ShapeGrasp("rim", (x, 0.0, z), 0.0, thick, flat, tilt_deg=0.0),
        ShapeGrasp("rim", (-x, 0.0, z), 0.0, thick, flat, tilt_deg=0.0),
    ]
    if size.cells % 2 == 0:
        grasps = grasps[2:]
    return GeneratedShape(tuple(pieces), tuple(collision), tuple(grasps), "in", wall)


def _open_box(size: ContainerSizes, x: float, y: float) -> Surface:
    height, wall, corner, lip = size.size[2], size.wall, size.corner, size.lip
    edge = min(corner * 0.35, 0.006)
    loops = []
    for angle in np.linspace(0, np.pi / 2, 4):
        inset = edge * (1 - math.sin(angle)) + size.taper
        loops.append(
            rounded_rectangle(x - inset, y - inset, corner - edge * (1 - math.sin(angle)), edge * (1 - math.cos(angle)))
        )
    loops.append(rounded_rectangle(x, y, corner, height - wall / 2 - (wall if lip else 0)))
    if lip:
        loops.append(rounded_rectangle(x + lip * 0.8, y + lip * 0.8, corner + lip, height - wall))
        loops.append(rounded_rectangle(x + lip, y + lip, corner + lip, height - wall / 2))
    for angle in np.linspace(0, np.pi, 5)[1:-1]:
        inset = wall / 2 * (1 - math.cos(angle)) - (lip if lip and angle < 1 else 0) * 0.9
        loops.append(
            rounded_rectangle(
                x - inset, y - inset, corner - min(inset, corner / 2), height - wall / 2 * (1 - math.sin(angle))
            )
        )
    inner = corner - min(wall, corner / 2)
    loops.append(rounded_rectangle(x - wall, y - wall, inner, height - wall / 2))
    for angle in np.linspace(0, np.pi / 2, 4):
        inset = wall + size.taper + edge * (1 - math.cos(angle))
        loops.append(rounded_rectangle(x - inset, y - inset, inner, wall + edge * (1 - math.sin(angle))))
    return loft(loops)


def wall_boxes(
    half: tuple[float, float], heights: tuple[float, float], wall: float, corner: float
) -> list[PrimitiveData]:
    """Return boxes for walls of outer half-sizes `half`, with a diagonal box in each round corner; all lengths in m."""
    x, y = half
    low, high = heights
    middle, tall = (low + high) / 2, high - low
    cut = corner * (1 - math.tan(math.pi / 8)) if corner > wall else 0.0
    parts = []
    for sign in (-1, 1):
        parts.append(box_data((sign * (x - wall / 2), 0, middle), (wall, 2 * (y - cut), tall)))
        parts.append(box_data((0, sign * (y - wall / 2), middle), (2 * (x - cut), wall, tall)))
    if cut:
        # The outer face of the diagonal box touches the round corner in its middle.
        out = corner - wall / 2
        long = 2 * corner * math.tan(math.pi / 8)
        for k, (sx, sy) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
            at = (sx * (x - corner + out / math.sqrt(2)), sy * (y - corner + out / math.sqrt(2)), middle)
            parts.append(box_data(at, (wall, long, tall), 45.0 + 90.0 * k))
    return parts


def _lip_boxes(size: ContainerSizes, x: float, y: float) -> list[PrimitiveData]:
    z, lip, wall = size.size[2] - size.wall / 2, size.lip, size.wall
    return [
        part
        for sign in (-1, 1)
        for part in (
            box_data((sign * (x + lip / 2), 0, z), (lip, 2 * y, wall)),
            box_data((0, sign * (y + lip / 2), z), (2 * x, lip, wall)),
        )
    ]


def make_lid(
    size: tuple[float, float, float], corner: float, plate: float, plug: float, knob: tuple[float, float]
) -> GeneratedShape:
    """Return a lid: a plate, a rim below the plate that fits into a container, and a bar on top as a handle.

    Args:
        size: of the plate along x and y, and total height, m.
        corner: radius of the plate's corners, m.
        plate: thickness of the plate, m.
        plug: distance of the rim from the plate's edge, m.
        knob: length and width of the bar, m.
    """
    x, y, height = size[0] / 2, size[1] / 2, size[2]
    deep = height * 0.33
    over = block_surface((2 * x, 2 * y, plate), corner, plate * 0.4)
    thick = 0.0025
    inside = max(corner - plug, thick)
    a, b = x - plug, y - plug
    rim = loft_closed(
        [
            rounded_rectangle(a - thick, b - thick, inside - thick, deep + plate / 2),
            rounded_rectangle(a - thick, b - thick, inside - thick, 0.0),
            rounded_rectangle(a, b, inside, 0.0),
            rounded_rectangle(a, b, inside, deep + plate / 2),
        ]
    )
    length, width = knob
    z0, z1 = deep + plate, height
    bar = block_surface((width, length, z1 - z0 + plate / 2), width / 2.2, 0.002)
    pieces = (
        ShapePiece("body", translate_surface(over, (0, 0, deep))),
        ShapePiece("body", rim),
        ShapePiece("handle", translate_surface(bar, (0, 0, z0 - plate / 2))),
    )
    collision = (
        box_data((0, 0, deep + plate / 2), (2 * x - 2 * corner / 3, 2 * y - 2 * corner / 3, plate)),
        *wall_boxes((a, b), (0.0, deep), thick, inside),
        box_data((0, 0, (z0 + z1) / 2), (width, length, z1 - z0)),
    )
    z = round((z0 + z1) / 2, 4)
    places = (0.0, length / 4, -length / 4)
    return GeneratedShape(
        pieces, collision, tuple(ShapeGrasp("handle", (0.0, round(at, 4), z), 0.0, width) for at in places)
    )


def block_surface(size: tuple[float, float, float], corner: float, edge: float) -> Surface:
    """Return a closed block on the ground with vertical edges of radius `corner` and others of radius `edge`, m."""
    x, y, height = size[0] / 2, size[1] / 2, size[2]
    edge = min(edge, height / 2.001, x, y)
    corner = max(corner, edge)
    angles = np.linspace(0, np.pi / 2, 4)
    loops = [_inset_rectangle(x, y, corner, edge * (1 - math.sin(a)), edge * (1 - math.cos(a))) for a in angles]
    loops += [
        _inset_rectangle(x, y, corner, edge * (1 - math.cos(a)), height - edge * (1 - math.sin(a))) for a in angles
    ]
    return loft(loops)


def _inset_rectangle(x: float, y: float, corner: float, by: float, z: float) -> Array:
    return rounded_rectangle(x - by, y - by, corner - by, z)


def make_block(
    size: tuple[float, float, float], corner: float, edge: float, band: tuple[float, float] | None
) -> GeneratedShape:
    """Return a closed block, such as a carton, a tin or a piece of wood.

    Args:
        size: (x, y, z), m.
        corner, edge: radius of the vertical and of the horizontal edges, m.
        band: lower and upper end of a printed band, as shares of the height.
    """
    pieces = [ShapePiece("body", block_surface(size, corner, edge))]
    if band:
        low, high = (share * size[2] for share in band)
        # The print lies 0.2 mm outside the body to be visible.
        shell = loft([rounded_rectangle(size[0] / 2 + 2e-4, size[1] / 2 + 2e-4, corner, z) for z in (low, high)])
        pieces.append(ShapePiece("print", shell))
    collision = [box_data((0, 0, size[2] / 2), size)]
    height = max(size[2] / 2, size[2] - _MAX_DEPTH)
    axes = sorted(((size[0], 0.0), (size[1], 90.0)))
    grasps = [
        ShapeGrasp("body", (0.0, 0.0, round(height, 4)), axis, width)
        for width, axis in axes
        if width <= _MAX_GRASP_WIDTH
    ]
    return GeneratedShape(tuple(pieces), tuple(collision), tuple(grasps), support_height=size[2])


def make_textile(size: tuple[float, float, float], folds: int) -> GeneratedShape:
    """Return a rigid folded cloth of `size` (x, y, z), m, with visible layers."""
    layer = size[2] / folds
    pieces = []
    rng = np.random.default_rng(0)
    for k in range(folds):
        shift = rng.uniform(-1, 1, 2) * 0.0012
        soft = block_surface((size[0] - 0.003, size[1] - 0.003, layer * 1.02), 0.004, layer * 0.48)
        pieces.append(ShapePiece("body", translate_surface(soft, (*shift, k * layer))))
    for side in (-1, 1):
        stripe = block_surface((size[0] * 0.985, size[1] * 0.03, layer * 0.06), 0.001, layer * 0.02)
        pieces.append(
            ShapePiece("print", translate_surface(stripe, (0, side * size[1] * 0.38, size[2] - layer * 0.02)))
        )
    return GeneratedShape(tuple(pieces), (box_data((0, 0, size[2] / 2), size),), (), support_height=size[2])


@dataclass(frozen=True)
class RackSizes:
    """Sizes of a dish rack, m.

    Attributes:
        size: outer size (x, y, z), including the bows at both ends.
        wire: diameter of the wires.
        slots: number of slots along x.
        slot: width of a slot.
        tine: height over the ground of the tines between slots.
    """

    size: tuple[float, float, float]
    wire: float
    slots: int
    slot: float
    tine: float


_RACK_FLOOR, _RACK_CORNER = 0.012, 0.03  # m, height of the floor's wires; radius of the corners
_RAIL_HEIGHT_RATIO = 0.7  # height of the rail as a share of the tines' height
_ROWS, _BETWEEN = 0.37, 0.12  # shares of the half depth, y of the tines and of the floor's inner wires
_BOW_CORNER_RADIUS = 0.03  # m, radius of the bows' corners


def make_rack(size: RackSizes) -> GeneratedShape:
    """Return a low wire rack: a floor with a rail, two rows of tines, and a bow at each end as a handle."""
    r = size.wire / 2
    x, y, height = size.size[0] / 2 - r, size.size[1] / 2 - r, size.size[2]
    pieces, collision = [], list[PrimitiveData]()

    def add_wire(path: Array) -> None:
        flat = abs(path[-1, 2] - path[0, 2]) < 0.5 * np.ptp(path[:, :2], axis=0).max()
        pieces.append(ShapePiece("body", tube(path, r, r, (0.31, 0.17, 0.93) if flat else (1, 0.1, 0), 8)))
        collision.extend(capsules_along(path, r))

    for z in (_RACK_FLOOR, _RAIL_HEIGHT_RATIO * size.tine):
        frame = rounded_rectangle(x, y, _RACK_CORNER, z, 5)
        add_wire(np.concatenate([frame, frame[:1]]))
    for sx in (-1, 1):
        add_wire(_end_handle_path(sx * x, y - _RACK_CORNER, r, height - r))
    rows = (-_ROWS * y, _ROWS * y)
    for k in range(size.slots + 1):
        at = (k - size.slots / 2) * size.slot
        add_wire(np.array([[at, -y, _RACK_FLOOR], [at, y, _RACK_FLOOR]]))
        for row in rows:
            add_wire(np.array([[at, row, _RACK_FLOOR], [at, row, size.tine - r]]))
    for along in (*rows, -_BETWEEN * y, _BETWEEN * y):
        add_wire(np.array([[-x, along, _RACK_FLOOR], [x, along, _RACK_FLOOR]]))
    z = round(height - r, 4)
    grasps = (
        ShapeGrasp("edge", (round(x, 4), 0.0, z), 0.0, size.wire),
        ShapeGrasp("edge", (round(-x, 4), 0.0, z), 0.0, size.wire),
    )
    return GeneratedShape(tuple(pieces), tuple(collision), grasps)


def _end_handle_path(x: float, half: float, foot: float, top: float) -> Array:
    turn = np.linspace(0, np.pi / 2, 4)
    across, up = (
        half - _BOW_CORNER_RADIUS + _BOW_CORNER_RADIUS * np.cos(turn),
        top - _BOW_CORNER_RADIUS + _BOW_CORNER_RADIUS * np.sin(turn),
    )
    side = np.concatenate([[[half, foot]], np.column_stack([across, up])])
    both = np.concatenate([side, side[::-1] * (-1.0, 1.0)])
    return np.column_stack([np.full(len(both), x), both])
