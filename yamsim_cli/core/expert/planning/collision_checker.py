from __future__ import annotations

import copy
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...config.goals.world import TABLE
from ...errors import SimulationError
from ...geometry.se3 import Array, pose, quat_from_rotation
from ...scene.compiled import ArmAddresses, Ids

_ARM_DISTANCE = 0.004  # m that an arm keeps from everything else
_OBJECT_DISTANCE = 0.003  # m that an object keeps from everything else
_FINGER_DEPTH = 5e-4  # m that fingers may penetrate a grasped object: contacts are soft in physics

_DESCENT_STEP = 0.004  # m, of the search for a resting height
_DESCENT_BISECTIONS = 6  # of the last step of that search

_LATERAL_STEP = 0.002  # m, of the search in `free_distance`
_MIN_SUPPORT_NORMAL = 0.7  # vertical component of a contact's normal above which the contact is with the support

# Two geoms collide if the type of one and the affinity of the other have a common bit. A body has the bits of all its
# geoms.
_COLLISION_MASK_FIELDS = ("geom_contype", "geom_conaffinity", "body_contype", "body_conaffinity")
_MAX_KINDS = 31  # pairs of contype and conaffinity, each a bit of MuJoCo's signed masks of 32 bits


@dataclass(frozen=True)
class AttachedObject:
    """A held object, and the names of objects, or `TABLE`, that it may touch."""

    thing: str
    T_thing_in_pinch: Array
    allowed_contacts: Collection[str] = field(default=())


class CollisionChecker:
    """Checks for contacts of a moved arm or object, in a copy of an otherwise static scene.

    `fingers` are the geoms of each arm's fingers. The bodies `absent` are no obstacles: distractors, which are placed
    after planning.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        arms: Sequence[ArmAddresses],
        things: Sequence[str],
        fingers: Sequence[Ids],
        absent: Sequence[str] = (),
    ) -> None:
        self._model = copy.copy(model)
        self._data = mujoco.MjData(self._model)
        self._arms, self._object_names = arms, tuple(things)
        root = model.body_rootid[model.geom_bodyid]
        self._arm_of = np.full(model.ngeom, -1)
        for k, arm in enumerate(arms):
            self._arm_of[root == model.body_rootid[model.body(arm.flange).id]] = k
        self._object_of_geom = np.full(model.ngeom, -1)
        for k, name in enumerate(things):
            self._object_of_geom[root == model.body(name).id] = k
        self._finger = np.isin(np.arange(model.ngeom), np.concatenate(list(fingers)))
        self._table = np.arange(model.ngeom) == model.geom(TABLE).id
        self._model.flex_contype[:] = self._model.flex_conaffinity[:] = self._model.flex_selfcollide[:] = 0
        away = np.isin(root, [model.body(name).id for name in absent])
        self._model.geom_contype[away] = self._model.geom_conaffinity[away] = 0
        self._model.geom_margin[self._arm_of >= 0] = _ARM_DISTANCE
        self._model.geom_margin[self._object_of_geom >= 0] = _OBJECT_DISTANCE
        self._solid = self._model.geom_contype != 0
        # The arm and the object that move in the model now, and cached masks for each such pair.
        self._moving: tuple[int | None, str | None] = (None, None)
        self._masks: dict[tuple[int | None, str | None], list[NDArray[np.int_]]] = {
            (None, None): [getattr(self._model, name).copy() for name in _COLLISION_MASK_FIELDS]
        }

    def find_contact(
        self,
        qpos: Array,
        arm: int,
        joints: Array,
        opening: float,
        attached: AttachedObject | None = None,
        grasped: str | None = None,
        finger_clearance: float | None = None,
    ) -> str | None:
        """Return the names of two geoms that are too near to each other.

        Args:
            qpos: MuJoCo's positions (nq,) of everything else.
            joints: (dof,) of the arm, rad.
            opening: of one finger, m.
            grasped: an object between the fingers, which the fingers may touch.
            finger_clearance: least distance of the fingers from everything else, m; by default the arm's clearance.
        """
        data = self._set_configuration(qpos, arm, joints, opening, attached)
        self._update_contacts(arm, None if attached is None else attached.thing)
        if not data.ncon:
            return None
        geoms = data.contact.geom
        near = self._mask_forbidden_contacts(geoms, data.contact.dist, arm, attached, grasped, finger_clearance)
        if not near.any():
            return None
        one, other = (self._model.geom(int(geom)).name for geom in geoms[near][0])
        return f"{one} and {other}"

    def has_self_collision(self, arm: int, joints: Array) -> bool:
        """Return whether an arm's links, except the fingers, collide at joints (dof,), rad."""
        data = self._set_configuration(self._data.qpos, arm, joints, 0.0, None)
        self._update_contacts(None, None)
        of_arm = (self._arm_of[data.contact.geom] == arm) & ~self._finger[data.contact.geom]
        return bool((of_arm.all(axis=1) & (data.contact.dist < 0)).any())

    def qpos_with_arm(
        self, qpos: Array, arm: int, joints: Array, opening: float, attached: AttachedObject | None = None
    ) -> Array:
        """Return `qpos` (nq,) with an arm, its fingers (`opening`, m) and its attached object moved."""
        positions: Array = self._set_configuration(qpos, arm, joints, opening, attached).qpos.copy()
        return positions

    def rest_height(self, qpos: Array, thing: str, T_in_world: Array, lowest: float) -> float:
        """Lower an object from a pose, and return its height in `world` at the first contact, else `lowest`, m."""
        data, address = self._data, int(self._model.joint(thing).qposadr[0])
        data.qpos[:] = qpos
        data.qpos[address : address + 2] = T_in_world[:2, 3]
        data.qpos[address + 3 : address + 7] = quat_from_rotation(T_in_world[:3, :3])

        def is_in_contact_at(height: float) -> bool:
            data.qpos[address + 2] = height
            mujoco.mj_kinematics(self._model, data)
            self._update_contacts(None, thing)
            return bool((data.contact.dist < 0).any())

        high = float(T_in_world[2, 3])
        data.qpos[address + 2] = high
        mujoco.mj_kinematics(self._model, data)
        free = high - self._clearance_below(data, thing)
        while high - _DESCENT_STEP > free or not is_in_contact_at(high - _DESCENT_STEP):
            high -= _DESCENT_STEP
            if high < lowest:
                return lowest
        low = high - _DESCENT_STEP
        for _ in range(_DESCENT_BISECTIONS):
            middle = (low + high) / 2
            low, high = (middle, high) if is_in_contact_at(middle) else (low, middle)
        return high

    def free_distance(self, qpos: Array, thing: str, direction: Array, maximum: float) -> float:
        """Return how far an object can move in a horizontal direction (2,) before a contact, at most `maximum`, m."""
        data, address = self._data, int(self._model.joint(thing).qposadr[0])
        step = direction / np.linalg.norm(direction) * _LATERAL_STEP
        data.qpos[:] = qpos
        for count in range(math.ceil(maximum / _LATERAL_STEP)):
            data.qpos[address : address + 2] += step
            mujoco.mj_kinematics(self._model, data)
            self._update_contacts(None, thing)
            if ((data.contact.dist < 0) & (np.abs(data.contact.frame[:, 2]) < _MIN_SUPPORT_NORMAL)).any():
                return count * _LATERAL_STEP
        return maximum

    def _clearance_below(self, data: mujoco.MjData, thing: str) -> float:
        """Return a lower bound of the distance by which an object can be lowered, m, from bounding boxes."""
        low, high = _bounding_boxes(self._model, data)
        of_thing = self._object_of_geom == self._object_names.index(thing)
        mine = np.flatnonzero(self._solid & of_thing)
        others = np.flatnonzero(self._solid & ~of_thing & (self._arm_of < 0))
        under = ((low[mine, None, :2] < high[None, others, :2]) & (high[mine, None, :2] > low[None, others, :2])).all(2)
        gaps = low[mine, None, 2] - high[None, others, 2]
        return float(gaps[under].min(initial=np.inf))

    def _update_contacts(self, arm: int | None, thing: str | None) -> None:
        """Update the contacts between moving and static geoms, without those within either group.

        Without a moving arm, all arms are left out; with no moving object either, nothing is left out.
        """
        if self._moving != (arm, thing):
            self._moving = arm, thing
            if self._moving not in self._masks:
                self._masks[self._moving] = self._collision_masks(arm, thing)
            for name, mask in zip(_COLLISION_MASK_FIELDS, self._masks[self._moving], strict=True):
                getattr(self._model, name)[:] = mask
        mujoco.mj_collision(self._model, self._data)

    def _collision_masks(self, arm: int | None, thing: str | None) -> list[NDArray[np.int_]]:
        """Return masks with which moving geoms collide with others only: they have types, the others affinities."""
        moves = np.zeros(self._model.ngeom, bool)
        if arm is not None:
            moves |= self._arm_of == arm
        if thing is not None:
            moves |= self._object_of_geom == self._object_names.index(thing)
        stays = ~moves if arm is not None else ~moves & (self._arm_of < 0)
        # Geoms with the same type and affinity in the scene share one bit.
        masks = np.column_stack(self._masks[None, None][:2])
        kinds, kind = np.unique(masks, axis=0, return_inverse=True)
        if len(kinds) > _MAX_KINDS:
            raise SimulationError(
                f"the scene's geoms have {len(kinds)} different pairs of contype and conaffinity; at most {_MAX_KINDS}"
            )
        bits = 1 << np.arange(len(kinds))
        collide = ((kinds[:, :1] & kinds[:, 1]) | (kinds[:, 1:] & kinds[:, 0])) != 0
        geoms = [np.where(moves, bits[kind.ravel()], 0), np.where(stays, (collide @ bits)[kind.ravel()], 0)]
        bodies = [np.zeros(self._model.nbody, int) for _ in geoms]
        for of_body, of_geom in zip(bodies, geoms, strict=True):
            np.bitwise_or.at(of_body, self._model.geom_bodyid, of_geom)
        return geoms + bodies

    def _set_configuration(
        self, qpos: Array, arm: int, joints: Array, opening: float, attached: AttachedObject | None
    ) -> mujoco.MjData:
        data, moving = self._data, self._arms[arm]
        data.qpos[:] = qpos
        data.qpos[moving.joint_qpos] = joints
        if moving.fingers is not None:
            data.qpos[moving.fingers.qpos] = opening * moving.fingers.sign
        mujoco.mj_kinematics(self._model, data)
        if attached is not None:
            site = data.site(f"{moving.prefix}pinch_site")
            T = pose(site.xpos, site.xmat.reshape(3, 3)) @ attached.T_thing_in_pinch
            address = self._model.joint(attached.thing).qposadr[0]
            data.qpos[address : address + 3] = T[:3, 3]
            data.qpos[address + 3 : address + 7] = quat_from_rotation(T[:3, :3])
            mujoco.mj_kinematics(self._model, data)
        return data

    def _mask_forbidden_contacts(
        self,
        geoms: Array,
        distances: Array,
        arm: int,
        attached: AttachedObject | None,
        grasped: str | None,
        finger_clearance: float | None,
    ) -> Array:
        of_arm, of_thing = self._arm_of[geoms] == arm, self._object_of_geom[geoms]
        of_load = np.zeros_like(of_arm) if attached is None else of_thing == self._object_names.index(attached.thing)
        counts = np.ones(len(geoms), bool)
        for name in attached.allowed_contacts if attached else ():
            other = self._table[geoms] if name == TABLE else of_thing == self._object_names.index(name)
            counts &= ~(of_load.any(axis=1) & other.any(axis=1))
        if grasped is not None or finger_clearance is not None:
            fingers = (of_arm & self._finger[geoms]).any(axis=1)
        if grasped is not None:
            around = fingers & (of_thing == self._object_names.index(grasped)).any(axis=1)
            counts &= ~(around & (distances > -_FINGER_DEPTH))
        if finger_clearance is not None:
            counts &= ~(fingers & (distances > finger_clearance))
        found: Array = counts
        return found


def _bounding_boxes(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array]:
    R = data.geom_xmat.reshape(-1, 3, 3)
    middle = data.geom_xpos + np.einsum("gij,gj->gi", R, model.geom_aabb[:, :3])
    reach = np.einsum("gij,gj->gi", np.abs(R), model.geom_aabb[:, 3:])
    return middle - reach, middle + reach
