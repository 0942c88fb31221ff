"""An attempt, sampled: who plays which role, what is said, and where everything starts."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ..config.program_task import Attitude, ProgramTask, Start
from ..config.scene import Table
from ..geometry.se3 import Array, pose, rotation_from_vector, rotation_z
from ..goals.cast import Cast
from ..goals.world import TABLE
from ..types import EpisodeJob
from .randomness import Stream, generator

# Tries to find a free place for a thing, and how often all of them are placed anew because one found none.
_TRIES = 60
_ROUNDS = 20

BlockOf = Callable[[str, Mapping[str, float]], Array]


@dataclass(frozen=True)
class Placed:
    """Where a thing starts, before it is let down onto what it starts on.

    Attributes:
        T: its pose (4, 4) in `world`; its height is not settled yet.
        on: what it starts on: a thing, or `table`.
        open: part -> how far it is open, a share of its range.
    """

    T: Array
    on: str
    open: Mapping[str, float]


def draw_cast(task: ProgramTask, job: EpisodeJob) -> Cast:
    """Who plays which role in an attempt."""
    rng, drawn, sizes = generator(job, Stream.CAST), dict[str, tuple[int, ...]](), dict[str, float]()
    for role, one in task.things.items():
        numbers: list[int] = []
        while len(numbers) < one.count:
            numbers += [int(k) for k in rng.permutation(len(one.of))]
        drawn[role] = tuple(numbers[: one.count])
        if one.sizes:
            sizes |= {name: one.sizes[int(rng.integers(len(one.sizes)))] for name in task.names_of(role, drawn[role])}
    return task.cast_of(drawn, sizes)


def draw_phrasing(task: ProgramTask, job: EpisodeJob) -> str:
    """What is said in an attempt."""
    said = task.phrasings.training
    return said[int(generator(job, Stream.PHRASING).integers(len(said)))]


def draw_places(
    task: ProgramTask, cast: Cast, block_of: BlockOf, table: Table, job: EpisodeJob, number: int = 0
) -> dict[str, Placed] | str:
    """Where everything starts: thing -> its place, in the order in which they are let down.

    Args:
        block_of: from a thing and how far its parts are open, see `Placed.open`, to the lowest and the highest corner
            (2, 3), in its own frame, of the block that encloses it, m.
        number: of the draw, for an attempt whose first ones were of no use.

    Returns:
        Rather the name of a thing for which there was no room in any of 20 rounds of 60 places.
    """
    if task.arrangements:
        return _arranged(task, cast, job, number)
    rng = generator(job, Stream.PLACES, number)
    missing = ""
    for _ in range(_ROUNDS):
        found = _round(task, cast, block_of, table, rng)
        if isinstance(found, dict):
            return found
        missing = found
    return missing


def _arranged(task: ProgramTask, cast: Cast, job: EpisodeJob, number: int) -> dict[str, Placed]:
    """The arrangement whose turn it is: all attempts of a seed go through one random order of them."""
    order = generator(EpisodeJob(job.seed, 0), Stream.PLACES).permutation(len(task.arrangements))
    one = task.arrangements[order[(job.attempt + number) % len(order)]]
    return {
        cast.one(name): Placed(pose((x, y, 0.0), rotation_z(math.radians(turn))), TABLE, {})
        for name, (x, y, turn) in one.places.items()
    }


def _round(
    task: ProgramTask, cast: Cast, block_of: BlockOf, table: Table, rng: np.random.Generator
) -> dict[str, Placed] | str:
    placed: dict[str, Placed] = {}
    for role, start in task.starts.items():
        on = TABLE if start.on == TABLE else cast.one(start.on)
        for name in cast.of(role):
            found = _place(start, on, name, placed, block_of, table, rng)
            if found is None:
                return name
            placed[name] = found
    return placed


def _place(
    start: Start,
    on: str,
    name: str,
    placed: Mapping[str, Placed],
    block_of: BlockOf,
    table: Table,
    rng: np.random.Generator,
) -> Placed | None:
    """A free place for a thing; None if none was found."""
    T_on = pose((0.0, 0.0, table.top)) if on == TABLE else placed[on].T
    beside = [outline(block_of(other, there.open), there.T) for other, there in placed.items() if there.on == on]
    for _ in range(_TRIES):
        x, y = rng.uniform(*start.x), rng.uniform(*start.y)
        turn = math.radians(rng.uniform(*start.yaw_deg))
        attitude = start.attitudes[int(rng.integers(len(start.attitudes)))]
        R = T_on[:3, :3] @ rotation_z(turn) @ _attitude(attitude, rng.uniform(0.0, 2 * math.pi))
        opened = {part: float(rng.uniform(*share)) for part, share in start.open.items()}
        # The outline's middle comes to lie there, and not the origin, which may be at an end.
        block = block_of(name, opened)
        middle = R @ block.mean(axis=0)
        at = (T_on @ (x, y, 0.0, 1.0))[:3] - np.array([middle[0], middle[1], 0.0])
        candidate = Placed(pose(at, R), on, opened)
        corners = outline(block, candidate.T)
        if on == TABLE and not _on_table(corners, table):
            continue
        if all(gap(corners, there) >= start.apart for there in beside):
            return candidate
    return None


def _attitude(attitude: Attitude, roll: float) -> Array:
    match attitude:
        case "lying":
            return rotation_from_vector([0.0, math.pi / 2, 0.0]) @ rotation_z(roll)
        case "upside_down":
            return rotation_from_vector([math.pi, 0.0, 0.0])
    return np.eye(3)


def outline(block: Array, T: Array) -> Array:
    """A block's corners (8, 2) at a pose (4, 4), seen from above, m."""
    x, y, z = np.meshgrid(*block.T, indexing="ij")
    corners: Array = (np.column_stack([x.ravel(), y.ravel(), z.ravel()]) @ T[:3, :3].T + T[:3, 3])[:, :2]
    return corners


def _on_table(corners: Array, table: Table) -> bool:
    middle, half = np.array(table.position[:2]), np.array(table.half_size[:2])
    return bool((np.abs(corners - middle) <= half).all())


def gap(one: Array, other: Array) -> float:
    """At least so far apart are two outlines, given by the corners (n, 2) of blocks that lie flat, m; negative if no
    straight line along their edges parts them.
    """
    edges = np.concatenate([corners[1:] - corners[0] for corners in (one, other)])
    lengths = np.linalg.norm(edges, axis=1)
    along = edges[lengths > 1e-6] / lengths[lengths > 1e-6, None]
    axes = np.concatenate([along, along[:, ::-1] * (-1.0, 1.0)])
    a, b = one @ axes.T, other @ axes.T
    return float(np.maximum(b.min(axis=0) - a.max(axis=0), a.min(axis=0) - b.max(axis=0)).max(initial=-math.inf))
