"""Find places for distractors: on the table, clear of everything that moves at any time of an episode."""

from __future__ import annotations

import math
from collections.abc import Sequence

import mujoco
import numpy as np

from ..config.randomization import Distractors
from ..config.scene import Table
from ..config.things import ObjectConfig
from ..geometry.se3 import Array
from ..scene.compiled import CompiledScene
from ..scene.randomize import SceneRandomizer
from ..tasks.randomness import Stream, generator
from ..types import EpisodeJob

Place = tuple[float, float, float, float]

# Tries for each distractor before it is left out.
_TRIES = 12


def place_distractors(
    scene: CompiledScene,
    randomizer: SceneRandomizer,
    config: Distractors,
    table: Table,
    job: EpisodeJob,
    states: Sequence[Array],
) -> dict[str, Place]:
    """Draw which distractors stand on the table, and where; they are put there.

    They stand still and nothing comes near them, so it makes no difference to physics that they come last. One for
    which no free place is found in 12 draws is left out: that is for the eye alone, and fails no attempt.

    Args:
        states: MuJoCo's positions (nq,) throughout the episode.

    Returns:
        Distractor -> `[x, y, z, yaw]` in `world`, m and rad.
    """
    rng = generator(job, Stream.DISTRACTORS)
    wanted = int(rng.integers(config.count[0], config.count[1] + 1))
    order = rng.permutation(len(config.objects))[:wanted]
    data = mujoco.MjData(scene.model)
    placed: dict[str, Place] = {}
    discs: list[Array] = []
    for item in (config.objects[k] for k in order):
        for _ in range(_TRIES):
            x, y, yaw = rng.uniform(*config.x), rng.uniform(*config.y), rng.uniform(-math.pi, math.pi)
            disc = _discs(item, x, y, yaw)
            if not _on_table(disc, table) or any(_gap(disc, other) < config.clearance for other in discs):
                continue
            place = (float(x), float(y), table.top + item.rest_height, float(yaw))
            randomizer.place(item.name, place)
            if _is_clear(scene, data, item.name, config.clearance, states):
                placed[item.name] = place
                discs.append(disc)
                break
            randomizer.place(item.name, None)
    return placed


def _discs(item: ObjectConfig, x: float, y: float, yaw: float) -> Array:
    """An object's footprint as discs (n, 3) of x, y and radius in `world`, m."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[x + c * a - s * b, y + s * a + c * b, radius] for a, b, radius in item.footprint])


def _on_table(discs: Array, table: Table) -> bool:
    middle, half = np.array(table.position[:2]), np.array(table.half_size[:2])
    return bool((np.abs(discs[:, :2] - middle) + discs[:, 2:] <= half).all())


def _gap(one: Array, other: Array) -> float:
    apart = np.linalg.norm(one[:, None, :2] - other[None, :, :2], axis=-1)
    return float((apart - one[:, None, 2] - other[None, :, 2]).min())


def _is_clear(scene: CompiledScene, data: mujoco.MjData, name: str, clearance: float, states: Sequence[Array]) -> bool:
    """Whether nothing that moves comes nearer to a distractor than `clearance`, by MuJoCo's own collision detection."""
    model = scene.model
    body = model.body(name)
    mocap = int(body.mocapid[0])
    geoms = np.flatnonzero(model.geom_bodyid == body.id)
    before = model.geom_margin[geoms].copy()
    model.geom_margin[geoms] = clearance
    data.mocap_pos[mocap], data.mocap_quat[mocap] = model.body_pos[body.id], model.body_quat[body.id]
    try:
        for qpos in states:
            data.qpos[:] = qpos
            mujoco.mj_kinematics(model, data)
            mujoco.mj_collision(model, data)
            if np.isin(data.contact.geom, geoms).any():
                return False
        return True
    finally:
        model.geom_margin[geoms] = before
