"""The state of simulated cloth, grips of hands on it, and simulations of cloth whose points move on given paths."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..geometry.cloth_contacts import count_self_intersections, mask_between_pads, nearest_per_layer
from ..geometry.se3 import Array, pose, rotation_z
from ..scene.cloth import grid_edges, grid_triangles
from ..scene.compiled import ClothAddresses, CompiledScene, GeomOwner
from .settling import settle_objects

_CLOSED_OPENING = 0.006  # m, largest opening of each finger at which a hand grips cloth
_MIN_FORCE = 2.0  # N, least force of each finger at which a hand grips cloth
_RELEASE_OPENING = 0.002  # m, by which a commanded opening must exceed the present one for a release

_PAD_WIDTH = 0.0072  # m, half the width of a pad
_PAD_LENGTH = 0.0082  # m, half the length of a pad
_BELOW_TIPS = 0.002  # m, distance from the tips, beyond the cloth's thickness, of cloth that closing tips still grip

# m; x and y in the pinch frame of the lines, in the middle and at the edges of a pad, along which layers are found.
_LINES = np.array([(0.0, 0.0), (-_PAD_WIDTH, 0.0), (_PAD_WIDTH, 0.0)])

_MOVED_MASS = 1.0  # kg, of points that `moving_points` moves, see there

_LIFT_SPEED = 0.3  # m/s, of the point at which cloth is lifted before it is dropped
_MIN_LIFT, _MIN_LIFT_SHARE = (
    0.08,
    0.3,
)  # m, and share of half the diagonal; the smaller one is the least height of a lift
_MAX_HEADING = 0.5  # rad, largest deviation of a lifted point's path from the direction to the middle

# Dropped cloth must look like crumpled fabric, which passes neither through itself nor into the table.
_MAX_DROPS = 40  # drops, of which the best is used if none is without fault
_SUNK = 0.5  # thicknesses, depth at which a point counts as sunk into what the cloth lies on
_MIN_CRUMPLED = 4.0  # layers, least height of crumpled cloth
_SETTLINGS = 3  # runs of `settle` after a drop: crumpled cloth sinks for longer than other things take to come to rest

_REST_SECONDS = 0.5  # s, simulated after the points of a pull are released


class ClothState:
    """The present state of a cloth.

    Args:
        cloth: addresses of the points in MuJoCo's arrays.
        data: MuJoCo's state.
    """

    def __init__(self, cloth: ClothAddresses, data: mujoco.MjData) -> None:
        self._cloth, self._data = cloth, data

    @property
    def addresses(self) -> ClothAddresses:
        """The addresses of the points in MuJoCo's arrays."""
        return self._cloth

    @property
    def points(self) -> Array:
        """Positions (n, 3) of the points in `world`, m."""
        return self._cloth.points(self._data.qpos)

    @property
    def rows(self) -> Array:
        """Positions (along y, along x, 3) of the points in `world`, m, by rows along the cloth's x axis."""
        columns, rows = self._cloth.grid
        return self.points.reshape(rows, columns, 3)

    @property
    def pose(self) -> Array:
        """Pose (4, 4) in `world` of an upright frame in the middle of the points, turned about z as the points are."""
        return self._cloth.pose(self._data.qpos)

    @property
    def aabb(self) -> tuple[Array, Array]:
        """The lowest and highest corner (3,) of the cloth's bounding box along the axes of `world`, m."""
        points, radius = self.points, self._cloth.radius
        return points.min(axis=0) - radius, points.max(axis=0) + radius

    @property
    def local_box(self) -> Array:
        """The lowest and highest corner (2, 3) of the bounding box of the flat cloth in the cloth's frame, m."""
        rest, radius = self._cloth.rest, self._cloth.radius
        return np.array([rest.min(axis=0) - radius, rest.max(axis=0) + radius])

    @property
    def speed(self) -> float:
        """The speed of the fastest point, m/s."""
        return float(np.linalg.norm(self._data.qvel[self._cloth.dof], axis=1).max())

    @property
    def contacts(self) -> NDArray[np.bool_]:
        """Which sides of the present contacts are this cloth (n, 2)."""
        found: NDArray[np.bool_] = self._data.contact.flex == self._cloth.flex
        return found

    def held(self, arm: int) -> bool:
        """Whether an arm's hand holds a point of the cloth."""
        return bool(self._data.eq_active[self._cloth.grips[arm]].any())


class ClothGrips:
    """Switches the constraints with which hands hold cloth, since friction does not hold a grid of points.

    A hand whose closed fingers both touch a cloth and press grips every point between the pads. The hand releases the
    cloth when its fingers are commanded to open.
    """

    def __init__(self, scene: CompiledScene) -> None:
        self._scene = scene
        kinds = (GeomOwner.LEFT_FINGER, GeomOwner.RIGHT_FINGER)
        self._fingers = [
            tuple(np.flatnonzero((scene.geom_arm == k) & (scene.geom_kind == kind)) for kind in kinds)
            for k in range(len(scene.arms))
        ]

    def update(self, data: mujoco.MjData, ctrl: Array) -> list[bool]:
        """Switch the constraints for the next commands `ctrl` (nu,), and return whether each arm's hand holds cloth.

        Args:
            data: with the present poses and contacts. The constraints are switched in `data`, and their anchors are
                written into the scene's model.
        """
        return [self._update_hand(data, number, ctrl) for number in range(len(self._scene.arms))]

    def _update_hand(self, data: mujoco.MjData, number: int, ctrl: Array) -> bool:
        fingers = self._scene.arms[number].fingers
        if fingers is None:
            return False
        opening = float(data.qpos[fingers.qpos[0]] * fingers.sign[0])
        commanded = float(ctrl[fingers.ctrl])
        held = [cloth for cloth in self._scene.cloths.values() if data.eq_active[cloth.grips[number]].any()]
        if held:
            if commanded <= opening + _RELEASE_OPENING:
                return True
            for cloth in held:
                data.eq_active[cloth.grips[number]] = False
            return False
        if opening > _CLOSED_OPENING or (opening - commanded) * fingers.gain < 2 * _MIN_FORCE:
            return False
        return any(self._grip(data, number, cloth) for cloth in self._scene.cloths.values())

    def _grip(self, data: mujoco.MjData, number: int, cloth: ClothAddresses) -> bool:
        touching = (data.contact.flex == cloth.flex).any(axis=1)
        geoms = data.contact.geom[touching]
        if not all(np.isin(geoms, finger).any() for finger in self._fingers[number]):
            return False
        arm = self._scene.arms[number]
        points = cloth.points(data.qpos)
        site = data.site(f"{arm.prefix}pinch_site")
        gripped = points_between_pads(cloth, points, pose(site.xpos, site.xmat.reshape(3, 3)))
        hand = data.body(arm.flange)
        for k in gripped:
            # Anchors: the point's origin, and the same place in the hand's frame.
            there = hand.xmat.reshape(3, 3).T @ (points[k] - hand.xpos)
            self._scene.model.eq_data[cloth.grips[number, k], :6] = [0.0, 0.0, 0.0, *there]
            data.eq_active[cloth.grips[number, k]] = True
        return len(gripped) > 0


def points_between_pads(cloth: ClothAddresses, points: Array, T_pinch_in_world: Array) -> NDArray[np.int_]:
    """The numbers of the points (n, 3) of a cloth that pads grip when they close at a pose (4, 4) of the pinch frame.

    A point between the pads is gripped. If points are farther apart than the pads are wide, a point is gripped that is
    nearer than its neighbours. Of a cloth that is held by layers, the nearest point of every layer that passes between
    the pads is gripped too.
    """
    seen = (points - T_pinch_in_world[:3, 3]) @ T_pinch_in_world[:3, :3]
    deep = (-_PAD_LENGTH, _PAD_LENGTH + cloth.thickness + _BELOW_TIPS)
    found = np.flatnonzero(mask_between_pads(seen, max(_PAD_WIDTH, cloth.spacing / 2), deep))
    if cloth.held_by_layers:
        found = np.union1d(found, nearest_per_layer(seen, grid_triangles(*cloth.grid), _LINES, deep))
    return found


@contextmanager
def moving_points(
    model: mujoco.MjModel, data: mujoco.MjData, cloth: ClothAddresses, points: NDArray[np.int_]
) -> Iterator[Callable[[Array], None]]:
    """Yield a function that makes a step of physics in which points of a cloth move to given positions (n, 3), m.

    The points have a larger mass in the model meanwhile. MuJoCo solves for all points together: a point of a tenth of a
    gramme would be drawn back to the cloth instead of taking the cloth along, and the cloth would stretch tenfold.

    Args:
        points: numbers (n,) of the points that move.
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
        model.body_mass[bodies], model.dof_M0[dof] = _MOVED_MASS, _MOVED_MASS
        yield step
    finally:
        model.body_mass[bodies], model.dof_M0[dof] = masses, inertias


def crumple(
    scene: CompiledScene, start: Array, cloth: str, rng: np.random.Generator, share: float, timestep: float
) -> Array:
    """MuJoCo's positions (nq,) with a crumpled cloth at rest.

    The cloth is lifted at a point of its outer half, moved roughly towards its middle, lowered to half the height, and
    dropped. Drops are repeated until the cloth lies as crumpled fabric can.

    Args:
        start: MuJoCo's positions (nq,), in which the cloth lies flat.
        rng: samples the point and the heading.
        share: height of the lift, as a share of the cloth's half diagonal; the point moves towards the middle by twice
            this share of its distance.
        timestep: of physics, s.
    """
    lying = scene.cloths[cloth]
    ends, corners = grid_edges(*lying.grid), grid_triangles(*lying.grid)
    lowest = float(lying.points(start)[:, 2].min()) - _SUNK * lying.thickness
    faults: list[int] = []
    tried: list[Array] = []
    while len(tried) < _MAX_DROPS and 0 not in faults:
        tried.append(_drop_cloth(scene, start, lying, rng, share, timestep))
        points = lying.points(tried[-1])
        low = float(np.ptp(points[:, 2])) < (_MIN_CRUMPLED - 1) * lying.thickness
        faults.append(count_self_intersections(points, ends, corners) + low + int((points[:, 2] < lowest).sum()))
    return tried[int(np.argmin(faults))]


def _drop_cloth(
    scene: CompiledScene, start: Array, lying: ClothAddresses, rng: np.random.Generator, share: float, timestep: float
) -> Array:
    """MuJoCo's positions (nq,) after one drop; see `crumpled`."""
    points = lying.points(start)
    middle = points.mean(axis=0)
    away = np.linalg.norm(points - middle, axis=1)
    k = int(rng.choice(np.flatnonzero(away > 0.5 * away.max())))
    heading = rng.uniform(-_MAX_HEADING, _MAX_HEADING)
    across = 2 * share * rotation_z(heading)[:2, :2] @ (middle - points[k])[:2]
    up = max(min(_MIN_LIFT, _MIN_LIFT_SHARE * float(away.max())), share * float(away.max()))
    paths = [np.array([0.0, 0.0, up]), np.array([*across, 0.0]), np.array([0.0, 0.0, -up / 2])]
    data = mujoco.MjData(scene.model)
    scene.reset(data, start)
    at = points[[k]]
    with moving_points(scene.model, data, lying, np.array([k])) as step_to:
        for path in paths:
            steps = max(1, int(np.linalg.norm(path) / _LIFT_SPEED / timestep))
            for _ in range(steps):
                at = at + path / steps
                step_to(at)
    dropped = start.copy()
    dropped[lying.qpos] = data.qpos[lying.qpos]
    for _ in range(_SETTLINGS):
        dropped = settle_objects(scene, dropped, timestep).qpos
    return dropped


def simulated_pull(
    data: mujoco.MjData,
    model: mujoco.MjModel,
    cloth: ClothAddresses,
    patches: Sequence[NDArray[np.int_]],
    paths: Sequence[Array],
    arch: float,
    seconds: float,
) -> Array:
    """A cloth's points (along y, along x, 3) in `world` after patches of the cloth are moved and released, m.

    Args:
        data: the present state, which is not changed.
        patches: the numbers (n,) of the points of each patch.
        paths: displacement (3,) of each patch, m.
        arch: height of the path, as a share of the longest horizontal displacement.
        seconds: duration of the motion.
    """
    imagined = mujoco.MjData(model)
    mujoco.mj_copyData(imagined, model, data)
    points = np.concatenate(patches)
    path = np.concatenate([np.tile(path, (len(patch), 1)) for patch, path in zip(patches, paths, strict=True)])
    up = np.array([0.0, 0.0, arch * float(np.linalg.norm(path[:, :2], axis=1).max())])
    start, timestep = cloth.points(imagined.qpos)[points], model.opt.timestep
    steps = max(1, math.ceil(seconds / timestep))
    with moving_points(model, imagined, cloth, points) as step_to:
        for step in range(1, steps + 1):
            share = (1 - math.cos(math.pi * step / steps)) / 2
            step_to(start + share * path + math.sin(math.pi * share) * up)
    for _ in range(math.ceil(_REST_SECONDS / timestep)):
        mujoco.mj_step(model, imagined)
    columns, rows = cloth.grid
    return cloth.points(imagined.qpos).reshape(rows, columns, 3)
