"""How stiff a fin-ray finger is, by beam theory: springs at its stations, and what couples them.

The derivation is in docs/finray.md. In short: the finger is cut at the base and at each rib into stiff segments, which
turn against each other by angles theta (n,). Both walls bend by the same angle. Because the back wall lies at a
distance h from the front one, each angle also moves it along by h theta; what has gathered up to a rib is the slip
there. A rib clamped to both walls resists the slip as a short beam, and the walls themselves resist it by their
stretch, since at the tip they are one.
"""

from __future__ import annotations

import numpy as np

from ...geometry.se3 import Array
from .parameters import FinRay

# What a solid tip is stiffer than a rib; the walls' stretch alone gives way there.
_SOLID = 1e3


def hinge_stiffness(finger: FinRay) -> Array:
    """Stiffness (n,) in N m/rad of the hinge at each station: both walls', over a bay; at the base, over half."""
    inertia = finger.width * finger.wall**3 / 12
    stiffness = np.full(finger.segments, finger.modulus * 2 * inertia / finger.bay)
    stiffness[0] *= 2
    return stiffness


def slip_arms(finger: FinRay) -> Array:
    """By how much (n, n) a radian at each station (columns) slips the back wall at each rib, and last at the tip, m."""
    spacing = finger.spacing(finger.stations)
    # A rib stands at its own station: half of the bend there is before it.
    through = np.tril(np.broadcast_to(spacing, (finger.segments, finger.segments)))
    ribs = through[1:] - np.diag(spacing)[1:] / 2
    return np.vstack([ribs, spacing])


def slip_stiffness(finger: FinRay) -> Array:
    """Stiffness (n, n) in N/m against slips at the ribs, and last at the tip."""
    n = finger.segments
    inertia = finger.width * finger.rib**3 / 12
    ribs = 12 * finger.modulus * inertia / finger.spacing(finger.stations[1:]) ** 3
    leaning = np.hypot(finger.bay, (finger.spacing(0.0) - finger.spacing(finger.length)) / n)
    stretch = finger.modulus * finger.width * finger.wall / (finger.bay + leaning)
    held = np.diag(np.append(ribs, _SOLID * stretch))
    # What reaches a rib is its slip, less what the bays below it stretch; the stretch is as it costs least.
    before = np.tril(np.ones((n, n)))
    give = stretch * np.eye(n) + before.T @ held @ before
    stiffness: Array = held - held @ before @ np.linalg.solve(give, before.T @ held)
    return (stiffness + stiffness.T) / 2


def couplings(finger: FinRay) -> Array:
    """Lengths (n, n) in m: springs of 1 N/m on these sums of the angles are what the slips are held by.

    Each row is a spring, and each column a station's angle.
    """
    rows = np.linalg.cholesky(slip_stiffness(finger)).T @ slip_arms(finger)
    # What is left of zero differs from one library of linear algebra to another.
    return np.where(np.abs(rows) < 1e-9 * np.abs(rows).max(), 0.0, rows)


def stiffness(finger: FinRay) -> Array:
    """Stiffness (n, n) in N m/rad of the angles at the stations, all in all."""
    arms = slip_arms(finger)
    whole: Array = np.diag(hinge_stiffness(finger)) + arms.T @ slip_stiffness(finger) @ arms
    return whole


def bent(finger: FinRay, height: float, force: float) -> Array:
    """Angles (n,) in rad at which a small force (N) holds the finger, pushing the front wall in at a height (m)."""
    push: Array = -force * np.maximum(height - finger.stations, 0.0)
    return np.asarray(np.linalg.solve(stiffness(finger), push), np.float64)


def compliance(finger: FinRay, height: float) -> float:
    """By how much the front wall gives way at a height (m) to a small force pushing there, m/N."""
    lever = np.maximum(height - finger.stations, 0.0)
    return float(-lever @ bent(finger, height, 1.0))
