"""Checks of what it weighs: mass, where it is, and how hard it is to turn."""

from __future__ import annotations

import numpy as np

from ..geometry.se3 import pose_from_quat
from ..geometry.solid import depth_in_hull, filling
from .looks import NO_LOOKS
from .outcome import Outcome, short
from .portraits import portrait, weighted
from .subject import Subject

# From foam and folded cloth to lead, kg/m3.
_DENSITIES = (15.0, 12_000.0)
# So far outside of its hull may a centre of mass be found, m: figures are rounded.
_ROUNDING = 5e-4
# What rounding may cost a triangle of moments.
_SLACK = 0.01
# The least of a principal moment, as a share of that of the mass spread evenly in the bounding box along the principal
# axes. The lowest of the YCB and kitchen objects is a banana with 0.37, a ball has 0.6, and a shell above 1.
_LEAST_OF_BOX = 0.1


def density(looked: Subject) -> Outcome:
    """Whether anything is so heavy for what there is of it."""
    mass = looked.item.inertia.mass
    if not looked.shown:
        return Outcome(None, {"mass_kg": short(mass)}, NO_LOOKS)
    volume = sum(abs(filling(*surface).volume) for surface in looked.looks)
    found = mass / volume
    figures = {"mass_kg": short(mass), "volume_cm3": short(volume * 1e6), "density_kg_m3": short(found)}
    fits = _DENSITIES[0] <= found <= _DENSITIES[1]
    low, high = _DENSITIES
    note = "" if fits else f"{found:,.{0 if found > 1 else 4}f} kg/m3; valid are {low:,g} to {high:,g}"
    return Outcome(fits, figures, note, (portrait(looked, "from the side", steep=0.1),))


def centre(looked: Subject) -> Outcome:
    """Whether its centre of mass lies within its hull."""
    points = looked.surface[0] if looked.shown else looked.touching
    middle = np.array(looked.item.inertia.centre)
    deep = float(depth_in_hull(middle[None], points)[0])
    note = "" if deep >= -_ROUNDING else f"{-deep * 1000:.4g} mm outside of it"
    return Outcome(deep >= -_ROUNDING, {"inside_mm": short(deep * 1000)}, note, (weighted(looked, block=False),))


def inertia(looked: Subject) -> Outcome:
    """Whether a body of this mass and size can have such principal moments of inertia, each about its own axis."""
    found = looked.item.inertia
    moments = np.array(found.diagonal)
    points = looked.surface[0] if looked.shown else looked.touching
    along = (points - np.array(found.centre)) @ pose_from_quat((0, 0, 0), found.quat)[:3, :3]
    squares, edges = along**2, np.ptp(along, axis=0) ** 2
    # No part of the mass is farther from an axis than the farthest point of the surface.
    most = found.mass * (squares.sum(axis=1, keepdims=True) - squares).max(axis=0)
    filled = found.mass / 12 * (edges.sum() - edges)
    a, b, c = sorted(found.diagonal)
    figures = {
        "least_kg_m2": short(a),
        "middle_kg_m2": short(b),
        "largest_kg_m2": short(c),
        "triangle": short((a + b) / c),
        "of_possible": short((moments / most).max()),
        "of_filled_box": short((moments / filled).min()),
    }
    views = (weighted(looked, block=True),)
    if a + b < c * (1 - _SLACK):
        return Outcome(False, figures, f"{a:.3g} and {b:.3g} together are less than {c:.3g} kg m2: no body has that")
    if (moments > most).any():
        axis = int((moments / most).argmax())
        note = f"{moments[axis]:.3g} kg m2 is more than its mass at its farthest point has, {most[axis]:.3g}"
        return Outcome(False, figures, note, views)
    if (moments < _LEAST_OF_BOX * filled).any():
        axis = int((moments / filled).argmin())
        note = (
            f"{moments[axis]:.3g} kg m2 is less than {_LEAST_OF_BOX:.0%} of what its mass has, spread evenly in its "
            f"bounding box, {filled[axis]:.3g}"
        )
        return Outcome(False, figures, note, views)
    return Outcome(True, figures, views=views)
