from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from ..attempt_data import ArmPosture
from ..config.recording import RecordConfig
from ..expert.planning.arm_solvers import ArmIkAndDynamics, start_postures
from ..expert.planning.collision_checker import CollisionChecker
from ..expert.planning.ik import Tolerance
from ..expert.skills.hand import Hand
from ..expert.skills.planning_context import PlanningContext
from ..geometry.se3 import Array, pose, rotation_from_vector, rotation_z
from ..scene.compiled import CompiledScene
from ..sim.sim_world import SimWorld

TILT_ANGLES = tuple(math.radians(angle) for angle in (0, 30, 60))  # rad, of the hand from straight down
TILT_DIRECTIONS = tuple(math.radians(angle) for angle in range(0, 360, 60))  # rad, of the tilt
ROLL_ANGLES = tuple(math.radians(angle) for angle in (0, 90, 45, -45))  # rad, about the hand's own axis

# m and rad, errors of the hand at a reachable point; joints may be right at their limits
_REACH_TOLERANCE = Tolerance(3e-3, math.radians(4.0), joint_limit_margin=0.0)


class ExpertPlanner:
    """Makes the planning contexts of all attempts in one scene."""

    def __init__(self, config: RecordConfig, scene: CompiledScene, tools: tuple[ArmIkAndDynamics, ...]) -> None:
        self._config, self._scene, self._tools = config, scene, tools
        geoms = [np.sort(np.concatenate(fingers)) for fingers in scene.finger_geoms]
        absent = [item.name for item in config.randomization.distractor_configs]
        # A filled object moves with its pieces, so they are no obstacles.
        absent += [scene.model.joint(k).name for joints in scene.pieces.values() for k in joints]
        self._collision_checker = CollisionChecker(scene.model, scene.arms, list(scene.object_names), geoms, absent)

    def is_place_reachable(self, place: Array) -> bool:
        """Return whether an acting hand reaches a place (3,) in `world`, m, regardless of contacts."""
        postures = start_postures(self._config)
        for k in self._config.acting_scene_arms:
            ik = self._tools[k].ik
            if any(ik.solve_from(T, [postures[k].joints], _REACH_TOLERANCE) is not None for T in _hand_poses(place)):
                return True
        return False

    def rest_height(self, qpos: Array, thing: str, T_in_world: Array, lowest: float) -> float:
        """Lower an object from a pose, and return its height at the first contact, else `lowest`, m."""
        return self._collision_checker.rest_height(qpos, thing, T_in_world, lowest)

    def planning_context(
        self, world: SimWorld, postures: list[ArmPosture], rng: np.random.Generator
    ) -> PlanningContext:
        """Return an attempt's planning context, with the arms in their start postures."""
        config, scene = self._config, self._scene
        hands = [
            Hand(k, side, arm, tools.ik, tools.dynamics, posture.joints, posture.opening)
            for k, (side, arm, tools, posture) in enumerate(
                zip(arm_sides(config), scene.arms, self._tools, postures, strict=True)
            )
        ]
        items = {item.name: item for item in config.task.objects}
        acting, first = config.acting_scene_arms, config.rig.recording_order.index(config.first_arm)
        return PlanningContext(
            scene.model,
            world,
            hands,
            acting,
            first,
            items,
            self._collision_checker,
            rng,
            config.task.timing.tick_seconds,
        )


def arm_sides(config: RecordConfig) -> tuple[str, ...]:
    """Return "left" or "right" for each arm, in the scene's order."""
    return tuple(config.rig.arms[number].side for number in config.rig.recording_order)


def _hand_poses(place: Array) -> Iterator[Array]:
    down = rotation_from_vector([math.pi, 0.0, 0.0])
    for tilt in TILT_ANGLES:
        for direction in TILT_DIRECTIONS if tilt else TILT_DIRECTIONS[:1]:
            tilted = rotation_from_vector([tilt * math.cos(direction), tilt * math.sin(direction), 0.0])
            for turn in ROLL_ANGLES:
                yield pose(place, tilted @ rotation_z(turn) @ down)
