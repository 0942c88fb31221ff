"""Pasta in KitchenBench's scenes of pouring and scooping: its container, its pieces and their sizes.

A scene of pouring names the object that is full of pasta, and gives the mass. A scene of scooping names only a pile,
and the pile's object is then a dish with pasta in it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from kitchenbench.sim.blueprint import SceneBlueprint, SceneObject

from ..core.config.loader import load_config
from ..core.config.objects.object_config import ObjectConfig
from ..core.config.objects.primitives import Box, Capsule
from ..core.config.task_objects import Filling
from ..core.files.resources import Locations
from ..loose_pieces import piece_count
from .asset_configs import COMPARTMENT, object_config_of, shape_data, with_shape
from .goal_kinds import GoalKind

#: The condition of a scene that gives the length of its pasta.
STRAND_CONDITION = "strand_length_cm"
# Asset of a substance -> object config of one piece.
_PIECE_CONFIGS = {"dry_pasta": "kitchen_dry_pasta", "penne": "kitchen_penne", "rigatoni": "kitchen_rigatoni"}
_DIAMETER_DIGITS = 3  # decimals of a thicker piece's diameter in mm
# Largest number of pieces: a second of physics takes 4 to 5 s of a core with 60, and 3 to 4 s with 44. With 40, not
# every source holds its pasta.
_MAX_PIECES = 44
_CARTON_ASSET, _CARTON_WALL, _CARTON_MASS = "pasta_box", 1.5, 30.0  # asset of a carton; its wall, mm; its mass, g

# Friction of pieces and of all objects in a scene with pasta: an assumption without a measurement or a source. With the
# 0.8 of kitchen objects, a cup took up few pieces and they did not slide out of it, and pieces wedged in a carton.
_PASTA_FRICTION = 0.35
# object config whose material the dish has, and its mass, g: a tool pushes a lighter one away
_DISH_CONFIG, _DISH_GRAMS = "kitchen_container", 700.0
_DISH_WALL, _DISH_CORNER = 6.0, 10.0  # mm


@dataclass(frozen=True)
class _Pile:
    """A pile to scoop from, and its dish; the benchmark gives neither. The largest target is 160 g.

    At the start, the pieces lie at one end of the dish. With more pieces, the other end is not free for the tool.

    Attributes:
        grams, pieces, length_mm: total mass, number of pieces, and length of a piece.
        dish_mm: width, length and height of the dish, mm.
        far_mm: height of the wall at the end where the pieces lie, mm.
        bed_mm: length from that wall in which the pieces lie at the start, mm; None for no limit.
        edge_mm: radius of round bars along the floor's long edges, mm. They keep pieces out of the edges, which the
            round rim of a cup does not reach.
    """

    grams: float
    pieces: int
    length_mm: float
    dish_mm: tuple[float, float, float]
    far_mm: float
    bed_mm: float | None = None
    edge_mm: float = 0.0


# Chosen by trials with root seed 0. A cup takes most of the pieces of a dish that is little wider than the cup. The
# fingers pass over its long walls. A cup would push pieces over a far wall of 34 mm.
_SPOON_PILE = _Pile(240.0, 36, 40.0, dish_mm=(156.0, 230.0, 36.0), far_mm=36.0)
_CUP_PILE = _Pile(280.0, 44, 34.0, dish_mm=(110.0, 250.0, 34.0), far_mm=56.0, bed_mm=125.0, edge_mm=14.0)
_WOOD = {"stuff": "wood", "rgba": [0.62, 0.42, 0.25, 1], "specular": 0.15, "shininess": 0.2}  # of a spoon's handle
# Asset of a tool -> its sizes for scooping. The fingers press on a round handle of 20 mm with 15 N, and on a flat one
# of 12 x 4 mm with 11 N. The round one does not roll. A cup empties at a smaller tilt if it widens more towards its
# mouth.
_TOOL_SIZES: dict[str, dict[str, Any]] = {
    "spoon": {"grip_mm": 20, "handle_mm": 20},
    "measuring_cup": {"diameter_mm": 84, "foot_mm": 58},
}
_CUP_ASSET = "measuring_cup"


def is_pile(item: SceneObject) -> bool:
    """Whether a blueprint's object is a pile of pasta, which lies in a dish."""
    return item.asset in _PIECE_CONFIGS and item.parent is None


def is_body(item: SceneObject) -> bool:
    """Whether a blueprint's object is a separate body: not a compartment of a tray or a substance in another body."""
    return item.asset != COMPARTMENT and (item.asset not in _PIECE_CONFIGS or is_pile(item))


def _pile_for(blueprint: SceneBlueprint) -> _Pile:
    """Return the pile for a scene's tool."""
    return _CUP_PILE if any(item.asset == _CUP_ASSET for item in blueprint.objects) else _SPOON_PILE


def pasta_config_of(item: SceneObject, blueprint: SceneBlueprint, locations: Locations) -> ObjectConfig:
    """Return the config of an object in a scene with pasta.

    A carton of pasta is empty and open at its top. A pile's object is its dish. Raise LookupError if yamsim has none
    for the asset.
    """
    if is_pile(item):
        base = load_config(ObjectConfig, "objects", _DISH_CONFIG, locations).with_name(item.name)
        sizes = {
            "size_mm": _pile_for(blueprint).dish_mm,
            "wall_mm": _DISH_WALL,
            "corner_mm": _DISH_CORNER,
            "taper_mm": 0.0,
        }
        dish = _smooth(with_shape(base, {**shape_data(base), **sizes, "mass_g": _DISH_GRAMS}))
        return _with_far_wall_and_bars(dish, _pile_for(blueprint))
    base = object_config_of(item, blueprint.conditions, locations, nests=False)
    if blueprint.target_kind == GoalKind.SCOOP and item.asset in _TOOL_SIZES:
        data = {**shape_data(base), **_TOOL_SIZES[item.asset]}
        if item.asset != _CUP_ASSET:
            data["materials"] = {**data["materials"], "handle": _WOOD}
        return _smooth(with_shape(base, data))
    if item.asset != _CARTON_ASSET or blueprint.target_kind == GoalKind.SCOOP:
        return _smooth(base)
    data = shape_data(base)
    carton = {"family": "container", "size_mm": data["size_mm"], "wall_mm": _CARTON_WALL, "corner_mm": _CARTON_WALL}
    carton |= {"mass_g": _CARTON_MASS, "materials": {"body": data["materials"]["body"]}}
    return _smooth(with_shape(base, carton))


def _with_far_wall_and_bars(dish: ObjectConfig, pile: _Pile) -> ObjectConfig:
    """Return a dish with a higher wall at the end where its pieces lie, and with bars along its long edges.

    Its mass and inertia are those of the dish without them.
    """
    width, length, height = (size / 1000 for size in pile.dish_mm)
    wall, far, radius = _DISH_WALL / 1000, pile.far_mm / 1000, pile.edge_mm / 1000
    parts: list[Box | Capsule] = []
    if far > height:
        half_size = (width / 2, wall / 2, (far - height) / 2)
        parts.append(Box(type="box", centre=(0.0, (wall - length) / 2, (height + far) / 2), half_size=half_size))
    if radius:
        x, y = width / 2 - wall, length / 2 - wall
        parts += [Capsule(type="capsule", start=(at, -y, wall), end=(at, y, wall), radius=radius) for at in (-x, x)]
    return dish.model_copy(update={"collision": (*dish.collision, *parts), "look": (*dish.look, *parts)})


def fillings_of(blueprint: SceneBlueprint, locations: Locations) -> dict[str, Filling]:
    """Return object -> its filling, for a blueprint's substances. `strand_length_cm` is the length of a piece."""
    found = {}
    for item in blueprint.objects:
        if item.asset not in _PIECE_CONFIGS:
            continue
        pile = _pile_for(blueprint) if is_pile(item) else None
        grams, most = (item.amount_g, _MAX_PIECES) if pile is None else (pile.grams, pile.pieces)
        if grams is None:
            continue
        piece = _solid_piece(item.asset, locations)
        if pile is not None or STRAND_CONDITION in blueprint.conditions:
            length = pile.length_mm if pile else 10.0 * float(blueprint.conditions[STRAND_CONDITION])
            piece = with_shape(piece, {**shape_data(piece), "length_mm": length})
        piece = _thick_enough(piece, grams, most, pile is not None)
        bed = None if pile is None else pile.bed_mm
        found[item.parent or item.name] = Filling(of=_smooth(piece), grams=grams, max_pieces=most, length_mm=bed)
    return found


def _smooth(item: ObjectConfig) -> ObjectConfig:
    """Return an object with the friction of pasta. MuJoCo takes the larger friction of two objects."""
    friction = (_PASTA_FRICTION, *item.contact.friction[1:])
    return item.model_copy(update={"contact": item.contact.model_copy(update={"friction": friction})})


def _solid_piece(asset: str, locations: Locations) -> ObjectConfig:
    """Return the config of a piece: a rod with the length and the diameter of the asset, also for a tube."""
    piece = load_config(ObjectConfig, "objects", _PIECE_CONFIGS[asset], locations)
    data = shape_data(piece)
    if not data["wall_mm"]:
        return piece
    return with_shape(piece, {**data, "wall_mm": 0.0, "slant_deg": 0.0, "ridges": 0})


def _thick_enough(piece: ObjectConfig, grams: float, most: int, thinner: bool) -> ObjectConfig:
    """Return a piece so thick that `most` of them weigh `grams`, if more of the given ones would be needed.

    With `thinner`, a piece also becomes thinner, if fewer than `most` of the given ones would weigh `grams`.

    Pieces get thicker and not longer: longer ones would wedge themselves between the walls of a carton, which are 37 mm
    apart. One of 70 mm can lean by 26 degrees at most there.
    """
    factor = math.sqrt(grams / (most * piece.inertia.mass_g))
    if factor <= 1.0 and not thinner:
        return piece
    data = shape_data(piece)
    return with_shape(piece, {**data, "diameter_mm": round(factor * data["diameter_mm"], _DIAMETER_DIGITS)})


def describe_coarse_pieces(filled: str, filling: Filling, blueprint: SceneBlueprint, locations: Locations) -> str:
    """Return how the pieces in `filled` differ from the pieces of their asset, as a sentence, or ""."""
    item = next(one for one in blueprint.objects if one.asset in _PIECE_CONFIGS and filled in (one.parent, one.name))
    nominal = load_config(ObjectConfig, "objects", _PIECE_CONFIGS[item.asset], locations)
    data: dict[str, Any] = shape_data(nominal)
    thick, count = shape_data(filling.of)["diameter_mm"], piece_count(filling)[0]
    text = f"{filling.of.name}: {filling.grams:.0f} g are {count}"
    if data["wall_mm"]:
        tube = f"tubes {data['diameter_mm']:.1f} mm thick of {nominal.inertia.mass_g:.1f} g"
        return f"{text} solid pieces {thick:.1f} mm thick of {filling.grams / count:.1f} g instead of {tube}"
    if thick <= data["diameter_mm"]:
        return ""
    return f"{text} pieces {thick:.1f} mm thick instead of {data['diameter_mm']:.1f} mm"


def describe_pile(item: SceneObject, blueprint: SceneBlueprint) -> str:
    """Return what yamsim chooses for a pile that a blueprint does not define, as a sentence."""
    depth = "" if item.size_cm is None else f"; its depth of {item.size_cm:g} cm is not simulated"
    pile = _pile_for(blueprint)
    size = " x ".join(f"{side:.0f}" for side in pile.dish_mm) + " mm"
    return f"{item.name}: {pile.grams:.0f} g in pieces of {pile.length_mm:.0f} mm, in a dish of {size}{depth}"


def describe_tool(item: SceneObject, blueprint: SceneBlueprint, locations: Locations) -> str:
    """Return the sizes in which a tool to scoop with differs from the same object in other scenes, or ""."""
    if blueprint.target_kind != GoalKind.SCOOP or item.asset not in _TOOL_SIZES:
        return ""
    usual = shape_data(object_config_of(item, blueprint.conditions, locations, nests=False))
    sizes = _TOOL_SIZES[item.asset].items()
    return f"{item.name}: {', '.join(f'{key}={size:g} instead of {usual[key]:g}' for key, size in sizes)}"
