"""What an arm, and the thing in its hand, would touch at given joints, everything else standing where it stands."""

from __future__ import annotations

import copy
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np

from ..geometry.se3 import Array, pose, quat_from_rotation
from ..goals.world import TABLE
from ..scene.compiled import Ids, SceneArm

# How far an arm stays away from what it must not touch, and what it carries from everything else, m.
_ARM_DISTANCE = 0.004
_THING_DISTANCE = 0.003

# Fingers that close on a thing may come as near as this, and no nearer, m. Contacts are soft in physics.
_FINGER_DEPTH = 5e-4

# How a thing's way down is searched for what it meets: in steps of so much, m, the last one halved so often.
_DESCENT = 0.004
_HALVINGS = 6

# How a thing's way aside is searched, in steps of so much, m. What it lies on is below: there, the contact's normal
# points up or down by more than this, as a sine.
_ASIDE = 0.002
_LEVEL = 0.7


@dataclass(frozen=True)
class Load:
    """A thing in a hand.

    Attributes:
        thing: its name.
        T_thing_in_pinch: its pose (4, 4) in the pinch frame.
        may_touch: names of things, or `TABLE`, that it may touch on its way.
    """

    thing: str
    T_thing_in_pinch: Array
    may_touch: Collection[str] = field(default=())


class Obstacles:
    """Looks for contacts in a copy of a scene.

    Args:
        model: the compiled scene.
        things: names of the things in it.
        fingers: geoms of each arm's fingers, in the order of `arms`.
        absent: names of bodies that are no obstacles: distractors, which are placed once the motion is known.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        arms: Sequence[SceneArm],
        things: Sequence[str],
        fingers: Sequence[Ids],
        absent: Sequence[str] = (),
    ) -> None:
        self._model = copy.copy(model)
        self._data = mujoco.MjData(self._model)
        self._arms, self._things = arms, tuple(things)
        root = model.body_rootid[model.geom_bodyid]
        self._arm_of = np.full(model.ngeom, -1)
        for k, arm in enumerate(arms):
            self._arm_of[root == model.body_rootid[model.body(arm.flange).id]] = k
        self._thing_of = np.full(model.ngeom, -1)
        for k, name in enumerate(things):
            self._thing_of[root == model.body(name).id] = k
        self._finger = np.isin(np.arange(model.ngeom), np.concatenate(list(fingers)))
        self._table = np.arange(model.ngeom) == model.geom(TABLE).id
        # Cloth gives way to whatever comes.
        self._model.flex_contype[:] = self._model.flex_conaffinity[:] = self._model.flex_selfcollide[:] = 0
        away = np.isin(root, [model.body(name).id for name in absent])
        self._model.geom_contype[away] = self._model.geom_conaffinity[away] = 0
        self._model.geom_margin[self._arm_of >= 0] = _ARM_DISTANCE
        self._model.geom_margin[self._thing_of >= 0] = _THING_DISTANCE

    def touched(
        self,
        qpos: Array,
        arm: int,
        joints: Array,
        opening: float,
        load: Load | None = None,
        between: str | None = None,
        beside: float | None = None,
    ) -> str | None:
        """Names of two geoms that come too near each other; None if there are none.

        Args:
            qpos: MuJoCo's positions (nq,) of everything else.
            arm: which arm moves.
            joints: where it would be (dof,), rad.
            opening: of one of its fingers, m.
            load: what it carries.
            between: a thing that its fingers are around, which they may come near to.
            beside: how near its fingers may come to everything else, m; without, as near as the rest of the arm.
        """
        data = self._pose(qpos, arm, joints, opening, load)
        mujoco.mj_collision(self._model, data)
        if not data.ncon:
            return None
        geoms = data.contact.geom
        near = self._counts(geoms, data.contact.dist, arm, load, between, beside)
        if not near.any():
            return None
        one, other = (self._model.geom(int(geom)).name for geom in geoms[near][0])
        return f"{one} and {other}"

    def meets_itself(self, arm: int, joints: Array) -> bool:
        """Whether links of an arm run into each other at given joints (dof,), rad."""
        data = self._pose(self._data.qpos, arm, joints, 0.0, None)
        mujoco.mj_collision(self._model, data)
        of_arm = (self._arm_of[data.contact.geom] == arm) & ~self._finger[data.contact.geom]
        return bool((of_arm.all(axis=1) & (data.contact.dist < 0)).any())

    def posed(self, qpos: Array, arm: int, joints: Array, opening: float, load: Load | None = None) -> Array:
        """MuJoCo's positions (nq,) with an arm, and what it carries, elsewhere; see `touched`."""
        positions: Array = self._pose(qpos, arm, joints, opening, load).qpos.copy()
        return positions

    def rest_height(self, qpos: Array, thing: str, T_in_world: Array, lowest: float) -> float:
        """The height at which a thing that comes straight down at a pose (4, 4), and turned so, meets something, m.

        Args:
            lowest: where the search ends.
        """
        data, address = self._data, int(self._model.joint(thing).qposadr[0])
        data.qpos[:] = qpos
        data.qpos[address : address + 2] = T_in_world[:2, 3]
        data.qpos[address + 3 : address + 7] = quat_from_rotation(T_in_world[:3, :3])

        def meets(height: float) -> bool:
            data.qpos[address + 2] = height
            mujoco.mj_kinematics(self._model, data)
            mujoco.mj_collision(self._model, data)
            geoms = data.contact.geom
            of_thing = self._thing_of[geoms] == self._things.index(thing)
            of_arm = self._arm_of[geoms] >= 0
            touching = of_thing.any(axis=1) & ~of_thing.all(axis=1) & ~of_arm.any(axis=1)
            return bool((touching & (data.contact.dist < 0)).any())

        high = float(T_in_world[2, 3])
        data.qpos[address + 2] = high
        mujoco.mj_kinematics(self._model, data)
        free = high - self._drop(data, thing)
        while high - _DESCENT > free or not meets(high - _DESCENT):
            high -= _DESCENT
            if high < lowest:
                return lowest
        low = high - _DESCENT
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if meets(middle) else (low, middle)
        return high

    def room(self, qpos: Array, thing: str, direction: Array, most: float) -> float:
        """How far a thing can go along a direction (2,) over what it lies on before it meets something, m.

        Args:
            most: where the search ends.
        """
        data, address = self._data, int(self._model.joint(thing).qposadr[0])
        number, step = self._things.index(thing), direction / np.linalg.norm(direction) * _ASIDE
        data.qpos[:] = qpos
        for count in range(math.ceil(most / _ASIDE)):
            data.qpos[address : address + 2] += step
            mujoco.mj_kinematics(self._model, data)
            mujoco.mj_collision(self._model, data)
            geoms, normals = data.contact.geom, data.contact.frame[:, :3]
            of_thing, of_arm = self._thing_of[geoms] == number, self._arm_of[geoms] >= 0
            meets = of_thing.any(axis=1) & ~of_thing.all(axis=1) & ~of_arm.any(axis=1)
            if (meets & (data.contact.dist < 0) & (np.abs(normals[:, 2]) < _LEVEL)).any():
                return count * _ASIDE
        return most

    def _drop(self, data: mujoco.MjData, thing: str) -> float:
        """At least so far a thing can come down before the block around one of its geoms meets that of another, m."""
        low, high = _blocks(self._model, data)
        solid, of_thing = self._model.geom_contype != 0, self._thing_of == self._things.index(thing)
        mine, others = np.flatnonzero(solid & of_thing), np.flatnonzero(solid & ~of_thing & (self._arm_of < 0))
        under = ((low[mine, None, :2] < high[None, others, :2]) & (high[mine, None, :2] > low[None, others, :2])).all(2)
        gaps = low[mine, None, 2] - high[None, others, 2]
        return float(gaps[under].min(initial=np.inf))

    def _pose(self, qpos: Array, arm: int, joints: Array, opening: float, load: Load | None) -> mujoco.MjData:
        data, moving = self._data, self._arms[arm]
        data.qpos[:] = qpos
        data.qpos[moving.joint_qpos] = joints
        if moving.fingers is not None:
            data.qpos[moving.fingers.qpos] = opening * moving.fingers.sign
        mujoco.mj_kinematics(self._model, data)
        if load is not None:
            site = data.site(f"{moving.prefix}pinch_site")
            T = pose(site.xpos, site.xmat.reshape(3, 3)) @ load.T_thing_in_pinch
            address = self._model.joint(load.thing).qposadr[0]
            data.qpos[address : address + 3] = T[:3, 3]
            data.qpos[address + 3 : address + 7] = quat_from_rotation(T[:3, :3])
            mujoco.mj_kinematics(self._model, data)
        return data

    def _counts(
        self,
        geoms: Array,
        distances: Array,
        arm: int,
        load: Load | None,
        between: str | None,
        beside: float | None,
    ) -> Array:
        """Which contacts (n,) are of what moves with what it must not touch."""
        of_arm, of_thing = self._arm_of[geoms] == arm, self._thing_of[geoms]
        of_load = np.zeros_like(of_arm) if load is None else of_thing == self._things.index(load.thing)
        # Where both sides move with the hand nothing comes nearer: the model's own exclusions see to the arm's links.
        counts = (of_arm | of_load).any(axis=1) & ~(of_arm | of_load).all(axis=1)
        for name in load.may_touch if load else ():
            other = self._table[geoms] if name == TABLE else of_thing == self._things.index(name)
            counts &= ~(of_load.any(axis=1) & other.any(axis=1))
        fingers = (of_arm & self._finger[geoms]).any(axis=1)
        if between is not None:
            around = fingers & (of_thing == self._things.index(between)).any(axis=1)
            counts &= ~(around & (distances > -_FINGER_DEPTH))
        if beside is not None:
            counts &= ~(fingers & (distances > beside))
        found: Array = counts
        return found


def _blocks(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array]:
    """The lowest and the highest corners (ngeom, 3) in `world` of blocks along its axes that enclose the geoms."""
    R = data.geom_xmat.reshape(-1, 3, 3)
    middle = data.geom_xpos + np.einsum("gij,gj->gi", R, model.geom_aabb[:, :3])
    reach = np.einsum("gij,gj->gi", np.abs(R), model.geom_aabb[:, 3:])
    return middle - reach, middle + reach
