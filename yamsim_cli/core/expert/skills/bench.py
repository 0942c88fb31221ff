"""What skills plan with: the present state of the scene, the hands, and collision-free motions."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import mujoco
import numpy as np

from ...config.goals.world import TABLE
from ...config.things.thing import ObjectConfig
from ...geometry.attitudes import steady_attitudes
from ...geometry.se3 import Array, inverse, pose, rotation_z
from ...sim.antipodal import Span, spans
from ...sim.shapes import geom_corners
from ...sim.world import SimWorld
from ...types import Cause, JointPath
from ..planning.joint_motion import LINE_SPEED, clear, ease, straight, through, traced
from ..planning.obstacles import Load, Obstacles
from ..planning.tree_search import search
from .grips import CLEARANCE, Grip, antipodal_grips, fingertip_grips, friction_grips, sideways_grips, weld_grips
from .hand import PASSING, Hand, Held

_GRAVITY = 9.81  # m/s^2

# Free places on the table.
_FREE_MARGIN = 0.02  # m, free space required around a thing that is put down
_MIDDLE_X = (0.34, 0.42, 0.28)  # m, candidate distances in front of the midpoint between the bases, the preferred first
_MIDDLE_Y = (0.0, 0.10, -0.10, 0.20, -0.20)  # m, candidate distances to the side of that midpoint

_UPRIGHT_TILT = math.radians(10.0)  # rad, a thing that leans less than this stands upright

V = TypeVar("V")


@dataclass(frozen=True)
class Segment:
    """A motion of all arms: one path for each arm, all of the same length.

    Attributes:
        paths: of the arms, in the scene's order.
        arrives: whether the next segment starts only once the arms have reached the last reference.
    """

    paths: tuple[JointPath, ...]
    arrives: bool = True

    @property
    def ticks(self) -> int:
        """Number of control ticks."""
        return len(self.paths[0].gripper)


@dataclass(frozen=True)
class Fingers:
    """Target of the fingers of a hand at the end of a motion: opening of one finger (m), and force (N)."""

    opening: float
    grip: float = 0.0


class Bench:
    """The present state of a scene, and the motion planners that skills use.

    Args:
        world: the present state of the things.
        acting: numbers of the hands that may be used; the others keep their joints.
        first: number of the hand that begins; the other of two hands is the second.
        items: thing -> its config.
        rng: random numbers of the path searches. Its seed follows from the attempt's numbers.
        tick: length of a control tick, s.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        world: SimWorld,
        hands: Sequence[Hand],
        acting: Collection[int],
        first: int,
        items: Mapping[str, ObjectConfig],
        obstacles: Obstacles,
        rng: np.random.Generator,
        tick: float,
    ) -> None:
        self.model, self.world, self.hands, self.items = model, world, tuple(hands), items
        self.acting = tuple(hands[k] for k in sorted(acting))
        self._side_of_turn = {"first": hands[first].side, "second": hands[len(hands) - 1 - first].side}
        self.obstacles, self._rng, self.tick = obstacles, rng, tick
        self._spans: dict[str, list[Span]] = {}
        self._steady_rotations: dict[str, list[Array]] = {}
        self._cache: tuple[bytes, dict[Hashable, Any]] = (b"", {})

    # -- state

    @property
    def qpos(self) -> Array:
        """MuJoCo's present positions (nq,)."""
        positions: Array = self.world.data.qpos
        return positions

    def T_pinch(self, hand: Hand) -> Array:
        """Return the measured pose (4, 4) of a hand's pinch frame in `world`."""
        site = self.world.data.site(f"{hand.arm.prefix}pinch_site")
        return pose(site.xpos, site.xmat.reshape(3, 3))

    def opening(self, hand: Hand) -> float:
        """Return the measured opening of each finger of a hand, m."""
        fingers = hand.arm.fingers
        assert fingers is not None, "skills are for hands with fingers"
        return float(self.qpos[fingers.qpos[0]] * fingers.sign[0])

    def side_of(self, arm: str) -> str:
        """Return the side of "first" or "second"; any other value, such as "any", is returned unchanged."""
        return self._side_of_turn.get(arm, arm)

    def free_hands(self, arm: str) -> list[Hand]:
        """Return the acting hands that hold nothing and match an argument; "any" matches all."""
        return [hand for hand in self.acting if self.side_of(arm) in ("any", hand.side) and hand.held is None]

    def update_held(self, hand: Hand) -> Held:
        """Measure the pose of the thing in a hand, store it in `hand.held`, and return it.

        Raises:
            SkillFailedError: the hand no longer holds the thing.
        """
        held = hand.held
        assert held is not None, "a hand that holds nothing is not asked what it holds"
        if hand.side not in self.world.holders(held.thing):
            hand.held = None
            raise SkillFailedError(Cause.DROPPED, f"the {held.thing} fell out of the {hand.side} hand")
        hand.held = Held(held.thing, inverse(self.T_pinch(hand)) @ self.world.pose(held.thing))
        return hand.held

    @contextmanager
    def reserve(self, margin: float, leans: bool = False) -> Iterator[None]:
        """Change what `Hand.reach` finds within the context.

        Args:
            margin: least distance of every joint from its stops, rad.
            leans: whether hands may lean at waypoints whose pose is out of reach. Straight motions to and from such
                waypoints come nearer to the stops, so this is for what cannot be done otherwise.
        """
        for hand in self.hands:
            hand.reserve, hand.leans = margin, leans
        try:
            yield
        finally:
            for hand in self.hands:
                hand.reserve, hand.leans = 0.0, False

    def cached(self, key: Hashable, make: Callable[[], V]) -> V:
        """Return `make()`, computed once for each key as long as `qpos`, the reserve and the leaning stay the same."""
        key, state = (self.hands[0].reserve, self.hands[0].leans, key), self.qpos.tobytes()
        if self._cache[0] != state:
            self._cache = (state, {})
        if key not in self._cache[1]:
            self._cache[1][key] = make()
        found: V = self._cache[1][key]
        return found

    def clear_cache(self) -> None:
        """Drop what `cached` keeps. It refers to the bench, which would stay in memory until a cycle collection."""
        self._cache = (b"", {})

    def grips(self, thing: str, max_opening: float) -> Iterator[Grip]:
        """Yield grips of a thing for fingers that open up to `max_opening` each (m), the most reliable first."""
        if self.hands[0].welds:
            yield from weld_grips(self.items[thing])
            return
        yield from friction_grips(self.items[thing])
        if thing not in self._spans:
            body = self.model.body(thing).id
            self._spans[thing] = spans(self.model, self.world.data, body, 2 * (max_opening - CLEARANCE / 2))
        yield from antipodal_grips(self.items[thing], self._spans[thing])
        yield from sideways_grips(self.items[thing])
        yield from fingertip_grips(self.items[thing])

    def half_outline(self, thing: str, heading: float) -> Array:
        """Return half the extents (2,) along x and y of a thing that stands upright, turned by `heading`, m."""
        low, high = self._block(thing)
        corners = np.array([[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])])
        half: Array = np.abs(corners @ rotation_z(heading)[:2, :2].T).max(axis=0)
        return half

    def height_on(self, thing: str, place: Array, onto: str, heading: float) -> float:
        """Return the height in `world` at which an upright thing's origin comes to rest over a point (2,), m."""
        return self.height_of(thing, pose((*place, 0.0), rotation_z(heading)), onto)

    def height_of(self, thing: str, T: Array, onto: str) -> float:
        """Return the height in `world` at which a thing with the rotation of a pose (4, 4) comes to rest, m."""
        top = float(self.cached(("bounds", onto), lambda: self.world.bounds(onto))[1][2])
        low, high = self._block(thing)
        T_over = T.copy()
        T_over[2, 3] = top + float(np.abs(T[2, :3]) @ (high - low))
        table_low, table_high = self.world.bounds(TABLE)
        rest = self.obstacles.rest_height(self.qpos, thing, T_over, float(table_low[2]))
        # A thing that comes down passes through cloth: cloth is no obstacle, so that a hand may press on it. Add its
        # height.
        on_cloth = onto in self.items and self.items[onto].cloth is not None
        return rest + (top - float(table_high[2]) if on_cloth else 0.0)

    def steady_rotations(self, thing: str) -> list[Array]:
        """Return the rotations (3, 3) in which a thing rests stably, without their headings; upright first."""
        if thing not in self._steady_rotations:
            body, rotations = self.model.body(thing).id, [np.eye(3)]
            geoms = [g for g in range(self.model.ngeom) if self.model.geom_bodyid[g] == body]
            points = [geom_corners(self.model, geom) for geom in geoms if self.model.geom_contype[geom]]
            for attitude in steady_attitudes(np.concatenate(points), self.model.body_ipos[body]):
                if attitude.down[2] > -math.cos(_UPRIGHT_TILT):
                    rotations.append(attitude.turn)
            self._steady_rotations[thing] = rotations
        return self._steady_rotations[thing]

    def _block(self, thing: str) -> Array:
        return self.cached(("block", thing), lambda: self.world.block(thing))

    def is_free(self, thing: str, place: Array) -> bool:
        """Return whether a thing that stands upright has room at a point (2,) on the table, m."""
        room = float(np.hypot(*self.half_outline(thing, 0.0))) + _FREE_MARGIN
        low, high = self.world.bounds(TABLE)
        if (place - room < low[:2]).any() or (place + room > high[:2]).any():
            return False
        for other in self.world.things:
            if other != thing:
                near, far = self.world.bounds(other)
                gap = np.maximum(np.maximum(near[:2] - place, place - far[:2]), 0.0)
                if float(np.hypot(*gap)) < room:
                    return False
        return True

    @property
    def middle(self) -> Array:
        """The midpoint (2,) between the bases of the acting arms, in `world`, m."""
        middle: Array = np.mean([hand.arm.T_base_in_world[:2, 3] for hand in self.acting], axis=0)
        return middle

    def middle_places(self) -> list[Array]:
        """Return points (2,) on the table that are about as near to all acting arms, in `world`, m."""
        return [self.middle + np.array((x, y)) for x in _MIDDLE_X for y in _MIDDLE_Y]

    def clearance(self, thing: str) -> float:
        """Return how far each finger opens beyond a thing's surface to release the thing, m."""
        grasp = self.items[thing].grasp
        return grasp.clearance if grasp is not None else CLEARANCE

    def touched(
        self,
        hand: Hand,
        joints: Array,
        opening: float,
        load: Load | None = None,
        between: str | None = None,
        beside: float | None = None,
    ) -> str | None:
        """Return what a hand would touch at given joints; None if nothing. See `Obstacles.touched`."""
        return self.obstacles.touched(self.qpos, hand.number, joints, opening, load, between, beside)

    def posed_qpos(self, hand: Hand, joints: Array, opening: float, held: Held | None) -> Array:
        """Return MuJoCo's positions (nq,) with one hand, and what it holds, moved; everything else is unchanged."""
        load = None if held is None else Load(held.thing, held.T_thing_in_pinch)
        return self.obstacles.posed(self.qpos, hand.number, joints, opening, load)

    # -- motions

    def free_path(self, hand: Hand, goal: Array, opening: float | None = None, load: Load | None = None) -> Array:
        """Return a collision-free motion (n + 1, dof) of a hand to joints `goal`, the simplest that was found.

        A hand that touches something at the start may first rise straight up.

        Args:
            opening: of each finger at the end, m. Collisions are checked with the larger opening of start and end.
            load: what the hand holds.

        Raises:
            SkillFailedError: no such motion was found.
        """
        opening_on_way = max(hand.opening, opening if opening is not None else 0.0)

        def touched(joints: Array) -> str | None:
            return self.touched(hand, joints, opening_on_way, load)

        path = find_free_path(hand, goal, touched, self.tick, self._rng)
        if path is None:
            blocked = touched(goal) or touched(hand.joints) or "everything between"
            raise SkillFailedError(Cause.UNREACHABLE, f"no free way for the {hand.side} arm: {blocked} is in the way")
        return path

    def line(self, hand: Hand, T_pinch_in_world: Array, speed: float = LINE_SPEED) -> Array:
        """Return a motion (n + 1, dof) that moves a hand's pinch frame in a straight line to a pose (4, 4).

        Raises:
            SkillFailedError: the line leaves the arm's reach.
        """
        path = straight(hand.ik, hand.joints, T_pinch_in_world, self.tick, speed)
        if path is None:
            raise SkillFailedError(Cause.UNREACHABLE, f"a straight line leaves the {hand.side} arm's reach")
        return path

    def curve(self, hand: Hand, pose_at: Callable[[float], Array], seconds: float) -> Array:
        """Return a motion (n + 1, dof) that moves a hand's pinch frame along a curve, see `joint_motion.traced`.

        Raises:
            SkillFailedError: the curve leaves the arm's reach.
        """
        path = traced(hand.ik, hand.joints, pose_at, seconds, self.tick)
        if path is None:
            raise SkillFailedError(Cause.UNREACHABLE, f"the way of what it holds leaves the {hand.side} arm's reach")
        return path

    def still(self, hand: Hand, ticks: int) -> Array:
        """Return a motion (ticks + 1, dof) of a hand that keeps its joints."""
        return np.tile(hand.joints, (ticks + 1, 1))

    def segment(
        self, motions: Mapping[Hand, Array], fingers: Mapping[Hand, Fingers] | None = None, arrives: bool = True
    ) -> Segment:
        """Return the segment in which some arms move, and update the commanded state of the hands.

        The other arms keep their joints. Torques compensate gravity of the arms and of what they hold.

        Args:
            motions: hand -> joints (n + 1, dof). A motion shorter than the longest waits at its end.
            fingers: hand -> target of its fingers; the fingers of other hands keep theirs.
            arrives: see `Segment`.
        """
        ticks = max(len(motion) for motion in motions.values()) - 1
        paths = []
        for hand in self.hands:
            joints = motions.get(hand)
            joints = self.still(hand, ticks) if joints is None else _padded(joints, ticks)
            target = (fingers or {}).get(hand, Fingers(hand.opening, hand.grip))
            progress = np.array([ease((k + 1) / ticks) for k in range(ticks)])
            opening = hand.opening + progress * (target.opening - hand.opening)
            grip = hand.grip + progress * (target.grip - hand.grip)
            paths.append(
                JointPath(
                    joints=joints,
                    torques=self._torques(hand, joints, opening),
                    gripper=opening,
                    grip=grip,
                    magnet=(hand.magnet,) * ticks,
                    tick=self.tick,
                )
            )
            hand.joints, hand.opening, hand.grip = joints[-1].copy(), target.opening, target.grip
        return Segment(tuple(paths), arrives)

    def wait(self, ticks: int) -> Segment:
        """Return the segment in which all arms keep their joints."""
        return self.segment({self.hands[0]: self.still(self.hands[0], ticks)})

    def holding_torques(self, hand: Hand, joints: Array, opening: float) -> Array:
        """Return the torques (dof,) in N m that hold an arm, and what it carries, still at joints (dof,), rad."""
        still: Array = self._torques(hand, np.tile(joints, (3, 1)), np.full(2, opening))[-1]
        return still

    def _torques(self, hand: Hand, joints: Array, opening: Array) -> Array:
        torques = hand.dynamics.torques(joints, opening, self.tick)
        if hand.held is None:
            return torques
        item = self.items[hand.held.thing]
        centre = hand.held.T_thing_in_pinch @ np.array([*item.inertia.centre, 1.0])
        weight = item.inertia.mass * _GRAVITY
        return torques + hand.dynamics.weight_torques((joints[1:] + joints[:-1]) / 2, centre[:3], weight)


def _padded(joints: Array, ticks: int) -> Array:
    return np.concatenate([joints, np.tile(joints[-1], (ticks + 1 - len(joints), 1))])


class SkillFailedError(Exception):
    """No motion was found, or a skill did not have its effect. An attempt's outcome records it.

    Attributes:
        cause: as in `Outcome`.
    """

    def __init__(self, cause: Cause, detail: str) -> None:
        super().__init__(detail)
        self.cause = cause


T = TypeVar("T")


class CachedIterable(Generic[T]):
    """An iterable that takes elements from its source on demand, and keeps them for later iterations.

    Args:
        source: iterated once.
    """

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
_RAISE = 0.05  # m, least height by which a hand rises before it crosses the table

_RETREAT_STEP, _MAX_RETREAT_STEPS = 0.02, 6  # m and count, the steps in which a hand rises from a contact

# Returns what an arm would touch at joints (dof,); None if nothing.
Touched = Callable[[Array], str | None]


def find_free_path(hand: Hand, goal: Array, touched: Touched, tick: float, rng: np.random.Generator) -> Array | None:
    """Return a collision-free motion (n + 1, dof) of a hand to joints `goal` (dof,); None if none was found.

    Simple motions are tried before a search. A hand that touches something at the start first rises straight up if no
    direct motion exists.

    Args:
        tick: length of a control tick, s.
        rng: random numbers of the search.
    """
    path = _path_from(hand, hand.joints, goal, touched, tick, rng)
    if path is None and touched(hand.joints) is not None and (retreat := _retreat_up(hand, touched, tick)) is not None:
        onwards = _path_from(hand, retreat[-1], goal, touched, tick, rng)
        path = None if onwards is None else np.concatenate([retreat[:-1], onwards])
    return path


def _path_from(
    hand: Hand, start: Array, goal: Array, touched: Touched, tick: float, rng: np.random.Generator
) -> Array | None:
    for points in _simple_paths(hand, start, goal):
        path = through(points, hand.arm.motor_speed, tick)
        if clear(path, touched):
            return path
    found = search(start, goal, hand.arm.joint_range, touched, rng)
    return None if found is None else through(found, hand.arm.motor_speed, tick)


def _retreat_up(hand: Hand, touched: Touched, tick: float) -> Array | None:
    """Return the shortest motion straight up after which a hand touches nothing; None without one."""
    T = hand.pinch_at(hand.joints)
    for _ in range(_MAX_RETREAT_STEPS):
        T[2, 3] += _RETREAT_STEP
        path = straight(hand.ik, hand.joints, T, tick, LINE_SPEED)
        if path is not None and touched(path[-1]) is None:
            return path
    return None


def _simple_paths(hand: Hand, start: Array, goal: Array) -> list[list[Array]]:
    """Return waypoints of simple motions: direct; up, across and down; or over one intermediate posture."""
    raised = []
    for joints in (start, goal):
        T = hand.pinch_at(joints)
        T[2, 3] = max(T[2, 3] + _RAISE, _CROSSING_HEIGHT)
        raised.append(hand.reach(T, [joints], PASSING))
    up, down = raised
    paths = [[start, goal]]
    if up is not None and down is not None:
        paths.append([start, up, down, goal])
    paths += [[start, via, goal] for via in (down, up, hand.ready) if via is not None]
    return paths
