"""Placement of distractors away from all motions of an attempt, and a collision check for arm postures."""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence

import mujoco
import numpy as np

from ..attempt_data import AttemptJob
from ..config.objects.object_config import ObjectConfig
from ..config.recording import RecordConfig
from ..config.scene import Table
from ..geometry.se3 import Array, UprightPose
from ..scene.compiled import CompiledScene
from ..scene.random_streams import Stream, random_generator
from ..scene.randomized_model import RandomizedModel

_MAX_TRIES = 12  # for each distractor, after which it is left out
_MAX_OVERLAP = 5e-4  # m, penetration up to which a contact is no collision


class DistractorPlacer:
    """Samples places for a recording's distractors.

    It works in its own copy of the scene's model. Only the distractors' places vary there; physics and looks do not.
    """

    def __init__(self, config: RecordConfig, scene: CompiledScene) -> None:
        self._distractors = config.randomization.distractors
        self._table = config.widened_table
        self._look = config.look
        self._model = copy.copy(scene.model)
        self._randomized_model = RandomizedModel(self._model, config.randomization, config.scene)

    def sample_poses(self, job: AttemptJob, positions: Sequence[Array]) -> dict[str, UprightPose]:
        """Return distractor -> place `[x, y, z, yaw]` in `world`, m and rad, sampled for an attempt.

        Distractors are placed after the motion (`qpos` at all times) is known, where nothing comes near, so they do not
        change it. A distractor without a free place after 12 tries is left out.
        """
        config = self._distractors
        if config is None:
            return {}
        for item in config.objects:
            self._randomized_model.place_distractor(item.name, None)
        rng = random_generator(job.for_look(self._look), Stream.DISTRACTORS)
        wanted = int(rng.integers(config.count[0], config.count[1] + 1))
        order = rng.permutation(len(config.objects))[:wanted]
        data = mujoco.MjData(self._model)
        placed: dict[str, UprightPose] = {}
        discs: list[Array] = []
        for item in (config.objects[k] for k in order):
            for _ in range(_MAX_TRIES):
                x, y, yaw = rng.uniform(*config.x), rng.uniform(*config.y), rng.uniform(-math.pi, math.pi)
                disc = _footprint_discs(item, x, y, yaw)
                if not _is_on_table(disc, self._table) or any(
                    _disc_distance(disc, other) < config.clearance for other in discs
                ):
                    continue
                place = (float(x), float(y), self._table.top_height + item.rest_height, float(yaw))
                self._randomized_model.place_distractor(item.name, place)
                if self._is_clear(data, item.name, config.clearance, positions):
                    placed[item.name] = place
                    discs.append(disc)
                    break
                self._randomized_model.place_distractor(item.name, None)
        return placed

    def _is_clear(self, data: mujoco.MjData, name: str, clearance: float, positions: Sequence[Array]) -> bool:
        model = self._model
        body = model.body(name)
        mocap = int(body.mocapid[0])
        geoms = np.flatnonzero(model.body_rootid[model.geom_bodyid] == body.id)
        before = model.geom_margin[geoms].copy(), model.body_margin[body.id].copy()
        # MuJoCo skips pairs of bodies that are farther apart than their margins, which are set at compilation.
        model.geom_margin[geoms] = model.body_margin[body.id] = clearance
        data.mocap_pos[mocap], data.mocap_quat[mocap] = model.body_pos[body.id], model.body_quat[body.id]
        try:
            for qpos in positions:
                data.qpos[:] = qpos
                mujoco.mj_kinematics(model, data)
                mujoco.mj_comPos(model, data)
                mujoco.mj_flex(model, data)
                mujoco.mj_collision(model, data)
                if np.isin(data.contact.geom, geoms).any():
                    return False
            return True
        finally:
            model.geom_margin[geoms], model.body_margin[body.id] = before


def _footprint_discs(item: ObjectConfig, x: float, y: float, yaw: float) -> Array:
    """Return an object's footprint as discs (n, 3) of x, y and radius in `world`, m."""
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[x + c * a - s * b, y + s * a + c * b, radius] for a, b, radius in item.footprint_discs])


def _is_on_table(discs: Array, table: Table) -> bool:
    middle, half = np.array(table.position[:2]), np.array(table.half_size[:2])
    return bool((np.abs(discs[:, :2] - middle) + discs[:, 2:] <= half).all())


def _disc_distance(one: Array, other: Array) -> float:
    apart = np.linalg.norm(one[:, None, :2] - other[None, :, :2], axis=-1)
    return float((apart - one[:, None, 2] - other[None, :, 2]).min())


class ArmCollisionCheck:
    """Finds collisions of an arm. Contacts with the task's objects, which can be moved, are ignored."""

    def __init__(self, scene: CompiledScene, arm: int) -> None:
        self._scene = scene
        self._joints = scene.arms[arm].joint_qpos
        model = scene.model
        self._data = mujoco.MjData(model)
        self._is_arm = scene.geom_arm == arm
        objects = [model.body(name).id for name in scene.object_qpos]
        self._is_object = np.isin(model.body_rootid[model.geom_bodyid], objects)

    def deepest_penetration(self, qpos: Array, joints: Array) -> tuple[float, str]:
        """Return the deepest penetration of the arm, m, and the name of the penetrated geom; 0 and "" if none.

        `qpos` (nq,) are the positions of the rest of the scene.
        """
        data, model = self._data, self._scene.model
        data.qpos[:] = qpos
        data.qpos[self._joints] = joints
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        pairs = data.contact.geom
        concerned = (
            self._is_arm[pairs].any(axis=1) & ~self._is_object[pairs].any(axis=1) & (data.contact.dist < -_MAX_OVERLAP)
        )
        if not concerned.any():
            return 0.0, ""
        worst = int(np.argmin(np.where(concerned, data.contact.dist, np.inf)))
        return float(-data.contact.dist[worst]), self._other_geom_name(pairs[worst])

    def _other_geom_name(self, pair: Array) -> str:
        others = [int(geom) for geom in pair if not self._is_arm[geom]]
        return self._scene.model.geom(others[0]).name.replace("_", " ") if others else "the arm itself"
