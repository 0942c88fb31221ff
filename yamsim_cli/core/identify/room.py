"""How far the joints of an arm may swing around a pose before anything comes too near."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..config.rig import RigConfig
from ..config.scene import SceneConfig
from ..errors import SimulationError
from ..geometry.se3 import Array
from ..resources import Locations
from ..scene.blueprint import Blueprint
from ..scene.compose import add_home_key, compose

# Nearest that the arm may come to the table and to another arm, and to itself, m. Boxes stand for its parts, which are
# larger.
_DISTANCE, _OWN_DISTANCE = 0.03, 0.003
# How far joints stay from their stops, rad.
_FROM_STOPS = 0.15
# No joint needs to swing farther than this to either side, rad.
_WIDEST = 0.9
# How many poses are tried as the middle, how many around each of them, and by how much what touches is made narrower.
_MIDDLES, _AROUND, _NARROWER = 60, 60, 0.85
_NARROWEST = 0.2


@dataclass(frozen=True)
class Box:
    """Joints around a pose: its middle (dof,) and how far they swing to either side (dof,), rad."""

    middle: Array
    half: Array


class Room:
    """A rig on its table, to be asked whether one of its arms touches anything.

    Args:
        number: of the arm, in the rig.
    """

    def __init__(self, rig: RigConfig, number: int, scene: SceneConfig, locations: Locations) -> None:
        arm = rig.arms[number]
        spec = compose(Blueprint(rig, scene.for_span(rig.span), boards=False, background=False), locations)
        model = add_home_key(spec, rig, {})
        self._model = copy.copy(model)
        self._data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, self._data, 0)
        joints = [model.joint(arm.prefix + name) for name in arm.robot.joint_names]
        self._qpos = np.array([joint.qposadr[0] for joint in joints])
        if arm.robot.fingers is not None:
            for name, sign in zip(arm.robot.fingers.joints, arm.robot.finger_signs, strict=True):
                self._data.qpos[model.joint(arm.prefix + name).qposadr[0]] = sign * arm.robot.fingers.opened
        mine = model.body_rootid[model.geom_bodyid] == model.body(arm.prefix + arm.robot.base).id
        moved = mine & (model.geom_bodyid != model.body(arm.prefix + arm.robot.base).id)
        self._moved, self._hand = moved, _of_hand(model, arm.prefix + arm.robot.flange)
        self._mine = mine
        self._model.geom_margin[:] = np.where(mine, _DISTANCE, 0.0)
        self.range = arm.robot.joint_range
        self.name = arm.name

    def touches(self, joints: Array) -> bool:
        """Whether the arm comes too near to anything with its joints so (dof,)."""
        self._data.qpos[self._qpos] = joints
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_collision(self._model, self._data)
        geoms, distance = self._data.contact.geom, self._data.contact.dist
        near = distance < np.where(self._mine[geoms].all(axis=1), _OWN_DISTANCE, _DISTANCE)
        # A hand's parts are near each other wherever the arm is.
        return bool((near & self._moved[geoms].any(axis=1) & ~self._hand[geoms].all(axis=1)).any())

    def widest(self, rng: np.random.Generator) -> Box:
        """The box in which the arm touches nothing and the narrowest joint swings the farthest, of those tried.

        Raises:
            SimulationError: nothing wide enough was found.
        """
        low, high = self.range[:, 0] + _FROM_STOPS, self.range[:, 1] - _FROM_STOPS
        best: Box | None = None
        for _ in range(_MIDDLES):
            middle = rng.uniform(low + _NARROWEST, high - _NARROWEST)
            half = np.minimum(np.minimum(middle - low, high - middle), _WIDEST)
            box = self._clear(middle, half, rng)
            if box is not None and (best is None or _width(box) > _width(best)):
                best = box
        if best is None:
            raise SimulationError(
                f"{self.name}: no pose was found around which every joint may swing by {_NARROWEST} rad without coming "
                f"nearer than {1000 * _DISTANCE:g} mm to anything; give the arm more room"
            )
        return best

    def _clear(self, middle: Array, half: Array, rng: np.random.Generator) -> Box | None:
        sides = rng.uniform(-1, 1, (_AROUND, len(middle)))
        # Corners of the box, and what lies in between.
        sides[::2] = np.sign(sides[::2])
        while half.min() >= _NARROWEST:
            if not any(self.touches(middle + half * side) for side in sides):
                return Box(middle, half)
            half = half * _NARROWER
        return None


def _width(box: Box) -> float:
    return float(np.log(box.half).mean() + np.log(box.half.min()))


def _of_hand(model: mujoco.MjModel, flange: str) -> NDArray[np.bool_]:
    """Which geoms are of the flange or hang on it (ngeom,)."""
    found = np.zeros(model.nbody, bool)
    found[model.body(flange).id] = True
    for body in range(1, model.nbody):
        found[body] |= found[model.body_parentid[body]]
    geoms: NDArray[np.bool_] = found[model.geom_bodyid]
    return geoms
