"""Cloth in motion: where it is, and how hands hold it."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..geometry.se3 import Array, pose
from ..geometry.sheets import between, nearest_of_layers
from ..scene.cloth import triangles
from ..scene.compiled import CompiledScene, Kind, SceneCloth

# A hand takes cloth only with fingers that are closed so far, each, and that press at least so hard; it lets go once
# they are told to open by so much more than they are. m, N, m.
_CLOSED = 0.006
_PRESSING = 2.0
_OPENING = 0.002

# Half of how wide and how long a pad is, m. Cloth under the tips, which they press down, is so much farther from them
# at most than it is thick, m.
_PAD_WIDTH = 0.0072
_PAD_LENGTH = 0.0082
_UNDER = 0.002
# Where a layer goes through between pads, it is held: looked at in the middle, and at both sides of the pads, m.
_LINES = np.array([(0.0, 0.0), (-_PAD_WIDTH, 0.0), (_PAD_WIDTH, 0.0)])


class ClothState:
    """A cloth as it is now.

    Args:
        cloth: where its points lie in MuJoCo's arrays.
        data: MuJoCo's state.
    """

    def __init__(self, cloth: SceneCloth, data: mujoco.MjData) -> None:
        self._cloth, self._data = cloth, data

    @property
    def addresses(self) -> SceneCloth:
        """Where its points lie in MuJoCo's arrays."""
        return self._cloth

    @property
    def points(self) -> Array:
        """Where its points (n, 3) are in `world`, m."""
        return self._cloth.points(self._data.qpos)

    @property
    def rows(self) -> Array:
        """The same by rows along its x axis (along y, along x, 3)."""
        columns, rows = self._cloth.grid
        return self.points.reshape(rows, columns, 3)

    @property
    def pose(self) -> Array:
        """An upright frame (4, 4) in `world`: in the middle of its points, turned as these are on the whole."""
        return self._cloth.pose(self._data.qpos)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """The lowest and the highest corner (3,) of the block along the world's axes that encloses it."""
        points, radius = self.points, self._cloth.radius
        return points.min(axis=0) - radius, points.max(axis=0) + radius

    @property
    def block(self) -> Array:
        """The lowest and highest corner (2, 3) of the block that encloses it in its own frame when it is flat, m."""
        rest, radius = self._cloth.rest, self._cloth.radius
        return np.array([rest.min(axis=0) - radius, rest.max(axis=0) + radius])

    @property
    def speed(self) -> float:
        """Of its fastest point, m/s."""
        return float(np.linalg.norm(self._data.qvel[self._cloth.dof], axis=1).max())

    @property
    def contacts(self) -> NDArray[np.bool_]:
        """Which side of each present contact (n, 2) is this cloth."""
        found: NDArray[np.bool_] = self._data.contact.flex == self._cloth.flex
        return found

    def held(self, arm: int) -> bool:
        """Whether an arm's hand holds any of its points."""
        return bool(self._data.eq_active[self._cloth.grips[arm]].any())


class ClothGrips:
    """How hands take hold of cloth, and let it go: by a constraint, since friction does not hold a grid of points.

    A hand takes hold where both its fingers touch a cloth, are closed, and press: of each point of it that is between
    the pads. It lets go when its fingers are told to open.
    """

    def __init__(self, scene: CompiledScene) -> None:
        self._scene = scene
        kinds = (Kind.LEFT_FINGER, Kind.RIGHT_FINGER)
        self._fingers = [
            tuple(np.flatnonzero((scene.geom_arm == k) & (scene.geom_kind == kind)) for kind in kinds)
            for k in range(len(scene.arms))
        ]

    def update(self, data: mujoco.MjData, ctrl: Array) -> list[bool]:
        """Whether each arm's hand holds cloth while it is told `ctrl` (nu,) next.

        Args:
            data: with poses and contacts as they are now. What holds is switched in it, and where it holds is written
                into the scene's model.
        """
        return [self._hand(data, number, ctrl) for number in range(len(self._scene.arms))]

    def _hand(self, data: mujoco.MjData, number: int, ctrl: Array) -> bool:
        fingers = self._scene.arms[number].fingers
        if fingers is None:
            return False
        opening = float(data.qpos[fingers.qpos[0]] * fingers.sign[0])
        told = float(ctrl[fingers.ctrl])
        held = [cloth for cloth in self._scene.cloths.values() if data.eq_active[cloth.grips[number]].any()]
        if held:
            if told <= opening + _OPENING:
                return True
            for cloth in held:
                data.eq_active[cloth.grips[number]] = False
            return False
        if opening > _CLOSED or (opening - told) * fingers.gain < 2 * _PRESSING:
            return False
        return any(self._take(data, number, cloth) for cloth in self._scene.cloths.values())

    def _take(self, data: mujoco.MjData, number: int, cloth: SceneCloth) -> bool:
        touching = (data.contact.flex == cloth.flex).any(axis=1)
        geoms = data.contact.geom[touching]
        if not all(np.isin(geoms, finger).any() for finger in self._fingers[number]):
            return False
        arm = self._scene.arms[number]
        points = cloth.points(data.qpos)
        site = data.site(f"{arm.prefix}pinch_site")
        taken = between_pads(cloth, points, pose(site.xpos, site.xmat.reshape(3, 3)))
        hand = data.body(arm.flange)
        for k in taken:
            # The point's own origin, and where that is in the hand's frame.
            there = hand.xmat.reshape(3, 3).T @ (points[k] - hand.xpos)
            self._scene.model.eq_data[cloth.grips[number, k], :6] = [0.0, 0.0, 0.0, *there]
            data.eq_active[cloth.grips[number, k]] = True
        return len(taken) > 0


def between_pads(cloth: SceneCloth, points: Array, T_pinch_in_world: Array) -> NDArray[np.int_]:
    """The numbers of a cloth's points (n, 3) that a hand takes hold of whose pads close at a pose (4, 4): those between
    the pads. Where points are farther apart than the pads are wide, a point counts that is nearer than its neighbours.
    Of a cloth that is held by layers, the nearest point of every layer that goes through between the pads counts too.
    """
    seen = (points - T_pinch_in_world[:3, 3]) @ T_pinch_in_world[:3, :3]
    deep = (-_PAD_LENGTH, _PAD_LENGTH + cloth.thickness + _UNDER)
    found = np.flatnonzero(between(seen, max(_PAD_WIDTH, cloth.spacing / 2), deep))
    if cloth.by_layers:
        found = np.union1d(found, nearest_of_layers(seen, triangles(*cloth.grid), _LINES, deep))
    return found
