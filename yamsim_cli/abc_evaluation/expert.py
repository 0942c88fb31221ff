"""Scripted expert of `put_bottles`: one arm at a time grasps a bottle from above and drops it into the bin, cap first.

Cap first, because ABC judges by a bottle's origin, which is at its foot. On the bin's floor, a foot is below the
heights that count.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core.geometry.se3 import Array, invert_pose, pose, rotation_z
from ..kinematics import Kinematics, OutOfReachError
from ..policies.policy_protocol import OBJECTS, Observation
from .environment import BIN, BOTTLES, GRIPPER_OPENING, POLICY_HZ, SIDES, PutBottles

# ABC's arms are YAM arms with this rig's gripper. Poses of `grasp_site` differ by up to 9 mm between both models.
_SIMILAR_RIG = "yam_station_linear_4310_d405"
_CORRECTIONS = 4  # repetitions of the inverse kinematics with the difference between the models

_GRASP_ALONG_BOTTLE = 0.075  # m, from a bottle's foot to the grasp
_GRASP_DEPTH = 0.008  # m, by which `grasp_site` is below a bottle's axis
_CLEARANCE = 0.12  # m, over the grasp, before the descent and after the lift
_DROP_HEIGHT = 0.25  # m, of the grasp over the bin's origin; its rim is at 0.12, and a bottle hangs 0.09 below the hand
_MAX_TILT = 0.6  # rad, by which the hand may tilt where the arm is too short for a vertical approach

_JOINT_SPEED = 1.5  # rad/s, mean of a motion's fastest joint
_SLOW_JOINT_SPEED = 0.5  # rad/s, near a bottle
_FINGER_ACTIONS = 12  # actions for closing or opening the fingers
_SETTLE_ACTIONS = 8  # actions of waiting before the fingers move, because the drives lag behind

# `grasp_site` in `world` at the start: z forward and x down, so that a bottle with its cap towards x hangs cap down.
_FORWARD = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])


@dataclass(frozen=True)
class Waypoint:
    """Target of an arm's motion."""

    joints: Array  # (6,), rad
    opening: float  # of one finger, m
    speed: float  # rad/s, mean of the fastest joint in a motion
    settle: int = 0  # actions of waiting, because the drives lag behind


class BottlesExpert:
    """A policy that reads the poses of all objects. It tries bottles that are not in the bin until all are.

    A bottle that no arm reaches is left where it is. If none is within reach, the arms stay where they are.
    """

    images = ()
    wants = (OBJECTS,)
    execute = 1000  # a chunk is a whole motion

    def __init__(self) -> None:
        self._arms = {side: Kinematics(_SIMILAR_RIG, side, site="grasp_site") for side in SIDES}
        self._tries: dict[str, int] = {}

    def set_scene(self, scene: PutBottles) -> None:
        """Set the scene whose arms are moved."""
        self._scene = scene
        self._home = scene.joints.copy()

    def reset(self) -> None:
        """Forget which bottles were tried."""
        self._tries = dict.fromkeys(BOTTLES, 0)

    def __call__(self, observation: Observation) -> Mapping[str, Any]:
        """Return the chunk that puts the next bottle into the bin."""
        command = np.asarray(observation["joints"]).reshape(len(SIDES), 7)
        T_bin = observation[f"T_{BIN}_in_world"]
        outside = [name for name, inside in zip(BOTTLES, self._scene.in_bin(), strict=True) if not inside]
        for name in sorted(outside, key=lambda name: self._tries[name]):
            self._tries[name] += 1
            T_bottle = observation[f"T_{name}_in_world"]
            # Cap first if possible. Another try of the bottle prefers the other way.
            turns = (0.0, math.pi) if self._tries[name] % 2 else (math.pi, 0.0)
            for turn, arm in itertools.product(turns, self._arms_by_distance(T_bottle)):
                try:
                    path = list(self._plan(arm, T_bottle, turn, T_bin))
                except OutOfReachError:
                    continue
                return {"ctrl": interpolate(command, arm, path), "period": 1 / POLICY_HZ}
        return {"ctrl": np.tile(command.ravel(), (POLICY_HZ, 1)), "period": 1 / POLICY_HZ}

    def _arms_by_distance(self, T_bottle: Array) -> list[int]:
        bases = [self._scene.base_pose(side)[:2, 3] for side in SIDES]
        return sorted(range(len(SIDES)), key=lambda arm: float(np.linalg.norm(bases[arm] - T_bottle[:2, 3])))

    def _plan(self, arm: int, T_bottle: Array, turn: float, T_bin: Array) -> Iterator[Waypoint]:
        """Yield the waypoints of an arm to a bottle, the bin and its home posture. Raise OutOfReachError.

        `turn`, rad, is the turn of the hand about its approach: 0 for cap first into the bin, pi for foot first.
        """
        home = self._home[arm, :6]
        T_grasp = grasp_pose(T_bottle)
        T_grasp[:3, :3] = T_grasp[:3, :3] @ rotation_z(turn)
        T_above = T_grasp.copy()
        T_above[2, 3] += _CLEARANCE
        above = self._solve(arm, T_above, home)
        # The hand may tilt, and keeps its orientation on the way down.
        T_grasp[:3, :3] = self._scene.hand_pose_at(arm, above)[:3, :3]
        grasp = self._solve(arm, T_grasp, above)
        base = self._scene.base_pose(SIDES[arm])
        heading = math.atan2(*(T_bin[:2, 3] - base[:2, 3])[::-1])
        T_drop = pose(T_bin[:3, 3] + [0.0, 0.0, _DROP_HEIGHT], rotation_z(heading) @ _FORWARD)
        drop = self._solve(arm, T_drop, home)
        yield Waypoint(above, GRIPPER_OPENING, _JOINT_SPEED)
        yield Waypoint(grasp, GRIPPER_OPENING, _SLOW_JOINT_SPEED, _SETTLE_ACTIONS)
        yield Waypoint(grasp, 0.0, _JOINT_SPEED)
        yield Waypoint(above, 0.0, _SLOW_JOINT_SPEED)
        yield Waypoint(home, 0.0, _JOINT_SPEED)
        yield Waypoint(drop, 0.0, _JOINT_SPEED, _SETTLE_ACTIONS)
        yield Waypoint(drop, GRIPPER_OPENING, _JOINT_SPEED)
        yield Waypoint(home, GRIPPER_OPENING, _JOINT_SPEED)

    def _solve(self, arm: int, T_hand: Array, start: Array) -> Array:
        """Return joints (6,) that bring an arm's `grasp_site` to a pose in `world`. Raise OutOfReachError."""
        solver = self._arms[SIDES[arm]]
        T_world_in_base = invert_pose(self._scene.base_pose(SIDES[arm]))
        T, joints = T_hand.copy(), start
        for _ in range(_CORRECTIONS):
            joints = solver.ik(T_world_in_base @ T, joints, position_tolerance=5e-3, rotation_tolerance=_MAX_TILT)
            T[:3, 3] += T_hand[:3, 3] - self._scene.hand_pose_at(arm, joints)[:3, 3]
        return joints


def interpolate(command: Array, arm: int, path: list[Waypoint]) -> Array:
    """Return commands (actions, 14) along the waypoints of an arm; the other arm holds its place."""
    rows = [command.copy()]
    for waypoint in path:
        first, last = rows[-1].copy(), rows[-1].copy()
        last[arm] = [*waypoint.joints, waypoint.opening]
        farthest = float(np.abs(last[arm, :6] - first[arm, :6]).max())
        fingers = _FINGER_ACTIONS if last[arm, 6] != first[arm, 6] else 0
        n = max(fingers, math.ceil(farthest / waypoint.speed * POLICY_HZ), 1)
        shares = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, n + 1) / n)
        rows += [first + share * (last - first) for share in shares] + [last] * waypoint.settle
    return np.array(rows[1:]).reshape(len(rows) - 1, -1)


def grasp_pose(T_bottle: Array) -> Array:
    """Return the pose of `grasp_site` for a grasp from above, x towards the cap of a lying bottle."""
    axis = T_bottle[:3, 2]  # from the foot to the cap
    along = np.array([axis[0], axis[1], 0.0])
    length = float(np.linalg.norm(along))
    along = along / length if length > 0.1 else np.array([1.0, 0.0, 0.0])  # a standing bottle has no heading
    down = np.array([0.0, 0.0, -1.0])
    point = T_bottle[:3, 3] + _GRASP_ALONG_BOTTLE * axis - [0.0, 0.0, _GRASP_DEPTH]
    return pose(point, np.column_stack([along, np.cross(down, along), down]))
