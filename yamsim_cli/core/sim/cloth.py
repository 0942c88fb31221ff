from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..geometry.cloth_contacts import count_self_intersections, mask_between_pads, nearest_point_per_layer
from ..geometry.se3 import Array, pose, rotation_z
from ..scene.cloth import grid_edges, grid_triangles
from ..scene.compiled import ClothAddresses, CompiledScene
from .settling import settle_objects

_CLOSED_OPENING = 0.006  # m, of each finger at which a hand grasps cloth
_MIN_FORCE = 2.0  # N, of each finger at which a hand grasps cloth
_RELEASE_OPENING = 0.002  # m, a hand releases cloth if its commanded opening exceeds the present one by more

# m, beyond the spacing of the points, from the pinch frame to the nearest point of cloth, at which fingers have left it
_AWAY_DISTANCE = 0.02

_PAD_WIDTH = 0.0072  # m, half
_PAD_LENGTH = 0.0082  # m, half
_REACH_BELOW_TIPS = 0.002  # m, reach of closing fingers beyond their tips, in addition to the cloth's thickness

# m, x and y of the lines along which layers are found, in the pinch frame.
_PAD_LINES = np.array([(0.0, 0.0), (-_PAD_WIDTH, 0.0), (_PAD_WIDTH, 0.0)])

_MOVED_POINT_MASS = 1.0  # kg, of each point while `moving_points` moves it, so that the cloth cannot pull it back

_LIFT_SPEED = 0.3  # m/s, of the point by which cloth is lifted before a drop
# A lift before a drop has at least the smaller of this height, m, and this share of half the cloth's diagonal.
_MIN_LIFT, _MIN_LIFT_SHARE = 0.08, 0.3
_MAX_HEADING = 0.5  # rad, from a lifted point's path to the direction to the cloth's middle

# Crumpled cloth must not pass through itself or into the table.
_MAX_DROPS = 40  # if all have faults (crossings, sunk points, too flat), the best is used
_MAX_SINK_LAYERS = 0.5  # thicknesses below the flat cloth, from which a point counts as sunk into its support
_MIN_CRUMPLED_HEIGHT_LAYERS = 4.0  # thicknesses of the cloth; below this height, a drop counts as too flat
_MAX_SETTLE_RUNS = 3  # runs of `settle_objects` after a drop; cloth takes longer to come to rest than other objects

_REST_SECONDS = 0.5  # after the points of a pull are released


class ClothState:
    """Read access to the present state of a cloth.

    Attributes:
        addresses: places of the cloth's points in MuJoCo's arrays.
    """

    def __init__(self, cloth: ClothAddresses, data: mujoco.MjData) -> None:
        self.addresses, self._data = cloth, data

    @property
    def points(self) -> Array:
        """Positions (n, 3) of the points in `world`, m."""
        return self.addresses.points(self._data.qpos)

    @property
    def point_grid(self) -> Array:
        """Positions (rows, columns, 3) of the points in `world`, m; rows run along the cloth's x axis."""
        columns, rows = self.addresses.grid
        return self.points.reshape(rows, columns, 3)

    @property
    def pose(self) -> Array:
        """See `ClothAddresses.pose`."""
        return self.addresses.pose(self._data.qpos)

    @property
    def aabb(self) -> tuple[Array, Array]:
        """Lowest and highest corner (3,) of the axis-aligned bounding box in `world`, m."""
        points, radius = self.points, self.addresses.half_thickness
        return points.min(axis=0) - radius, points.max(axis=0) + radius

    @property
    def local_box(self) -> Array:
        """Lowest and highest corner (2, 3) of the flat cloth's bounding box in the cloth's frame, m."""
        rest, radius = self.addresses.flat_points, self.addresses.half_thickness
        return np.array([rest.min(axis=0) - radius, rest.max(axis=0) + radius])

    @property
    def speed(self) -> float:
        """Speed of the fastest point, m/s."""
        return float(np.linalg.norm(self._data.qvel[self.addresses.dof], axis=1).max())

    @property
    def contact_sides(self) -> NDArray[np.bool_]:
        """Whether each of the two sides of each present contact is this cloth (n, 2)."""
        found: NDArray[np.bool_] = self._data.contact.flex == self.addresses.flex
        return found

    def is_held_by(self, arm: int) -> bool:
        """Return whether the hand of arm number `arm` holds a point of the cloth."""
        return bool(self._data.eq_active[self.addresses.constraints[arm]].any())


class ClothGraspConstraints:
    """Switches the constraints that hold cloth in hands, because friction does not hold a grid of points.

    A hand grasps every point between its pads when both fingers are closed, touch the cloth and press. The hand
    releases the cloth when its fingers are commanded to open. If the cloth is released clear, the contacts of these
    fingers with all cloth are then off, until the fingers are commanded to close or have left all cloth.
    """

    def __init__(self, scene: CompiledScene) -> None:
        self._scene = scene
        # For each hand that leaves released cloth, the largest commanded opening since the release, m.
        self._leaving: dict[int, float] = {}

    def update_grasps(self, data: mujoco.MjData, ctrl: Array) -> list[bool]:
        """Grasp or release cloth for the next commands `ctrl` (nu,), and return whether each arm's hand holds cloth.

        The constraints are switched in `data`; their anchors and the fingers' contact masks are written into the model.
        """
        return [self._update_hand(data, number, ctrl) for number in range(len(self._scene.arms))]

    def _update_hand(self, data: mujoco.MjData, number: int, ctrl: Array) -> bool:
        fingers = self._scene.arms[number].fingers
        if fingers is None:
            return False
        opening = float(data.qpos[fingers.qpos[0]] * fingers.sign[0])
        commanded = float(ctrl[fingers.ctrl])
        held = [cloth for cloth in self._scene.cloths.values() if data.eq_active[cloth.constraints[number]].any()]
        if held:
            if commanded <= opening + _RELEASE_OPENING:
                return True
            for cloth in held:
                data.eq_active[cloth.constraints[number]] = False
            if any(cloth.is_released_clear for cloth in held):
                self._leaving[number] = commanded
                self._scene.switch_cloth_contacts(number, on=False)
            return False
        if number in self._leaving:
            largest = self._leaving[number] = max(self._leaving[number], commanded)
            if commanded < largest - _RELEASE_OPENING or self._is_away(data, number):
                del self._leaving[number]
                self._scene.switch_cloth_contacts(number, on=True)
        if opening > _CLOSED_OPENING or (opening - commanded) * fingers.gain < 2 * _MIN_FORCE:
            return False
        return any(self._grasp_points(data, number, cloth) for cloth in self._scene.cloths.values())

    def _is_away(self, data: mujoco.MjData, number: int) -> bool:
        pinch = data.site(f"{self._scene.arms[number].prefix}pinch_site").xpos
        return all(
            np.linalg.norm(cloth.points(data.qpos) - pinch, axis=1).min() > _AWAY_DISTANCE + cloth.max_point_spacing
            for cloth in self._scene.cloths.values()
        )

    def _grasp_points(self, data: mujoco.MjData, number: int, cloth: ClothAddresses) -> bool:
        touching = (data.contact.flex == cloth.flex).any(axis=1)
        geoms = data.contact.geom[touching]
        if not all(np.isin(geoms, finger).any() for finger in self._scene.finger_geoms[number]):
            return False
        arm = self._scene.arms[number]
        points = cloth.points(data.qpos)
        site = data.site(f"{arm.prefix}pinch_site")
        gripped = points_between_pads(cloth, points, pose(site.xpos, site.xmat.reshape(3, 3)))
        hand = data.body(arm.flange)
        for k in gripped:
            # Anchors: the origin of the point's body, and the same position in the hand's frame.
            there = hand.xmat.reshape(3, 3).T @ (points[k] - hand.xpos)
            self._scene.model.eq_data[cloth.constraints[number, k], :6] = [0.0, 0.0, 0.0, *there]
            data.eq_active[cloth.constraints[number, k]] = True
        return len(gripped) > 0


def points_between_pads(cloth: ClothAddresses, points: Array, T_pinch_in_world: Array) -> NDArray[np.int_]:
    """Return the indices of the points (n, 3) of a cloth that pads grasp when they close at a pose of the pinch frame.

    The pads grasp all points between them. Where points are farther apart than the pads are wide, they grasp a point
    within half the spacing. If the cloth is held by layers, they also grasp the nearest point of each layer in between.
    """
    seen = (points - T_pinch_in_world[:3, 3]) @ T_pinch_in_world[:3, :3]
    deep = (-_PAD_LENGTH, _PAD_LENGTH + cloth.thickness + _REACH_BELOW_TIPS)
    found = np.flatnonzero(mask_between_pads(seen, max(_PAD_WIDTH, cloth.max_point_spacing / 2), deep))
    if cloth.held_by_layers:
        found = np.union1d(found, nearest_point_per_layer(seen, grid_triangles(*cloth.grid), _PAD_LINES, deep))
    return found


@contextmanager
def moving_points(
    model: mujoco.MjModel, data: mujoco.MjData, cloth: ClothAddresses, points: NDArray[np.int_]
) -> Iterator[Callable[[Array], None]]:
    """Yield a function that steps physics once and moves points of a cloth to positions (n, 3) in `world`, m.

    Within the context, the points have a larger mass in the model. MuJoCo solves for all points together: the cloth
    would pull back a point of 0.1 g instead of following it, and would stretch tenfold.
    """
    dof = cloth.dof[points]
    bodies = model.dof_bodyid[dof[:, 0]]
    masses, inertias = model.body_mass[bodies].copy(), model.dof_M0[dof].copy()

    def move_and_step(at: Array) -> None:
        qpos = at - cloth.flat_points[points]
        data.qvel[dof] = (qpos - data.qpos[cloth.qpos[points]]) / model.opt.timestep
        mujoco.mj_step(model, data)
        data.qpos[cloth.qpos[points]] = qpos

    try:
        model.body_mass[bodies], model.dof_M0[dof] = _MOVED_POINT_MASS, _MOVED_POINT_MASS
        yield move_and_step
    finally:
        model.body_mass[bodies], model.dof_M0[dof] = masses, inertias


def crumple_cloth(
    scene: CompiledScene, start: Array, cloth: str, rng: np.random.Generator, share: float, timestep: float
) -> Array:
    """Crumple a flat cloth, and return MuJoCo's positions (nq,) with the cloth at rest.

    The function lifts a point of the cloth's outer half, by `share` of half the diagonal, and moves it towards the
    middle by twice this share of its distance. Then it lowers the point to half the height and drops the cloth. Up to
    40 drops are tried, until the cloth is at least 4 layers high and passes neither through itself nor through the
    table.
    """
    sheet = scene.cloths[cloth]
    ends, corners = grid_edges(*sheet.grid), grid_triangles(*sheet.grid)
    lowest = float(sheet.points(start)[:, 2].min()) - _MAX_SINK_LAYERS * sheet.thickness
    faults: list[int] = []
    tried: list[Array] = []
    while len(tried) < _MAX_DROPS and 0 not in faults:
        tried.append(drop_cloth(scene, start, sheet, rng, share, timestep))
        points = sheet.points(tried[-1])
        low = float(np.ptp(points[:, 2])) < (_MIN_CRUMPLED_HEIGHT_LAYERS - 1) * sheet.thickness
        faults.append(count_self_intersections(points, ends, corners) + low + int((points[:, 2] < lowest).sum()))
    return tried[int(np.argmin(faults))]


def drop_cloth(
    scene: CompiledScene, start: Array, sheet: ClothAddresses, rng: np.random.Generator, share: float, timestep: float
) -> Array:
    """Return the positions (nq,) after a cloth was lifted at a point near its border, moved, dropped and settled."""
    points = sheet.points(start)
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
    with moving_points(scene.model, data, sheet, np.array([k])) as step_to:
        for path in paths:
            steps = max(1, int(np.linalg.norm(path) / _LIFT_SPEED / timestep))
            for _ in range(steps):
                at = at + path / steps
                step_to(at)
    dropped = start.copy()
    dropped[sheet.qpos] = data.qpos[sheet.qpos]
    for _ in range(_MAX_SETTLE_RUNS):
        dropped = settle_objects(scene, dropped, timestep).qpos
    return dropped


def simulate_pull(
    data: mujoco.MjData,
    model: mujoco.MjModel,
    cloth: ClothAddresses,
    patches: Sequence[NDArray[np.int_]],
    paths: Sequence[Array],
    arch: float,
    seconds: float,
) -> Array:
    """Simulate a pull of a cloth, and return its points (rows, columns, 3) in `world`, m, after the release.

    Args:
        data: is not changed.
        patches: point indices (n,) of each grasped patch.
        paths: displacement (3,) of each patch, m.
        arch: height of the path as a share of the longest horizontal displacement.
        seconds: duration of the motion, s.
    """
    simulated = mujoco.MjData(model)
    mujoco.mj_copyData(simulated, model, data)
    points = np.concatenate(patches)
    path = np.concatenate([np.tile(path, (len(patch), 1)) for patch, path in zip(patches, paths, strict=True)])
    up = np.array([0.0, 0.0, arch * float(np.linalg.norm(path[:, :2], axis=1).max())])
    start, timestep = cloth.points(simulated.qpos)[points], model.opt.timestep
    steps = max(1, math.ceil(seconds / timestep))
    with moving_points(model, simulated, cloth, points) as step_to:
        for step in range(1, steps + 1):
            share = (1 - math.cos(math.pi * step / steps)) / 2
            step_to(start + share * path + math.sin(math.pi * share) * up)
    for _ in range(math.ceil(_REST_SECONDS / timestep)):
        mujoco.mj_step(model, simulated)
    columns, rows = cloth.grid
    return cloth.points(simulated.qpos).reshape(rows, columns, 3)
