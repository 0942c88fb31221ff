"""Textures made of two colours: images (size, size, 3) of uint8."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..variation import SurfaceVariation

SIZE = 256
# How many layers noise has. Each is twice as fine as the one before.
_OCTAVES = 4


def pattern(surface: SurfaceVariation, size: int = SIZE) -> NDArray[np.uint8]:
    """The image of a surface's pattern. Unless it is a gradient, opposite edges match, so that it can be repeated."""
    first, second = np.array(surface.colours) * 255.0
    match surface.texture:
        case "checker":
            cell = np.arange(size) * 2 * surface.repeat // size
            share = ((cell[:, None] + cell[None, :]) % 2).astype(float)
        case "gradient":
            turn = 2 * np.pi * np.random.default_rng(surface.seed).uniform()
            along = np.linspace(-0.5, 0.5, size)
            share = 0.5 + (along[:, None] * np.sin(turn) + along[None, :] * np.cos(turn)) / np.sqrt(2)
        case "noise":
            share = _noise(np.random.default_rng(surface.seed), surface.repeat, size)
        case _:
            share = np.zeros((size, size))
    image: NDArray[np.uint8] = np.rint(first + share[..., None] * (second - first)).astype(np.uint8)
    return image


def _noise(rng: np.random.Generator, cells: int, size: int) -> NDArray[np.float64]:
    """Smooth noise (size, size) from 0 to 1: layers of random grids, each finer and fainter than the one before."""
    total = np.zeros((size, size))
    for octave in range(_OCTAVES):
        n = cells * 2**octave
        grid = rng.uniform(size=(n, n))
        at = np.arange(size) * n / size
        low = at.astype(int)
        high, part = (low + 1) % n, at - low
        part = part * part * (3 - 2 * part)
        rows = grid[low] * (1 - part)[:, None] + grid[high] * part[:, None]
        total += (rows[:, low] * (1 - part) + rows[:, high] * part) / 2**octave
    total -= total.min()
    return total / max(float(total.max()), 1e-9)
