"""A way around obstacles in joint space, where no simple motion is free: two trees that grow towards each other."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ..geometry.se3 import Array

# Longest branch, and how finely an edge is looked at, rad.
_BRANCH = 0.25
_EDGE_STEP = 0.06

# How many branches are tried, how often towards the other tree, and how often a found way is cut short.
_BRANCHES = 400
_TOWARDS_OTHER = 0.3
_SHORTCUTS = 40


@dataclass
class _Tree:
    nodes: list[Array]
    parents: list[int] = field(default_factory=lambda: [-1])

    def nearest(self, joints: Array) -> int:
        return int(np.abs(np.asarray(self.nodes) - joints).sum(axis=1).argmin())

    def add(self, joints: Array, parent: int) -> int:
        self.nodes.append(joints)
        self.parents.append(parent)
        return len(self.nodes) - 1

    def way_to_root(self, node: int) -> list[Array]:
        way = []
        while node >= 0:
            way.append(self.nodes[node])
            node = self.parents[node]
        return way


def search(
    start: Array, goal: Array, bounds: Array, touched: Callable[[Array], str | None], rng: np.random.Generator
) -> list[Array] | None:
    """Points (dof,) in joint space, from start to goal, with free straight edges between them; None if none was found.

    Source of the method: Kuffner and LaValle, RRT-Connect, ICRA 2000.

    Args:
        bounds: the joints' stops (dof, 2), rad.
        touched: what is touched at given joints; None where they are free.
    """
    if touched(goal):
        return None
    trees = [_Tree([start]), _Tree([goal])]

    def free(one: Array, other: Array) -> bool:
        number = max(1, math.ceil(float(np.abs(other - one).max()) / _EDGE_STEP))
        return not any(touched(one + (other - one) * k / number) for k in range(1, number + 1))

    for number in range(_BRANCHES):
        growing, other = trees[number % 2], trees[1 - number % 2]
        aim = (
            other.nodes[int(rng.integers(len(other.nodes)))]
            if rng.random() < _TOWARDS_OTHER
            else rng.uniform(bounds[:, 0], bounds[:, 1])
        )
        near = growing.nearest(aim)
        new = _towards(growing.nodes[near], aim)
        if not free(growing.nodes[near], new):
            continue
        tip = growing.add(new, near)
        met = _connect(other, new, free)
        if met is not None:
            way = [*growing.way_to_root(tip)[::-1], *other.way_to_root(met)[1:]]
            return _shortened(way[::-1] if number % 2 else way, free, rng)
    return None


def _towards(here: Array, there: Array) -> Array:
    step = there - here
    longest = float(np.abs(step).max())
    moved: Array = here + step * min(1.0, _BRANCH / longest) if longest else here
    return moved


def _connect(tree: _Tree, joints: Array, free: Callable[[Array, Array], bool]) -> int | None:
    """Grow a tree straight towards a point; the node at which it arrives, if it does."""
    node = tree.nearest(joints)
    while True:
        here = tree.nodes[node]
        if float(np.abs(joints - here).max()) < 1e-9:
            return node
        new = _towards(here, joints)
        if not free(here, new):
            return None
        node = tree.add(new, node)


def _shortened(way: list[Array], free: Callable[[Array, Array], bool], rng: np.random.Generator) -> list[Array]:
    for _ in range(_SHORTCUTS):
        if len(way) < 3:
            break
        first, last = sorted(int(k) for k in rng.integers(len(way), size=2))
        if last - first > 1 and free(way[first], way[last]):
            way = way[: first + 1] + way[last:]
    return way
