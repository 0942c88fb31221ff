"""What skills work with: the scene as it is now, the hands, and motions that touch nothing."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import mujoco
import numpy as np

from ..config.things.thing import ObjectConfig
from ..geometry.attitudes import steady_attitudes
from ..geometry.se3 import Array, inverse, pose, rotation_z
from ..goals.world import TABLE
from ..planning.joint_motion import LINE_SPEED, clear, ease, straight, through, traced
from ..planning.obstacles import Load, Obstacles
from ..planning.tree_search import search
from ..sim.antipodal import Span, spans
from ..sim.shapes import geom_corners
from ..sim.world import SimWorld
from ..types import Cause, JointPath
from .grips import CLEARANCE, Grip, antipodal_grips, fingertip_grips, friction_grips, sideways_grips, weld_grips
from .hand import PASSING, Hand, Held

_GRAVITY = 9.81

# Room around a thing that is put down, and where in front of the arms there may be some, m.
_FREE_MARGIN = 0.02
_MIDDLE_X = (0.34, 0.42, 0.28)
_MIDDLE_Y = (0.0, 0.10, -0.10, 0.20, -0.20)

# A thing that leans less than this stands upright, rad.
_UPRIGHT_TILT = math.radians(10.0)

V = TypeVar("V")


@dataclass(frozen=True)
class Segment:
    """A stretch of motion of all arms: one path each, all of one length.

    Attributes:
        paths: of the arms, in their order.
        arrives: whether what comes after needs arms that have come where they were told to be, and not only almost.
    """

    paths: tuple[JointPath, ...]
    arrives: bool = True

    @property
    def ticks(self) -> int:
        """How many control ticks it takes."""
        return len(self.paths[0].gripper)


@dataclass(frozen=True)
class Fingers:
    """What fingers do during a motion: they go from where they are to an opening (m) and a grip (N)."""

    opening: float
    grip: float = 0.0


class Bench:
    """The state that skills find, and what they plan with.

    Args:
        world: the things, as they are now.
        acting: numbers of the hands that may be used; the others stay where they are.
        first: number of the hand that begins; the other one of two is the second.
        items: thing -> its config.
        rng: for searches; it makes nothing random that was not sampled from an attempt's numbers.
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

    # -- the state

    @property
    def qpos(self) -> Array:
        """MuJoCo's positions (nq,) now."""
        positions: Array = self.world.data.qpos
        return positions

    def T_pinch(self, hand: Hand) -> Array:
        """Where a hand's pinch frame really is (4, 4), in `world`."""
        site = self.world.data.site(f"{hand.arm.prefix}pinch_site")
        return pose(site.xpos, site.xmat.reshape(3, 3))

    def opening(self, hand: Hand) -> float:
        """How far each finger of a hand really is open, m."""
        fingers = hand.arm.fingers
        assert fingers is not None, "skills are for hands with fingers"
        return float(self.qpos[fingers.qpos[0]] * fingers.sign[0])

    def side_of(self, arm: str) -> str:
        """The side that an argument names, "first" and "second" by their turn; others, such as "any", as they are."""
        return self._side_of_turn.get(arm, arm)

    def free_hands(self, arm: str) -> list[Hand]:
        """The hands that may be used, hold nothing, and that an argument names: "any" names all."""
        return [hand for hand in self.acting if self.side_of(arm) in ("any", hand.side) and hand.held is None]

    def update_held(self, hand: Hand) -> Held:
        """What a hand holds, and how, now.

        Raises:
            SkillFailedError: it holds nothing any more.
        """
        held = hand.held
        assert held is not None, "a hand that holds nothing is not asked what it holds"
        if hand.side not in self.world.holders(held.thing):
            hand.held = None
            raise SkillFailedError(Cause.DROPPED, f"the {held.thing} fell out of the {hand.side} hand")
        hand.held = Held(held.thing, inverse(self.T_pinch(hand)) @ self.world.pose(held.thing))
        return hand.held

    @contextmanager
    def reserve(self, margin: float) -> Iterator[None]:
        """Let hands reach only with every joint at least this far from its stops, rad."""
        for hand in self.hands:
            hand.reserve = margin
        try:
            yield
        finally:
            for hand in self.hands:
                hand.reserve = 0.0

    def cached(self, key: Hashable, make: Callable[[], V]) -> V:
        """Return what `make` returns, computed once for a key while nothing moves and the reserve stays the same."""
        key, state = (self.hands[0].reserve, key), self.qpos.tobytes()
        if self._cache[0] != state:
            self._cache = (state, {})
        if key not in self._cache[1]:
            self._cache[1][key] = make()
        found: V = self._cache[1][key]
        return found

    def clear_cache(self) -> None:
        """Drop what `once` has kept. It refers to the bench, which would otherwise stay in memory until Python looks
        for cycles.
        """
        self._cache = (b"", {})

    def grips(self, thing: str, max_opening: float) -> Iterator[Grip]:
        """The paths in which a hand, whose fingers open so far each (m), can hold a thing: the best known ones first."""
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
        """Half the room (2,) that a thing takes along x and y when it stands upright, turned by `heading`, m."""
        low, high = self._block(thing)
        corners = np.array([[x, y] for x in (low[0], high[0]) for y in (low[1], high[1])])
        half: Array = np.abs(corners @ rotation_z(heading)[:2, :2].T).max(axis=0)
        return half

    def height_on(self, thing: str, place: Array, onto: str, heading: float) -> float:
        """Height in `world` at which a thing's origin comes to rest, upright, over a place (2,), m."""
        return self.height_of(thing, pose((*place, 0.0), rotation_z(heading)), onto)

    def height_of(self, thing: str, T: Array, onto: str) -> float:
        """Height in `world` at which the origin of a thing, turned as in a pose (4, 4), comes to rest below it, m."""
        top = float(self.cached(("bounds", onto), lambda: self.world.bounds(onto))[1][2])
        low, high = self._block(thing)
        T_over = T.copy()
        T_over[2, 3] = top + float(np.abs(T[2, :3]) @ (high - low))
        table_low, table_high = self.world.bounds(TABLE)
        rest = self.obstacles.rest_height(self.qpos, thing, T_over, float(table_low[2]))
        # What comes down goes through cloth there, since nothing is in the way of a hand that is to press on it.
        on_cloth = onto in self.items and self.items[onto].cloth is not None
        return rest + (top - float(table_high[2]) if on_cloth else 0.0)

    def steady_rotations(self, thing: str) -> list[Array]:
        """How a thing may be turned (3, 3) to lie steadily, without its headings: upright first."""
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
        """Whether a thing that stands upright would have room at a place (2,) on the table, m."""
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
        """The middle (2,) between the bases of the arms that may be used, in `world`, m."""
        middle: Array = np.mean([hand.arm.T_base_in_world[:2, 3] for hand in self.acting], axis=0)
        return middle

    def middle_places(self) -> list[Array]:
        """Places (2,) on the table that are about as near to all arms, in `world`, m."""
        return [self.middle + np.array((x, y)) for x in _MIDDLE_X for y in _MIDDLE_Y]

    def clearance(self, thing: str) -> float:
        """How much wider than around a thing each finger opens to let it go, m."""
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
        """What a hand would touch at given joints, see `Obstacles.touched`."""
        return self.obstacles.touched(self.qpos, hand.number, joints, opening, load, between, beside)

    def posed_qpos(self, hand: Hand, joints: Array, opening: float, held: Held | None) -> Array:
        """MuJoCo's positions (nq,) with a hand, and what it holds, elsewhere, and all else as it is."""
        load = None if held is None else Load(held.thing, held.T_thing_in_pinch)
        return self.obstacles.posed(self.qpos, hand.number, joints, opening, load)

    # -- motions

    def free_path(self, hand: Hand, goal: Array, opening: float | None = None, load: Load | None = None) -> Array:
        """A motion (n + 1, dof) of a hand to joints `goal` that touches nothing: the simplest that is free.

        A hand that touches something where it begins may leave that first, straight up.

        Raises:
            SkillFailedError: none was found.
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
        """A motion (n + 1, dof) that takes a hand's pinch frame straight to a pose (4, 4).

        Raises:
            SkillFailedError: the line leaves the arm's reach.
        """
        path = straight(hand.ik, hand.joints, T_pinch_in_world, self.tick, speed)
        if path is None:
            raise SkillFailedError(Cause.UNREACHABLE, f"a straight line leaves the {hand.side} arm's reach")
        return path

    def curve(self, hand: Hand, pose_at: Callable[[float], Array], seconds: float) -> Array:
        """A motion (n + 1, dof) that takes a hand's pinch frame along a curve, see `joint_motion.traced`.

        Raises:
            SkillFailedError: the curve leaves the arm's reach.
        """
        path = traced(hand.ik, hand.joints, pose_at, seconds, self.tick)
        if path is None:
            raise SkillFailedError(Cause.UNREACHABLE, f"the way of what it holds leaves the {hand.side} arm's reach")
        return path

    def still(self, hand: Hand, ticks: int) -> Array:
        """A hand that stays where it is (ticks + 1, dof)."""
        return np.tile(hand.joints, (ticks + 1, 1))

    def segment(
        self, motions: Mapping[Hand, Array], fingers: Mapping[Hand, Fingers] | None = None, arrives: bool = True
    ) -> Segment:
        """What all arms do while some move: the others hold their place, and what they hold.

        Args:
            motions: hand -> joints (n + 1, dof); a shorter motion than the longest waits at its end.
            fingers: hand -> what its fingers do meanwhile; of others they stay as they are.
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
        """All hands hold their places."""
        return self.segment({self.hands[0]: self.still(self.hands[0], ticks)})

    def holding_torques(self, hand: Hand, joints: Array, opening: float) -> Array:
        """Torques (dof,) in N m that hold a hand, and what it holds, still at given joints (dof,), rad."""
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
    """A skill found no way, or its effect did not come about. It is data, and no error of the program.

    Attributes:
        cause: as an outcome tells it.
    """

    def __init__(self, cause: Cause, detail: str) -> None:
        super().__init__(detail)
        self.cause = cause


T = TypeVar("T")


class CachedIterable(Generic[T]):
    """An iterable that takes elements from its source when they are first asked for, and keeps them.

    Args:
        source: is iterated once.
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


# Over the table, a hand that crosses it stays at least so high, m.
_CROSSING_HEIGHT = 0.22
_RAISE = 0.05

# A hand leaves what it touches in steps of so much, m, so many at most.
_RETREAT_STEP, _MAX_RETREAT_STEPS = 0.02, 6

# What an arm would touch with joints (dof,); None is nothing.
Touched = Callable[[Array], str | None]


def find_free_path(hand: Hand, goal: Array, touched: Touched, tick: float, rng: np.random.Generator) -> Array | None:
    """The simplest motion (n + 1, dof) of a hand to joints `goal` (dof,) that touches nothing; None if none was found.

    A hand that touches something where it begins, as one that has just let go may, leaves that straight up where
    there is no other way.

    Args:
        tick: of control, s.
        rng: of the search, where nothing simple is free.
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
    """Straight up, as far as it takes until a hand touches nothing."""
    T = hand.pinch_at(hand.joints)
    for _ in range(_MAX_RETREAT_STEPS):
        T[2, 3] += _RETREAT_STEP
        path = straight(hand.ik, hand.joints, T, tick, LINE_SPEED)
        if path is not None and touched(path[-1]) is None:
            return path
    return None


def _simple_paths(hand: Hand, start: Array, goal: Array) -> list[list[Array]]:
    """Straight there; or up, across and down; or by way of the posture in which the arm is ready."""
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
