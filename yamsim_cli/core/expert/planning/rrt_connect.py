from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ...geometry.se3 import Array

_MAX_BRANCH_LENGTH = 0.25  # rad, of a joint along a branch
_CONTACT_CHECK_STEP = 0.06  # rad, of a joint between two contact checks on an edge
_MAX_BRANCHES = 400  # tried before the search gives up
_GOAL_BIAS = 0.3  # share of branches that grow towards the other tree
_SHORTCUTS = 40  # random, tried on a found path


@dataclass
class _Tree:
    nodes: list[Array]
    parents: list[int] = field(default_factory=lambda: [-1])

    def nearest_node(self, joints: Array) -> int:
        return int(np.abs(np.asarray(self.nodes) - joints).sum(axis=1).argmin())

    def add_node(self, joints: Array, parent: int) -> int:
        self.nodes.append(joints)
        self.parents.append(parent)
        return len(self.nodes) - 1

    def path_to_root(self, node: int) -> list[Array]:
        path = []
        while node >= 0:
            path.append(self.nodes[node])
            node = self.parents[node]
        return path


def plan_rrt_connect(
    start: Array, goal: Array, bounds: Array, find_contact: Callable[[Array], str | None], rng: np.random.Generator
) -> list[Array] | None:
    """Return waypoints (dof,) from start to goal with collision-free straight edges; None if none are found.

    `bounds` are joint limits (dof, 2), rad. Source: Kuffner and LaValle, "RRT-Connect", ICRA 2000.
    """
    if find_contact(goal):
        return None
    trees = [_Tree([start]), _Tree([goal])]

    def is_edge_free(one: Array, other: Array) -> bool:
        number = max(1, math.ceil(float(np.abs(other - one).max()) / _CONTACT_CHECK_STEP))
        return not any(find_contact(one + (other - one) * k / number) for k in range(1, number + 1))

    for number in range(_MAX_BRANCHES):
        growing, other = trees[number % 2], trees[1 - number % 2]
        aim = (
            other.nodes[int(rng.integers(len(other.nodes)))]
            if rng.random() < _GOAL_BIAS
            else rng.uniform(bounds[:, 0], bounds[:, 1])
        )
        near = growing.nearest_node(aim)
        new = _step_towards(growing.nodes[near], aim)
        if not is_edge_free(growing.nodes[near], new):
            continue
        tip = growing.add_node(new, near)
        met = _connect_tree(other, new, is_edge_free)
        if met is not None:
            path = [*growing.path_to_root(tip)[::-1], *other.path_to_root(met)[1:]]
            return _shortcut_path(path[::-1] if number % 2 else path, is_edge_free, rng)
    return None


def _step_towards(start: Array, goal: Array) -> Array:
    step = goal - start
    longest = float(np.abs(step).max())
    moved: Array = start + step * min(1.0, _MAX_BRANCH_LENGTH / longest) if longest else start
    return moved


def _connect_tree(tree: _Tree, joints: Array, free: Callable[[Array, Array], bool]) -> int | None:
    """Grow a tree straight to joints, and return the index of the node there; None if an obstacle is met."""
    node = tree.nearest_node(joints)
    while True:
        here = tree.nodes[node]
        if float(np.abs(joints - here).max()) < 1e-9:
            return node
        new = _step_towards(here, joints)
        if not free(here, new):
            return None
        node = tree.add_node(new, node)


def _shortcut_path(path: list[Array], free: Callable[[Array, Array], bool], rng: np.random.Generator) -> list[Array]:
    for _ in range(_SHORTCUTS):
        if len(path) < 3:
            break
        first, last = sorted(int(k) for k in rng.integers(len(path), size=2))
        if last - first > 1 and free(path[first], path[last]):
            path = path[: first + 1] + path[last:]
    return path
