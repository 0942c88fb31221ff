"""Whether what touches is what is seen."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..config.things.primitives import CollisionPart, HullPart, SdfPart
from ..geometry.deviation import sample_surface
from ..geometry.se3 import Array
from ..geometry.solid import depth_in_hull, filling, spread_points
from ..geometry.stl import read_stl
from ..scene.things.looks import set_file
from ..things.primitives import signed_distance
from .looks import NO_LOOKS
from .outcome import Outcome, short, unchecked
from .portraits import touching
from .subject import Subject

# Points with which volumes are counted, and points on the looks.
_POINTS, _SEEN = 30_000, 2000
# A solid stand-in for a hollow thing is as large as its hull; a shell's may be rather thicker than the shell, and a few
# wires may stand for a plate.
_OF_HULL, _OF_MESH = 1.25, 0.25
# So far may a twentieth of the looks stick out of what touches: this, or such a share of the whole, m.
_OUT, _OUT_SHARE = 0.006, 0.05
# Looks count so far under their hull, m.
_SKIN = 0.006


def collision(looked: Subject) -> Outcome:
    """Whether what touches is about as large as what is seen, and where it is."""
    if not looked.shown:
        return unchecked(NO_LOOKS)
    parts = looked.item.collision
    if any(isinstance(part, SdfPart) for part in parts):
        return unchecked("it collides by the distance to its own surface")
    surface = looked.surface
    points = np.concatenate([surface[0], looked.touching])
    low, high = points.min(axis=0), points.max(axis=0)
    filled = spread_points(low, high, _POINTS)
    block = float(np.prod(high - low))
    touches = _distance(looked, parts, filled) <= 0
    volume = block * float(touches.mean())
    hull = block * float((depth_in_hull(filled, surface[0]) > 0).mean())
    mesh = sum(filling(*each).volume for each in looked.looks)
    seen = sample_surface(surface, _SEEN, np.random.default_rng(0))[0]
    # What lies deep inside is out of reach, or hollow, which a ball looks into; and scans see badly in there.
    seen = seen[depth_in_hull(seen, surface[0]) < _SKIN]
    out = np.maximum(_distance(looked, parts, seen), 0)
    reach = float(np.linalg.norm(np.ptp(surface[0], axis=0)))
    most, allowed = float(np.percentile(out, 95)), max(_OUT, _OUT_SHARE * reach)
    figures = {
        "collision_cm3": short(volume * 1e6, 3),
        "mesh_cm3": short(mesh * 1e6, 3),
        "hull_cm3": short(hull * 1e6, 3),
        "of_hull": short(volume / hull, 3),
        "sticks_out_mm": short(most * 1000, 3),
    }
    views = (touching(looked),)
    if volume > _OF_HULL * hull:
        return Outcome(False, figures, f"what touches is {volume / hull:.2f} times its hull", views)
    if volume < _OF_MESH * mesh:
        return Outcome(False, figures, f"what touches is {volume / mesh:.2f} of what is seen", views)
    if most > allowed:
        return Outcome(False, figures, f"it sticks out of what touches by {most * 1000:.3g} mm", views)
    return Outcome(True, figures, views=views)


def kinds(parts: Sequence[CollisionPart]) -> str:
    """What it collides by: "primitives", "hulls", "distance" or several of them."""
    found = {_KINDS.get(part.type, "primitives") for part in parts}
    return " and ".join(sorted(found))


_KINDS = {"hull": "hulls", "sdf": "distance"}


def _distance(looked: Subject, parts: Sequence[CollisionPart], points: Array) -> Array:
    """How far points (n, 3) are from what touches, m; negative inside. Beside an edge of a hull it is too little."""
    nearest = np.full(len(points), np.inf)
    primitives = [part for part in parts if not isinstance(part, HullPart | SdfPart)]
    if primitives:
        nearest = signed_distance(primitives, points)
    folder = looked.meshes.get(looked.item.mesh.set)
    for part in parts:
        if isinstance(part, HullPart) and folder is not None:
            vertices, _ = read_stl(set_file(folder, part.file))
            nearest = np.minimum(nearest, -depth_in_hull(points, vertices))
    return nearest
