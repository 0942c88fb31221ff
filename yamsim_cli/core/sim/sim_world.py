from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..config.goals.world import TABLE
from ..geometry.se3 import Array, invert_pose, pose
from ..scene.compiled import ArmAddresses, ClothAddresses, CompiledScene, ContainerRegion, Ids
from .cloth import ClothState
from .geom_shapes import body_box, body_surface, enclosing_box, geom_aabb, geom_points
from .interior import Interior

_VOLUME_POINTS = 1000  # sample points in a body, which give volume shares a resolution of 0.001
_MIN_UPWARD_NORMAL = 0.5  # vertical component of a contact, above which a finger is under a cloth


class SimWorld:
    """The state of a compiled scene by object names, for goals and skills; implements `config.goals.world.GoalWorld`.

    Attributes:
        data: MuJoCo's state, with the poses and contacts of its last forward pass.

    Args:
        things: names of the objects, in order. An object is the body of that name with all its descendants.
        sides: "left" or "right", in the order of `arms`.
        regions: name -> region of an object, such as a tray's compartment.
        pieces: filled object -> ids of its loose pieces' joints.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        arms: Sequence[ArmAddresses],
        sides: Sequence[str],
        things: Sequence[str],
        regions: Mapping[str, ContainerRegion] | None = None,
        cloths: Mapping[str, ClothAddresses] | None = None,
        pieces: Mapping[str, Sequence[int]] | None = None,
    ) -> None:
        self._model, self.data = model, data
        self.arms, self.sides, self.object_names = tuple(arms), tuple(sides), tuple(things)
        self._regions = regions or {}
        self._cloths = {name: ClothState(cloth, data) for name, cloth in (cloths or {}).items()}
        self._pieces = {name: model.jnt_bodyid[list(joints)] for name, joints in (pieces or {}).items()}
        root = model.body_rootid[model.geom_bodyid]
        self._geoms = {name: np.flatnonzero(root == model.body(name).id) for name in things}
        self._geoms[TABLE] = np.array([model.geom(TABLE).id])
        self._numbers = {name: k for k, name in enumerate((*things, TABLE))}
        # Contacts of cloth have geom -1, which indexes the last entry.
        self._geom_object: Ids = np.full(model.ngeom + 1, -1)
        for name, number in self._numbers.items():
            self._geom_object[self._geoms[name]] = number
        self._fingers = [_finger_geoms(model, arm) for arm in arms]
        self._geom_finger: Ids = np.full(model.ngeom + 1, -1)
        for arm, geoms_of in enumerate(self._fingers):
            for finger, geoms in enumerate(geoms_of):
                self._geom_finger[geoms] = 2 * arm + finger
        self._bodies = {name: self._solid_geoms(name) for name in things}
        self._volumes: dict[int, tuple[Array, float]] = {}
        self._interiors: dict[int, Interior] = {}
        self._hands: dict[str, list[str]] = {name: [] for name in things}
        self._handovers: dict[str, list[tuple[str, str]]] = {name: [] for name in things}
        self._starts: dict[str, Array] = {}
        self._start_boxes: dict[str, tuple[Array, Array]] = {}

    def pose(self, thing: str) -> Array:
        """Return the pose in `world` of an object, a region or a cloth."""
        if region := self._regions.get(thing):
            return self.pose(region.thing) @ region.T_in_object
        if cloth := self._cloths.get(thing):
            return cloth.pose
        body = self.data.body(self._require_object(thing))
        return pose(body.xpos, body.xmat.reshape(3, 3))

    def handle_pose(self, thing: str, handle: str) -> Array:
        """Return the pose in `world` of a handle of an object; z points into the handle."""
        site = self.data.site(f"{self._require_object(thing)}_{handle}")
        return pose(site.xpos, site.xmat.reshape(3, 3))

    def start_pose(self, thing: str) -> Array:
        """Return the pose in `world` that an object had at the last `store_start`."""
        return self._starts[self._require_object(thing)]

    def start_aabb(self, thing: str) -> tuple[Array, Array]:
        """Return the corners of the bounding box, as `aabb`, that an object had at the last `store_start`."""
        return self._start_boxes[self._require_object(thing)]

    def store_start(self) -> None:
        """Store the poses and bounding boxes of all objects, and clear the records of holders and handovers."""
        self._starts = {name: self.pose(name) for name in self.object_names}
        self._start_boxes = {name: self.aabb(name) for name in self.object_names}
        self._hands = {name: [] for name in self.object_names}
        self._handovers = {name: [] for name in self.object_names}

    def aabb(self, thing: str) -> tuple[Array, Array]:
        """Return the lowest and highest corner (3,) of all collision geoms in `world`, m."""
        if region := self._regions.get(thing):
            T = self.pose(thing)
            corners = np.array([T[:3, :3] @ corner + T[:3, 3] for corner in _box_corners(region.corners)])
            return corners.min(axis=0), corners.max(axis=0)
        if cloth := self._cloths.get(thing):
            return cloth.aabb
        corners = self.geom_aabbs(thing)
        return corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)

    def geom_aabbs(self, thing: str) -> Array:
        """Return the lowest and highest corner (n, 2, 3) of each collision geom in `world`, m."""
        geoms = self._geoms[self._require_object(thing)]
        solid = geoms[self._model.geom_contype[geoms] != 0]
        return np.array([geom_aabb(self._model, self.data, int(geom)) for geom in solid])

    def speed(self, thing: str) -> float:
        """Return the linear speed of an object, or of the fastest point of a cloth, m/s."""
        if cloth := self._cloths.get(thing):
            return cloth.speed
        dof = self._model.joint(self._require_object(thing)).dofadr[0]
        return float(np.linalg.norm(self.data.qvel[dof : dof + 3]))

    def are_touching(self, one: str, other: str) -> bool:
        """Return whether two objects touch."""
        first, second = (self._in_contact(name) for name in (one, other))
        return bool(((first[:, 0] & second[:, 1]) | (first[:, 1] & second[:, 0])).any())

    def _in_contact(self, thing: str) -> NDArray[np.bool_]:
        """Return whether each of the two sides of each present contact is an object (n, 2)."""
        if cloth := self._cloths.get(thing):
            return cloth.contact_sides
        found: NDArray[np.bool_] = (
            self._geom_object[self.data.contact.geom] == self._numbers[self._require_object(thing)]
        )
        return found

    def cloth_points(self, thing: str) -> Array:
        """Return a cloth's points (rows, columns, 3) in `world`, m; rows run along its x axis."""
        return self._cloths[thing].point_grid

    def cloth_addresses(self, thing: str) -> ClothAddresses:
        """Return the addresses of a cloth's points in MuJoCo's arrays."""
        return self._cloths[thing].addresses

    def holding_sides(self, thing: str) -> frozenset[str]:
        """Return the sides of the hands that hold an object by both fingers or a weld, or a cloth by constraints."""
        return self.holding_sides_by_object()[self._require_object(thing)]

    def holding_sides_by_object(self) -> dict[str, frozenset[str]]:
        """Return object -> sides of the hands that hold it."""
        pairs = self.data.contact.geom
        things, fingers = self._geom_object[pairs], self._geom_finger[pairs]
        # Whether each object touches each finger, two per arm; the last row and column stand for other geoms.
        pressed = np.zeros((len(self.object_names) + 1, 2 * len(self.arms) + 1), bool)
        pressed[things[:, 0], fingers[:, 1]] = pressed[things[:, 1], fingers[:, 0]] = True
        gripped = (pressed[:, :-1:2] & pressed[:, 1::2]).tolist()
        found = {}
        for k, name in enumerate(self.object_names):
            if cloth := self._cloths.get(name):
                found[name] = frozenset(side for arm, side in enumerate(self.sides) if cloth.is_held_by(arm))
            else:
                found[name] = frozenset(
                    side for arm, side in enumerate(self.sides) if gripped[k][arm] or self._is_welded(name, arm)
                )
        return found

    def _is_welded(self, thing: str, arm: int) -> bool:
        weld = self.arms[arm].weld
        if weld is None or not self.data.eq_active[weld]:
            return False
        return bool(self._model.eq_obj2id[weld] == self._model.body(thing).id)

    def sides_with_finger_under_cloth(self, thing: str) -> frozenset[str]:
        """Return the sides of the hands that have a finger under a cloth and would lift it."""
        contact = self.data.contact
        flexes = self._cloths[thing].contact_sides
        # A contact normal points from the first side to the second.
        up = np.where(flexes[:, 1], 1.0, -1.0) * contact.frame[:, 2]
        lifted = contact.geom[flexes.any(axis=1) & (up > _MIN_UPWARD_NORMAL)]
        return frozenset(
            side
            for side, fingers in zip(self.sides, self._fingers, strict=True)
            if any(np.isin(lifted, finger).any() for finger in fingers)
        )

    def holders_since_rest(self, thing: str) -> tuple[str, ...]:
        """Return the sides of the hands that held an object since it last lay down, as `update_handovers` saw."""
        return tuple(self._hands[self._require_object(thing)])

    def handovers(self, thing: str) -> tuple[tuple[str, str], ...]:
        """Return giver's and receiver's side of all handovers in the attempt, as `update_handovers` saw."""
        return tuple(self._handovers[self._require_object(thing)])

    def volume_fraction_inside(self, thing: str, container: str) -> float:
        """Return the share, 0..1, of an object's volume in a container's interior, estimated by sample points."""
        return self._volume_fraction(thing, lambda points: self.points_inside(container, points))

    def volume_fraction_in_box(self, thing: str, container: str) -> float:
        """Return the share, 0..1, of an object's volume in a container's local bounding box."""
        return self._volume_fraction(thing, lambda points: self._in_local_box(container, points))

    def _volume_fraction(self, thing: str, held: Callable[[Array], NDArray[np.bool_]]) -> float:
        shares, volumes = zip(
            *((held(points).mean(), volume) for points, volume in self.volume_samples(thing)), strict=True
        )
        return float(np.average(shares, weights=volumes))

    def _in_local_box(self, container: str, points: Array) -> NDArray[np.bool_]:
        T, (low, high) = self.pose(container), self.local_box(container)
        points = (points - T[:3, 3]) @ T[:3, :3]
        held: NDArray[np.bool_] = ((points >= low) & (points <= high)).all(axis=1)
        return held

    def points_inside(self, container: str, points: Array) -> NDArray[np.bool_]:
        """Return whether each point (n, 3) in `world` lies in a container's interior or in a region's box, as (n,)."""
        if container in self._regions:
            return self._in_local_box(container, points)
        held = np.zeros(len(points), bool)
        for body, geoms in self._bodies[self._require_object(container)].items():
            if body not in self._interiors:
                self._interiors[body] = Interior(body_surface(self._model, geoms))
            T = self._body_pose(body)
            held |= self._interiors[body].contains((points - T[:3, 3]) @ T[:3, :3])
        return held

    def grams_inside(self, filled: str, container: str) -> float:
        """Return the mass of the loose pieces of a filled object whose centres are inside a container, g."""
        bodies = self._pieces[filled]
        inside = self.points_inside(container, self.data.xipos[bodies])
        return 1000 * float(self._model.body_mass[bodies[inside]].sum())

    def joint_opening(self, thing: str, joint: str) -> float:
        """Return how far a joint is open: 0 at the lower end of its range, 1 at the upper end."""
        found = self._model.joint(f"{self._require_object(thing)}_{joint}")
        low, high = found.range
        return float((self.data.qpos[found.qposadr[0]] - low) / (high - low))

    def part_pose(self, thing: str, part: str) -> Array:
        """Return the pose in `world` of a moving part of an object."""
        body = self.data.body(f"{self._require_object(thing)}_{part}")
        return pose(body.xpos, body.xmat.reshape(3, 3))

    def update_handovers(self) -> dict[str, frozenset[str]]:
        """Update the results of `holders_since_rest` and `handovers`; return `holding_sides_by_object()`.

        The holders are cleared when no hand holds the object and the object touches another one or the table.
        """
        holding_sides_by_object = self.holding_sides_by_object()
        for thing, holders in holding_sides_by_object.items():
            hands = self._hands[thing]
            if not holders:
                if hands and self._is_supported(thing):
                    hands.clear()
                continue
            for side in sorted(holders):
                if len(holders) == 1 and (not hands or hands[-1] != side):
                    if hands:
                        self._handovers[thing].append((hands[-1], side))
                    hands.append(side)
        return holding_sides_by_object

    def _is_supported(self, thing: str) -> bool:
        return any(self.are_touching(thing, other) for other in (TABLE, *self.object_names) if other != thing)

    def _require_object(self, thing: str) -> str:
        if thing not in self._geoms:
            raise KeyError(thing)
        return thing

    def local_box(self, thing: str) -> Array:
        """Return an object's lowest and highest corner (2, 3) at its present joint positions, in its frame, m."""
        if region := self._regions.get(thing):
            return region.corners
        if cloth := self._cloths.get(thing):
            return cloth.local_box
        root, T = int(self._model.body(self._require_object(thing)).id), invert_pose(self.pose(thing))
        return enclosing_box(
            [
                body_box(self._model, geoms, None if body == root else T @ self._body_pose(body))
                for body, geoms in self._bodies[thing].items()
            ]
        )

    def _solid_geoms(self, thing: str) -> dict[int, list[int]]:
        bodies: dict[int, list[int]] = {}
        for geom in self._geoms[thing]:
            if self._model.geom_contype[geom]:
                bodies.setdefault(int(self._model.geom_bodyid[geom]), []).append(int(geom))
        return bodies

    def _body_pose(self, body: int) -> Array:
        return pose(self.data.xpos[body], self.data.xmat[body].reshape(3, 3))

    def volume_samples(self, thing: str) -> Iterator[tuple[Array, float]]:
        """Yield, for each body of an object, evenly spread points (n, 3) in `world`, m, and the volume, m3."""
        if cloth := self._cloths.get(thing):
            yield cloth.points, 1.0
            return
        for body, geoms in self._bodies[self._require_object(thing)].items():
            if body not in self._volumes:
                self._volumes[body] = geom_points(self._model, geoms, _VOLUME_POINTS)
            T, (points, volume) = self._body_pose(body), self._volumes[body]
            yield points @ T[:3, :3].T + T[:3, 3], volume


def _box_corners(block: Array) -> list[Array]:
    return [np.array([block[i, 0], block[j, 1], block[k, 2]]) for i in (0, 1) for j in (0, 1) for k in (0, 1)]


def _finger_geoms(model: mujoco.MjModel, arm: ArmAddresses) -> tuple[NDArray[np.int_], ...]:
    fingers = []
    for address in () if arm.fingers is None else arm.fingers.qpos:
        joint = int(np.searchsorted(model.jnt_qposadr, address))
        bodies = {int(model.jnt_bodyid[joint])}
        for body in range(model.nbody):
            if int(model.body_parentid[body]) in bodies:
                bodies.add(body)
        fingers.append(np.flatnonzero(np.isin(model.geom_bodyid, list(bodies))))
    return tuple(fingers)


def make_sim_world(scene: CompiledScene, data: mujoco.MjData, sides: Sequence[str]) -> SimWorld:
    """Return the `SimWorld` of a scene and a state; `sides` are the arms' sides, "left" or "right"."""
    return SimWorld(scene.model, data, scene.arms, sides, scene.object_names, scene.regions, scene.cloths, scene.pieces)
