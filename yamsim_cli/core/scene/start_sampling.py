from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from ..attempt_data import AttemptJob
from ..config.goals.role_assignment import RoleAssignment
from ..config.goals.world import TABLE
from ..config.program_task import ProgramTask
from ..config.scene import Table
from ..config.task_objects import ObjectStartRanges, StartOrientation
from ..geometry.se3 import Array, pose, rotation_from_vector, rotation_z
from .random_streams import Stream, random_generator

_MAX_TRIES = 60  # of one object, after which the round fails
_MAX_ROUNDS = 20  # each of which samples the placements of all objects again

LocalBoxFunction = Callable[[str, Mapping[str, float]], Array]  # the type of `sample_placements.box_of`


@dataclass(frozen=True)
class ObjectPlacement:
    """The initial placement of an object, before it settles.

    Attributes:
        T: pose in `world`; settling corrects the height.
        support_name: the supporting object, or `table`.
        joint_openings: part -> opening of its joint as a share of the joint's range.
    """

    T: Array
    support_name: str
    joint_openings: Mapping[str, float]


def sample_roles(task: ProgramTask, job: AttemptJob) -> RoleAssignment:
    """Sample which objects play which roles in an attempt, and the sizes of these objects."""
    rng, drawn, sizes = random_generator(job, Stream.ROLES), dict[str, tuple[int, ...]](), dict[str, float]()
    for role, one in task.things.items():
        numbers: list[int] = []
        while len(numbers) < one.count:
            numbers += [int(k) for k in rng.permutation(len(one.of))]
        drawn[role] = tuple(numbers[: one.count])
        if one.sizes:
            sizes |= {
                name: one.sizes[int(rng.integers(len(one.sizes)))] for name in task.object_names_of(role, drawn[role])
            }
    return task.assign_roles(drawn, sizes)


def sample_phrasing(task: ProgramTask, job: AttemptJob) -> str:
    """Sample the language instruction of an attempt from the task's training phrasings."""
    prompts = task.phrasings.training
    return prompts[int(random_generator(job, Stream.PHRASING).integers(len(prompts)))]


def sample_placements(
    task: ProgramTask, roles: RoleAssignment, box_of: LocalBoxFunction, table: Table, job: AttemptJob, number: int = 0
) -> dict[str, ObjectPlacement] | str:
    """Sample object -> initial placement, in the order in which objects settle.

    If 20 rounds of 60 tries find no free placement for an object, the result is this object's name. `box_of` gives an
    object's local bounding box (2, 3), m. `number` is how many samples of this attempt the caller has rejected.
    """
    if task.arrangements:
        return _arranged_placements(task, roles, job, number)
    rng = random_generator(job, Stream.PLACES, number)
    missing = ""
    for _ in range(_MAX_ROUNDS):
        found = _sample_all_placements(task, roles, box_of, table, rng)
        if isinstance(found, dict):
            return found
        missing = found
    return missing


def _arranged_placements(
    task: ProgramTask, roles: RoleAssignment, job: AttemptJob, number: int
) -> dict[str, ObjectPlacement]:
    """Attempts use the task's list of arrangements in a random order per seed."""
    order = random_generator(AttemptJob(job.seed, 0), Stream.PLACES).permutation(len(task.arrangements))
    one = task.arrangements[order[(job.attempt + number) % len(order)]]
    return {
        roles.object_of(name): ObjectPlacement(pose((x, y, 0.0), rotation_z(math.radians(turn))), TABLE, {})
        for name, (x, y, turn) in one.places.items()
    }


def _sample_all_placements(
    task: ProgramTask, roles: RoleAssignment, box_of: LocalBoxFunction, table: Table, rng: np.random.Generator
) -> dict[str, ObjectPlacement] | str:
    placed: dict[str, ObjectPlacement] = {}
    for role, start in task.starts.items():
        on = TABLE if start.on == TABLE else roles.object_of(start.on)
        for name in roles.objects_of(role):
            found = _sample_placement(start, on, name, placed, box_of, table, rng)
            if found is None:
                return name
            placed[name] = found
    return placed


def _sample_placement(
    start: ObjectStartRanges,
    on: str,
    name: str,
    placed: Mapping[str, ObjectPlacement],
    box_of: LocalBoxFunction,
    table: Table,
    rng: np.random.Generator,
) -> ObjectPlacement | None:
    T_on = pose((0.0, 0.0, table.top_height)) if on == TABLE else placed[on].T
    neighbours = [
        footprint_corners(box_of(other, there.joint_openings), there.T)
        for other, there in placed.items()
        if there.support_name == on
    ]
    for _ in range(_MAX_TRIES):
        x, y = rng.uniform(*start.x), rng.uniform(*start.y)
        turn = math.radians(rng.uniform(*start.yaw_deg))
        attitude = start.attitudes[int(rng.integers(len(start.attitudes)))]
        R = T_on[:3, :3] @ rotation_z(turn) @ _start_rotation(attitude, rng.uniform(0.0, 2 * math.pi))
        opened = {part: float(rng.uniform(*share)) for part, share in start.open.items()}
        # x and y refer to the middle of the bounding box, not to the origin.
        box = box_of(name, opened)
        middle = R @ box.mean(axis=0)
        at = (T_on @ (x, y, 0.0, 1.0))[:3] - np.array([middle[0], middle[1], 0.0])
        candidate = ObjectPlacement(pose(at, R), on, opened)
        corners = footprint_corners(box, candidate.T)
        if on == TABLE and not _is_on_table(corners, table):
            continue
        if all(footprint_distance(corners, there) >= start.apart for there in neighbours):
            return candidate
    return None


def _start_rotation(orientation: StartOrientation, roll: float) -> Array:
    match orientation:
        case "lying":
            return rotation_from_vector([0.0, math.pi / 2, 0.0]) @ rotation_z(roll)
        case "upside_down":
            return rotation_from_vector([math.pi, 0.0, 0.0])
    return np.eye(3)


_CORNERS = tuple(itertools.product((0, 1), repeat=3))  # 0 (low) or 1 (high) for each axis


def footprint_corners(box: Array, T: Array) -> Array:
    """Return x and y (8, 2), m, of the corners of a box (2, 3: low and high corner) at a pose."""
    corners: Array = (box[_CORNERS, (0, 1, 2)] @ T[:3, :3].T + T[:3, 3])[:, :2]
    return corners


def _is_on_table(corners: Array, table: Table) -> bool:
    middle, half = np.array(table.position[:2]), np.array(table.half_size[:2])
    return bool((np.abs(corners - middle) <= half).all())


def footprint_distance(one: Array, other: Array) -> float:
    """Return a lower bound of the distance of the convex hulls of two footprints (n, 2), m; negative for overlap."""
    edges = np.concatenate([corners[1:] - corners[0] for corners in (one, other)])
    lengths = np.linalg.norm(edges, axis=1)
    along = edges[lengths > 1e-6] / lengths[lengths > 1e-6, None]
    axes = np.concatenate([along, along[:, ::-1] * (-1.0, 1.0)])
    a, b = one @ axes.T, other @ axes.T
    return float(np.maximum(b.min(axis=0) - a.max(axis=0), a.min(axis=0) - b.max(axis=0)).max(initial=-math.inf))
