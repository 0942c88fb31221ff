from __future__ import annotations

import math
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import mujoco
import numpy as np

from ...attempt_data import FailureCause, JointPath
from ...config.goals.world import TABLE
from ...config.objects.object_config import ObjectConfig
from ...geometry.se3 import Array, invert_pose, pose, rotation_z
from ...geometry.stable_poses import placeable_poses
from ...sim.antipodal import AntipodalPair, find_antipodal_pairs
from ...sim.geom_shapes import geom_corners
from ...sim.sim_world import SimWorld
from ..planning.collision_checker import AttachedObject, CollisionChecker
from ..planning.rrt_connect import plan_rrt_connect
from ..planning.trajectory import (
    LINE_SPEED,
    is_collision_free,
    minimum_jerk,
    plan_cartesian_curve,
    plan_cartesian_line,
    time_waypoints,
)
from .grasp_candidates import (
    DEFAULT_FINGER_CLEARANCE,
    GraspCandidate,
    antipodal_candidates,
    fingertip_candidates,
    friction_candidates,
    sideways_candidates,
    weld_candidates,
)
from .hand import WAYPOINT_TOLERANCE, Hand, HeldObject

_GRAVITY = 9.81  # m/s^2

# The search for free places on the table.
_PLACE_CLEARANCE = 0.02  # m that an object keeps from others when put down
_CENTRAL_PLACES_X = (0.34, 0.42, 0.28)  # m in front of the midpoint between the bases, in the order tried
_CENTRAL_PLACES_Y = (0.0, 0.10, -0.10, 0.20, -0.20)  # m to the side of that midpoint, in the order tried

_UPRIGHT_TILT = math.radians(10.0)  # rad, an object that tilts less stands upright

V = TypeVar("V")


@dataclass(frozen=True)
class MotionSegment:
    """A motion of all arms: paths of equal length.

    With `wait_for_arrival`, the next segment starts only when the arms have reached the last reference.
    """

    paths: tuple[JointPath, ...]
    wait_for_arrival: bool = True

    @property
    def tick_count(self) -> int:
        """Control ticks."""
        return len(self.paths[0].gripper)


@dataclass(frozen=True)
class FingerTarget:
    """Opening of one finger (m) and its force (N) at the end of a motion."""

    opening: float
    force: float = 0.0


class PlanningContext:
    """The present state of a scene, and the motion planners that skills use.

    Args:
        acting_arms: indices of the hands that may be used; the others keep their joints.
        first_arm: index of the hand that skills call `first`; the other of two hands is `second`.
        tick: length of a control tick, s.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        world: SimWorld,
        hands: Sequence[Hand],
        acting_arms: Collection[int],
        first_arm: int,
        object_configs: Mapping[str, ObjectConfig],
        collision_checker: CollisionChecker,
        rng: np.random.Generator,
        tick: float,
    ) -> None:
        self.model, self.world, self.hands, self.object_configs = model, world, tuple(hands), object_configs
        self.acting_hands = tuple(hands[k] for k in sorted(acting_arms))
        self._side_of_turn = {"first": hands[first_arm].side, "second": hands[len(hands) - 1 - first_arm].side}
        self.collision_checker, self._rng, self.tick = collision_checker, rng, tick
        self._antipodal_pairs: dict[str, list[AntipodalPair]] = {}
        self._stable_rotations: dict[str, list[Array]] = {}
        self._cache: tuple[bytes, dict[Hashable, Any]] = (b"", {})

    @property
    def qpos(self) -> Array:
        """MuJoCo's present positions (nq,)."""
        positions: Array = self.world.data.qpos
        return positions

    def T_pinch(self, hand: Hand) -> Array:
        """Return the measured pose of a hand's pinch frame in `world`."""
        site = self.world.data.site(f"{hand.arm.prefix}pinch_site")
        return pose(site.xpos, site.xmat.reshape(3, 3))

    def finger_opening(self, hand: Hand) -> float:
        """Return the measured opening of each finger, m."""
        fingers = hand.arm.fingers
        assert fingers is not None, "skills need hands with fingers"
        return float(self.qpos[fingers.qpos[0]] * fingers.sign[0])

    def side_of(self, arm: str) -> str:
        """Return the side of "first" or "second"; other values, such as "any", are returned unchanged."""
        return self._side_of_turn.get(arm, arm)

    def free_hands(self, arm: str) -> list[Hand]:
        """Return the acting hands that hold nothing and match an `arm` argument."""
        return [
            hand for hand in self.acting_hands if self.side_of(arm) in ("any", hand.side) and hand.held_object is None
        ]

    def measure_held_object(self, hand: Hand) -> HeldObject:
        """Measure the pose of the object in a hand, store it in `hand.held`, and return it.

        If the hand no longer holds the object, SkillFailedError is raised.
        """
        held = hand.held_object
        assert held is not None, "the hand holds nothing"
        if hand.side not in self.world.holding_sides(held.thing):
            hand.held_object = None
            raise SkillFailedError(FailureCause.DROPPED, f"the {held.thing} fell out of the {hand.side} hand")
        hand.held_object = HeldObject(held.thing, invert_pose(self.T_pinch(hand)) @ self.world.pose(held.thing))
        return hand.held_object

    @contextmanager
    def planning_limits(self, margin: float, allow_tilt: bool = False) -> Iterator[None]:
        """Change the limits of `Hand.solve_ik` for all hands, until the context manager exits.

        Args:
            margin: least distance of every joint from its limits, rad.
            allow_tilt: whether hands may tilt at waypoints that are out of reach. Straight motions to and from them
                come nearer to the joint limits, so set this only for motions that fail otherwise.
        """
        for hand in self.hands:
            hand.joint_margin, hand.allow_tilt = margin, allow_tilt
        try:
            yield
        finally:
            for hand in self.hands:
                hand.joint_margin, hand.allow_tilt = 0.0, False

    def compute_once(self, key: Hashable, make: Callable[[], V]) -> V:
        """Return `make()`, computed once for each key while `qpos` and the planning limits stay the same."""
        key, state = (self.hands[0].joint_margin, self.hands[0].allow_tilt, key), self.qpos.tobytes()
        if self._cache[0] != state:
            self._cache = (state, {})
        if key not in self._cache[1]:
            self._cache[1][key] = make()
        found: V = self._cache[1][key]
        return found

    def clear_cache(self) -> None:
        """Empty the cache, whose values would keep this context in memory until a cycle collection."""
        self._cache = (b"", {})

    def grasp_candidates(self, thing: str, max_opening: float) -> Iterator[GraspCandidate]:
        """Yield an object's grasp candidates for an opening of up to `max_opening` (m), most reliable first."""
        if self.hands[0].grasps_by_weld:
            yield from weld_candidates(self.object_configs[thing])
            return
        yield from friction_candidates(self.object_configs[thing])
        if thing not in self._antipodal_pairs:
            body = self.model.body(thing).id
            self._antipodal_pairs[thing] = find_antipodal_pairs(
                self.model, self.world.data, body, 2 * (max_opening - DEFAULT_FINGER_CLEARANCE / 2)
            )
        yield from antipodal_candidates(self.object_configs[thing], self._antipodal_pairs[thing])
        yield from sideways_candidates(self.object_configs[thing])
        yield from fingertip_candidates(self.object_configs[thing])

    def half_footprint(self, thing: str, heading: float) -> Array:
        """Return half the extents (2,) along x and y of an upright object with a heading (rad), m."""
        low, high = self._local_box(thing)
        corners = np.array([[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])])
        half: Array = np.abs(corners @ rotation_z(heading)[:2, :2].T).max(axis=0)
        return half

    def rest_height_over(self, thing: str, place: Array, onto: str, heading: float) -> float:
        """Return the height in `world`, m, at which an upright object comes to rest over a point (2,)."""
        return self.rest_height_of(thing, pose((*place, 0.0), rotation_z(heading)), onto)

    def rest_height_of(self, thing: str, T: Array, onto: str) -> float:
        """Return the height in `world`, m, at which an object with a pose's rotation comes to rest."""
        top = float(self.compute_once(("bounds", onto), lambda: self.world.aabb(onto))[1][2])
        low, high = self._local_box(thing)
        T_over = T.copy()
        T_over[2, 3] = top + float(np.abs(T[2, :3]) @ (high - low))
        table_low, table_high = self.world.aabb(TABLE)
        rest = self.collision_checker.rest_height(self.qpos, thing, T_over, float(table_low[2]))
        # Collision checks ignore cloth, so that a hand may press on it: add its height.
        on_cloth = onto in self.object_configs and self.object_configs[onto].cloth is not None
        return rest + (top - float(table_high[2]) if on_cloth else 0.0)

    def stable_rotations(self, thing: str) -> list[Array]:
        """Return the rotations (3, 3) in which an object rests stably, without their headings; upright first."""
        if thing not in self._stable_rotations:
            body, rotations = self.model.body(thing).id, [np.eye(3)]
            geoms = [g for g in range(self.model.ngeom) if self.model.geom_bodyid[g] == body]
            points = [geom_corners(self.model, geom) for geom in geoms if self.model.geom_contype[geom]]
            for stable_pose in placeable_poses(np.concatenate(points), self.model.body_ipos[body]):
                if stable_pose.down[2] > -math.cos(_UPRIGHT_TILT):
                    rotations.append(stable_pose.rotation)
            self._stable_rotations[thing] = rotations
        return self._stable_rotations[thing]

    def _local_box(self, thing: str) -> Array:
        return self.compute_once(("block", thing), lambda: self.world.local_box(thing))

    def is_place_free(self, thing: str, place: Array) -> bool:
        """Return whether an upright object has room at a point (2,) on the table, m."""
        room = float(np.hypot(*self.half_footprint(thing, 0.0))) + _PLACE_CLEARANCE
        low, high = self.world.aabb(TABLE)
        if (place - room < low[:2]).any() or (place + room > high[:2]).any():
            return False
        for other in self.world.object_names:
            if other != thing:
                near, far = self.world.aabb(other)
                gap = np.maximum(np.maximum(near[:2] - place, place - far[:2]), 0.0)
                if float(np.hypot(*gap)) < room:
                    return False
        return True

    @property
    def base_midpoint(self) -> Array:
        """The midpoint (2,) between the acting arms' bases in `world`, m."""
        middle: Array = np.mean([hand.arm.T_base_in_world[:2, 3] for hand in self.acting_hands], axis=0)
        return middle

    def central_places(self) -> list[Array]:
        """Return points (2,) on the table about equally far from all acting arms, in `world`, m."""
        return [self.base_midpoint + np.array((x, y)) for x in _CENTRAL_PLACES_X for y in _CENTRAL_PLACES_Y]

    def release_clearance(self, thing: str) -> float:
        """Return how far each finger opens beyond an object's surface to release it, m."""
        grasp = self.object_configs[thing].grasp
        return grasp.clearance if grasp is not None else DEFAULT_FINGER_CLEARANCE

    def find_contact(
        self,
        hand: Hand,
        joints: Array,
        opening: float,
        attached: AttachedObject | None = None,
        grasped: str | None = None,
        finger_clearance: float | None = None,
    ) -> str | None:
        """Return the names of two geoms in contact; arguments as in `CollisionChecker.find_contact`."""
        return self.collision_checker.find_contact(
            self.qpos, hand.number, joints, opening, attached, grasped, finger_clearance
        )

    def qpos_with_hand(self, hand: Hand, joints: Array, opening: float, held: HeldObject | None) -> Array:
        """Return `qpos` (nq,) with one hand and its held object moved."""
        load = None if held is None else AttachedObject(held.thing, held.T_thing_in_pinch)
        return self.collision_checker.qpos_with_arm(self.qpos, hand.number, joints, opening, load)

    def plan_free_path(
        self, hand: Hand, goal: Array, opening: float | None = None, attached: AttachedObject | None = None
    ) -> Array:
        """Return the simplest collision-free motion (n + 1, dof) of a hand to joints `goal`, or raise SkillFailedError.

        A hand in contact at the start may first rise straight up. Collisions are checked with the larger opening of
        each finger (m) of start and end.
        """
        opening_on_way = max(hand.opening, opening if opening is not None else 0.0)

        def contact_at(joints: Array) -> str | None:
            return self.find_contact(hand, joints, opening_on_way, attached)

        path = plan_free_path(hand, goal, contact_at, self.tick, self._rng)
        if path is None:
            blocked = contact_at(goal) or contact_at(hand.joints) or "everything between"
            raise SkillFailedError(
                FailureCause.UNREACHABLE, f"no free way for the {hand.side} arm: {blocked} is in the way"
            )
        return path

    def plan_line(self, hand: Hand, T_pinch_in_world: Array, speed: float = LINE_SPEED) -> Array:
        """Return a motion (n + 1, dof) of a hand's pinch frame straight to a pose."""
        path = plan_cartesian_line(hand.ik, hand.joints, T_pinch_in_world, self.tick, speed)
        if path is None:
            raise SkillFailedError(FailureCause.UNREACHABLE, f"a straight line leaves the {hand.side} arm's reach")
        return path

    def plan_curve(self, hand: Hand, pose_at: Callable[[float], Array], seconds: float) -> Array:
        """Return a motion (n + 1, dof) of a hand's pinch frame on a curve; arguments as in `cartesian_curve`."""
        path = plan_cartesian_curve(hand.ik, hand.joints, pose_at, seconds, self.tick)
        if path is None:
            raise SkillFailedError(
                FailureCause.UNREACHABLE, f"the path of the held object leaves the {hand.side} arm's reach"
            )
        return path

    def hold_still_motion(self, hand: Hand, ticks: int) -> Array:
        """Return a motion (ticks + 1, dof) that keeps a hand's joints."""
        return np.tile(hand.joints, (ticks + 1, 1))

    def make_segment(
        self,
        motions: Mapping[Hand, Array],
        fingers: Mapping[Hand, FingerTarget] | None = None,
        wait_for_arrival: bool = True,
    ) -> MotionSegment:
        """Return the segment in which some arms move, and update the commanded state of the hands.

        The other arms keep their joints. Feed-forward torques compensate the weight of the arms and of held objects.

        Args:
            motions: joints (n + 1, dof). A motion shorter than the longest waits at its end.
            fingers: the fingers of other hands keep their opening and force.
            wait_for_arrival: as in `MotionSegment`.
        """
        ticks = max(len(motion) for motion in motions.values()) - 1
        paths = []
        for hand in self.hands:
            joints = motions.get(hand)
            joints = self.hold_still_motion(hand, ticks) if joints is None else _pad_with_last_row(joints, ticks)
            target = (fingers or {}).get(hand, FingerTarget(hand.opening, hand.grip_force))
            progress = np.array([minimum_jerk((k + 1) / ticks) for k in range(ticks)])
            opening = hand.opening + progress * (target.opening - hand.opening)
            grip = hand.grip_force + progress * (target.force - hand.grip_force)
            paths.append(
                JointPath(
                    joints=joints,
                    torques=self._path_torques(hand, joints, opening),
                    gripper=opening,
                    grip_force=grip,
                    weld_on=(hand.weld_commanded,) * ticks,
                    tick=self.tick,
                )
            )
            hand.joints, hand.opening, hand.grip_force = joints[-1].copy(), target.opening, target.force
        return MotionSegment(tuple(paths), wait_for_arrival)

    def wait_segment(self, ticks: int) -> MotionSegment:
        """Return the segment in which all arms keep their joints."""
        return self.make_segment({self.hands[0]: self.hold_still_motion(self.hands[0], ticks)})

    def holding_torques(self, hand: Hand, joints: Array, opening: float) -> Array:
        """Return the torques (dof,), N m, that hold an arm and its held object still."""
        still: Array = self._path_torques(hand, np.tile(joints, (3, 1)), np.full(2, opening))[-1]
        return still

    def _path_torques(self, hand: Hand, joints: Array, opening: Array) -> Array:
        torques = hand.dynamics.inverse_dynamics_torques(joints, opening, self.tick)
        if hand.held_object is None:
            return torques
        item = self.object_configs[hand.held_object.thing]
        centre = hand.held_object.T_thing_in_pinch @ np.array([*item.inertia.centre, 1.0])
        weight = item.inertia.mass * _GRAVITY
        return torques + hand.dynamics.payload_torques((joints[1:] + joints[:-1]) / 2, centre[:3], weight)


def _pad_with_last_row(joints: Array, ticks: int) -> Array:
    return np.concatenate([joints, np.tile(joints[-1], (ticks + 1 - len(joints), 1))])


class SkillFailedError(Exception):
    """No motion was found, or a skill did not have its effect. The attempt's outcome records the error."""

    def __init__(self, cause: FailureCause, detail: str) -> None:
        super().__init__(detail)
        self.cause = cause


T = TypeVar("T")


class CachedIterable(Generic[T]):
    """Reads its source on demand, and keeps the elements for later iterations."""

    def __init__(self, source: Iterable[T]) -> None:
        self._source, self._kept = iter(source), list[T]()

    def __iter__(self) -> Iterator[T]:
        k = 0
        while True:
            while k < len(self._kept):
                yield self._kept[k]
                k += 1
            try:
                self._kept.append(next(self._source))
            except StopIteration:
                return


_CROSSING_HEIGHT = 0.22  # m in `world`, least height of a hand that crosses the table
_MIN_RISE = 0.05  # m, least height by which a hand rises before it crosses the table

_RETREAT_STEP, _MAX_RETREAT_STEPS = 0.02, 6  # m and count, steps in which a hand rises from a contact

# Contact of an arm at joints (dof,), as text.
ContactQuery = Callable[[Array], str | None]


def plan_free_path(
    hand: Hand, goal: Array, find_contact: ContactQuery, tick: float, rng: np.random.Generator
) -> Array | None:
    """Return a collision-free motion (n + 1, dof) of a hand to joints `goal`; None if none was found.

    Simple motions are tried before RRT-Connect. A hand in contact at the start first rises straight up if no direct
    motion exists.
    """
    path = _plan_from(hand, hand.joints, goal, find_contact, tick, rng)
    if (
        path is None
        and find_contact(hand.joints) is not None
        and (retreat := _retreat_up(hand, find_contact, tick)) is not None
    ):
        onward = _plan_from(hand, retreat[-1], goal, find_contact, tick, rng)
        path = None if onward is None else np.concatenate([retreat[:-1], onward])
    return path


def _plan_from(
    hand: Hand, start: Array, goal: Array, find_contact: ContactQuery, tick: float, rng: np.random.Generator
) -> Array | None:
    for points in _heuristic_waypoints(hand, start, goal):
        path = time_waypoints(points, hand.arm.motor_speed, tick)
        if is_collision_free(path, find_contact):
            return path
    found = plan_rrt_connect(start, goal, hand.arm.joint_range, find_contact, rng)
    return None if found is None else time_waypoints(found, hand.arm.motor_speed, tick)


def _retreat_up(hand: Hand, find_contact: ContactQuery, tick: float) -> Array | None:
    """Return the shortest motion straight up after which a hand has no contact."""
    T = hand.pinch_pose(hand.joints)
    for _ in range(_MAX_RETREAT_STEPS):
        T[2, 3] += _RETREAT_STEP
        path = plan_cartesian_line(hand.ik, hand.joints, T, tick, LINE_SPEED)
        if path is not None and find_contact(path[-1]) is None:
            return path
    return None


def _heuristic_waypoints(hand: Hand, start: Array, goal: Array) -> list[list[Array]]:
    """Return simple waypoints: direct; up, across and down; or over one intermediate posture."""
    raised = []
    for joints in (start, goal):
        T = hand.pinch_pose(joints)
        T[2, 3] = max(T[2, 3] + _MIN_RISE, _CROSSING_HEIGHT)
        raised.append(hand.solve_ik(T, [joints], WAYPOINT_TOLERANCE))
    up, down = raised
    paths = [[start, goal]]
    if up is not None and down is not None:
        paths.append([start, up, down, goal])
    paths += [[start, via, goal] for via in (down, up, hand.ready_joints) if via is not None]
    return paths
