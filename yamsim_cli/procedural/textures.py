"""Textures of floors, tables and walls, generated from a seed.

A texture is a pattern (size, size) of shares in 0..1 that mixes two colours. Opposite edges match, so that a pattern
can be repeated; only a gradient has edges.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Texture = Literal[
    "plain", "checker", "gradient", "noise",
    "wood", "marble", "concrete", "tiles", "carpet", "weave", "stripes",
    "bricks", "terrazzo", "plaid", "hexagons",
]  # fmt: skip

# Textures that only randomizations with `held_out` may use, so that no recording shows them.
HELD_OUT_TEXTURES = frozenset({"bricks", "terrazzo", "plaid", "hexagons"})

_OCTAVES = 4  # noise grids, each twice as fine as the previous one
_GROUT = 0.06  # share of a tile's edge that its joint takes
_PLANK_JOINT = 0.03  # share of a plank's width that its joint takes
_STONES = 12  # terrazzo stones along each edge, for each repetition

Pattern = NDArray[np.float64]


def texture_pattern(texture: str, repeat: int, seed: int, size: int) -> Pattern:
    """Return the pattern (size, size) of a texture, shares in 0..1; zeros for an unknown or plain one.

    Args:
        repeat: repetitions of the pattern's motif along each edge.
        seed: of everything random in the pattern. Equal arguments give equal bits.
        size: edge, px.
    """
    make = _PATTERNS.get(texture)
    return np.zeros((size, size)) if make is None else make(np.random.default_rng(seed), repeat, size)


def _checker(rng: np.random.Generator, repeat: int, size: int) -> Pattern:
    cell = np.arange(size) * 2 * repeat // size
    return np.asarray((cell[:, None] + cell[None, :]) % 2, float)


def _gradient(rng: np.random.Generator, repeat: int, size: int) -> Pattern:
    turn = 2 * np.pi * rng.uniform()
    along = np.linspace(-0.5, 0.5, size)
    share: Pattern = 0.5 + (along[:, None] * np.sin(turn) + along[None, :] * np.cos(turn)) / np.sqrt(2)
    return share


def smooth_noise(rng: np.random.Generator, cells: int, size: int) -> Pattern:
    """Return smooth noise (size, size) in 0..1: a sum of random grids with decreasing cell size and amplitude."""
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
    return np.asarray(total / max(float(total.max()), 1e-9))


def _axes(size: int) -> tuple[Pattern, Pattern]:
    """Return row and column coordinates (size, 1) and (1, size) of pixels, in 0..1."""
    at = (np.arange(size) + 0.5) / size
    return at[:, None], at[None, :]


def _wood(rng: np.random.Generator, repeat: int, size: int) -> Pattern:
    """Planks along the columns, each with its own tone and grain."""
    noise = smooth_noise(rng, 3, size)
    rows, columns = np.arange(size), np.arange(size)
    plank = rows * repeat // size
    shift, tone = rng.integers(0, size, repeat), rng.uniform(0, 0.35, repeat)
    # Eight times as fine across a plank as along it.
    grain = noise[(8 * rows)[:, None] % size, (columns[None, :] + shift[plank][:, None]) % size]
    share = tone[plank][:, None] + 0.65 * (0.5 + 0.5 * np.sin(2 * np.pi * 3 * grain))
    within = (rows * repeat / size) % 1
    share[within < _PLANK_JOINT] = 1.0
    return np.asarray(np.clip(share, 0, 1))


def _marble(rng: np.random.Generator, repeat: int, size: int) -> Pattern:
    """Thin veins, bent by noise."""
    v, u = _axes(size)
    turns = rng.permutation([repeat, max(1, repeat // 2)])
    veins = np.abs(np.sin(np.pi * (turns[0] * u + turns[1] * v) * 2 + 7 * smooth_noise(rng, 3, size)))
    return np.asarray((1 - veins) ** 3 + 0.2 * smooth_noise(rng, 2, size)).clip(0, 1)


def _concrete(rng: np.random.Generator, repeat: int, size: int) -> Pattern:
    """Stains with grains."""
    return 0.7 * smooth_noise(rng, repeat, size) + 0.3 * rng.uniform(size=(size, size))


def _grid(size: int, rows: int, columns: int, shift: float) -> tuple[NDArray[Any], NDArray[Any], NDArray[np.bool_]]:
    """Return row and column numbers of tiles (size, size), and where joints are; odd rows are moved by `shift`."""
    v, u = _axes(size)
    row = np.floor(v * rows).astype(int) + np.zeros((size, size), int)
    along = u * columns + shift * (row % 2)
    column = np.floor(along).astype(int) % columns
    joint = ((v * rows) % 1 < _GROUT * rows / columns) | (along % 1 < _GROUT)
    return row, column, joint


def _tiles(rng: np.random.Generator, repeat: int, size: int) -> Pattern:
    """Square tiles with slightly different tones, and dark joints."""
    row, column, joint = _grid(size, repeat, repeat, 0.0)
    return np.where(joint, 1.0, rng.uniform(0, 0.35, (repeat, repeat))[row, column])


def _carpet(rng: np.random.Generator, repeat: int, size: int) -> Pattern:
    """Loops of yarn: fine noise, smoothed along the columns."""
    fine = rng.uniform(size=(size, size))
    loops = np.mean([np.roll(fine, k, axis=1) for k in range(3)], axis=0)
    return np.asarray(0.75 * loops + 0.25 * smooth_noise(rng, repeat, size))


def _weave(rng: np.random.Generator, repeat: int, size: int) -> Pattern:
    """Threads that cross over and under each other."""
    v, u = _axes(size)
    threads = 8 * repeat
    over = (np.floor(v * threads) + np.floor(u * threads)) % 2
    across = np.abs(np.sin(np.pi * v * threads)) + np.zeros_like(u)
    along = np.abs(np.sin(np.pi * u * threads)) + np.zeros_like(v)
    return np.asarray(0.8 * np.where(over > 0, across, along) + 0.2 * rng.uniform(size=(size, size)))


def _stripes(rng: np.random.Generator, repeat: int, size: int) -> Pattern:
    """Stripes of random widths and tones, along the columns."""
    edges = np.sort(rng.uniform(size=2 * repeat))
    tone = rng.uniform(size=2 * repeat)
    v, u = _axes(size)
    return tone[np.searchsorted(edges, v[:, 0]) % (2 * repeat)][:, None] + np.zeros_like(u)


def _bricks(rng: np.random.Generator, repeat: int, size: int) -> Pattern:
    """Rows of bricks, each moved by half a brick, with light joints."""
    rows = 4 * repeat
    row, column, joint = _grid(size, rows, 2 * repeat, 0.5)
    return np.where(joint, 1.0, rng.uniform(0, 0.5, (rows, 2 * repeat))[row, column])


def _nearest_points(points: NDArray[np.float64], cells: int, size: int) -> NDArray[np.int64]:
    """Return the number of the nearest point (size, size), one point in each of `cells` x `cells`; edges match."""
    v, u = (np.broadcast_to(axis * cells, (size, size)) for axis in _axes(size))
    row, column = np.floor(v).astype(int), np.floor(u).astype(int)
    best, nearest = np.full((size, size), np.inf), np.zeros((size, size), np.int64)
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            number = (row + down) % cells * cells + (column + right) % cells
            apart = np.hypot(row + down + points[number, 0] - v, column + right + points[number, 1] - u)
            nearest = np.where(apart < best, number, nearest)
            best = np.minimum(apart, best)
    return nearest


def _terrazzo(rng: np.random.Generator, repeat: int, size: int) -> Pattern:
    """Stones of random shapes; most have the ground's tone."""
    cells = min(_STONES * repeat, size // 4)
    tone = rng.uniform(size=cells**2) * (rng.uniform(size=cells**2) < 0.4)
    return tone[_nearest_points(rng.uniform(size=(cells**2, 2)), cells, size)]


def _plaid(rng: np.random.Generator, repeat: int, size: int) -> Pattern:
    """Stripes in both directions, which add up."""
    v, u = _axes(size)
    tones = rng.uniform(size=(2, 8))
    rows, columns = (tones[k][np.floor(axis * 8 * repeat).astype(int) % 8] for k, axis in enumerate((v, u)))
    return np.asarray(0.5 * (rows + columns))


def _hexagons(rng: np.random.Generator, repeat: int, size: int) -> Pattern:
    """Nearly regular hexagonal tiles: the cells of points in shifted rows."""
    cells = 2 * repeat
    points = np.full((cells**2, 2), 0.25)
    points[:, 1] += 0.5 * (np.arange(cells**2) // cells % 2)
    tone = rng.uniform(size=cells**2)
    return tone[_nearest_points(points, cells, size)]


_PATTERNS: dict[str, Callable[[np.random.Generator, int, int], Pattern]] = {
    "checker": _checker,
    "gradient": _gradient,
    "noise": smooth_noise,
    "wood": _wood,
    "marble": _marble,
    "concrete": _concrete,
    "tiles": _tiles,
    "carpet": _carpet,
    "weave": _weave,
    "stripes": _stripes,
    "bricks": _bricks,
    "terrazzo": _terrazzo,
    "plaid": _plaid,
    "hexagons": _hexagons,
}
