"""Cloth in motion: where it is, and how hands hold it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..geometry.se3 import Array, pose, rotation_z
from ..geometry.sheets import between, crossings, nearest_of_layers
from ..scene.cloth import edges, triangles
from ..scene.compiled import CompiledScene, Kind, SceneCloth
from .settle import settle

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


# What is led weighs so much, kg. MuJoCo finds how all points move together: a point that weighs a tenth of a gramme
# would come back to the rest of the cloth instead of taking that along, and cloth would stretch tenfold.
_HEAVY = 1.0


@contextmanager
def led(
    model: mujoco.MjModel, data: mujoco.MjData, cloth: SceneCloth, points: NDArray[np.int_]
) -> Iterator[Callable[[Array], None]]:
    """Lead points of a cloth, by their numbers (n,): each call of what is yielded makes a step of physics, after which
    they are where it says (n, 3), in `world`, m.

    Their masses in the model are others meanwhile.
    """
    dof = cloth.dof[points]
    bodies = model.dof_bodyid[dof[:, 0]]
    masses, inertias = model.body_mass[bodies].copy(), model.dof_M0[dof].copy()

    def step(at: Array) -> None:
        qpos = at - cloth.rest[points]
        data.qvel[dof] = (qpos - data.qpos[cloth.qpos[points]]) / model.opt.timestep
        mujoco.mj_step(model, data)
        data.qpos[cloth.qpos[points]] = qpos

    try:
        model.body_mass[bodies], model.dof_M0[dof] = _HEAVY, _HEAVY
        yield step
    finally:
        model.body_mass[bodies], model.dof_M0[dof] = masses, inertias


# What lifts a point of cloth moves so fast, m/s, and so high at least: by the smaller one of so many m, and so much of
# the cloth's half diagonal. It misses the way to the middle by so much at most, rad.
_SPEED = 0.3
_LOWEST, _OF_SMALL = 0.08, 0.3
_ASIDE = 0.5

# Fabric does not pass through itself, nor into what it lies on. Cloth that does after it was dropped, by this share of
# its thickness, or that is not as high as so many layers, is taken anew, so often at most.
_TRIES = 40
_SUNK = 0.5
_CRUMPLED = 4.0

# Crumpled cloth goes on sinking for so many times as long as other things take to come to rest, at most.
_SETTLINGS = 3


def crumpled(
    scene: CompiledScene, start: Array, cloth: str, rng: np.random.Generator, share: float, timestep: float
) -> Array:
    """MuJoCo's positions (nq,) with a cloth at rest that was taken at a point of its outer half, lifted, brought about
    towards its middle, let down half-way, and dropped; anew until it lies as crumpled fabric can.

    Args:
        start: MuJoCo's positions (nq,), in which the cloth lies flat.
        rng: chooses the point, and the way.
        share: how high it is lifted, of the cloth's half diagonal; it is brought by twice that share of the way.
        timestep: of physics, s.
    """
    lying = scene.cloths[cloth]
    ends, corners = edges(*lying.grid), triangles(*lying.grid)
    lowest = float(lying.points(start)[:, 2].min()) - _SUNK * lying.thickness
    faults: list[int] = []
    tried: list[Array] = []
    while len(tried) < _TRIES and 0 not in faults:
        tried.append(_dropped(scene, start, lying, rng, share, timestep))
        points = lying.points(tried[-1])
        low = float(np.ptp(points[:, 2])) < (_CRUMPLED - 1) * lying.thickness
        faults.append(crossings(points, ends, corners) + low + int((points[:, 2] < lowest).sum()))
    return tried[int(np.argmin(faults))]


def _dropped(
    scene: CompiledScene, start: Array, lying: SceneCloth, rng: np.random.Generator, share: float, timestep: float
) -> Array:
    """The same, once, however it lies."""
    points = lying.points(start)
    middle = points.mean(axis=0)
    away = np.linalg.norm(points - middle, axis=1)
    k = int(rng.choice(np.flatnonzero(away > 0.5 * away.max())))
    heading = rng.uniform(-_ASIDE, _ASIDE)
    across = 2 * share * rotation_z(heading)[:2, :2] @ (middle - points[k])[:2]
    up = max(min(_LOWEST, _OF_SMALL * float(away.max())), share * float(away.max()))
    ways = [np.array([0.0, 0.0, up]), np.array([*across, 0.0]), np.array([0.0, 0.0, -up / 2])]
    data = mujoco.MjData(scene.model)
    scene.reset(data, start)
    at = points[[k]]
    with led(scene.model, data, lying, np.array([k])) as lead:
        for way in ways:
            steps = max(1, int(np.linalg.norm(way) / _SPEED / timestep))
            for _ in range(steps):
                at = at + way / steps
                lead(at)
    dropped = start.copy()
    dropped[lying.qpos] = data.qpos[lying.qpos]
    for _ in range(_SETTLINGS):
        dropped = settle(scene, dropped, timestep)
    return dropped


# What is let go comes to rest for so long, s.
_REST = 0.5


def pulled(
    data: mujoco.MjData,
    model: mujoco.MjModel,
    cloth: SceneCloth,
    patches: Sequence[NDArray[np.int_]],
    ways: Sequence[Array],
    arch: float,
    seconds: float,
) -> Array:
    """Where a cloth's points (along y, along x, 3) would be in `world` if patches of it were taken elsewhere, m.

    Args:
        data: as everything is now; it stays so.
        patches: the numbers (n,) of the points that each hand holds.
        ways: where to each patch is brought from where it is (3,), m.
        arch: how high it is lifted between, as a share of the way.
        seconds: how long that takes.
    """
    imagined = mujoco.MjData(model)
    mujoco.mj_copyData(imagined, model, data)
    points = np.concatenate(patches)
    way = np.concatenate([np.tile(way, (len(patch), 1)) for patch, way in zip(patches, ways, strict=True)])
    up = np.array([0.0, 0.0, arch * float(np.linalg.norm(way[:, :2], axis=1).max())])
    start, timestep = cloth.points(imagined.qpos)[points], model.opt.timestep
    steps = max(1, math.ceil(seconds / timestep))
    with led(model, imagined, cloth, points) as lead:
        for step in range(1, steps + 1):
            share = (1 - math.cos(math.pi * step / steps)) / 2
            lead(start + share * way + math.sin(math.pi * share) * up)
    for _ in range(math.ceil(_REST / timestep)):
        mujoco.mj_step(model, imagined)
    columns, rows = cloth.grid
    return cloth.points(imagined.qpos).reshape(rows, columns, 3)
