"""Skills that sort cutlery into the compartments of a tray."""

from __future__ import annotations

import itertools
import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field

from ..core.attempt_data import FailureCause
from ..core.config.goals.role_assignment import RoleAssignment
from ..core.config.goals.world import TABLE
from ..core.config.program_task import ProgramTask
from ..core.expert.skills.common_motions import (
    open_and_park_hands,
    park_free_hands,
    release_and_retreat,
    rest_segment,
)
from ..core.expert.skills.grasp_candidates import is_orientation_plausible
from ..core.expert.skills.hand import WAYPOINT_TOLERANCE, Hand, HeldObject
from ..core.expert.skills.handover import Handover
from ..core.expert.skills.pick import Pick, ReachableGrasp
from ..core.expert.skills.place import HOVER_HEIGHT, PlaceSkill, pose_raised_by
from ..core.expert.skills.planning_context import FingerTarget, MotionSegment, PlanningContext, SkillFailedError
from ..core.expert.skills.skill import ArmSelector, Skill, find_holding_hand
from ..core.geometry.se3 import Array, invert_pose, pose, rotation_from_vector, rotation_z, yaw
from ..core.scene.start_sampling import footprint_corners, footprint_distance
from ..core.sim.sim_world import SimWorld

_LOGGER = logging.getLogger("yamsim")

_MIN_SHARE_INSIDE = 0.85  # of an object's volume; KitchenBench requires a little less
_MAX_TRIES_PER_OBJECT = 4  # times that a move of one object is tried
_OUTSIDE_TRAY_PENALTY = 1.5  # tries added for objects outside the tray, so that those inside come first
_PARKED_TOLERANCE = 1e-6  # rad; an arm whose joints are this near to the ready posture counts as out of the way
_LIFT_HEIGHT = 0.06  # m; cutlery that hangs in the fingers clears the tray's wall
_HANDOVER_HEIGHT = 0.25  # m over the table, of the object's origin

_GRID_STEP = 0.02  # m, largest step between places in a compartment
_HEIGHT_STEP = 0.001  # m; a place that is lower by this is better
_FREE_DISTANCE = 0.003  # m from all other objects; a free place is preferred
_MAX_PLACES = 12  # free places for each orientation, and occupied places
# Shares of `release_clearance` by which each finger opens, in the order tried; the last one also if a finger touches
# something. A finger that opened against a wall lifted the tray when the hand rose, and with 0.25 a fork stayed between
# the fingers.
_RELEASE_SHARES = (1.0, 0.7, 0.4)
_RELEASE_DISTANCE = 0.001  # m, least distance of opened fingers from walls and other objects
_DROP_HEIGHT = 0.010  # m, height of release where fingers would touch the tray; no other value was tried
_TABLE_GRID_STEP = 0.04  # m, between places on the table
_MAX_ASIDE_DISTANCE = 0.30  # m, of a place on the table from the object
_ASIDE_GAP = 0.015  # m, least distance from other objects
_ASIDE_HEADINGS = (0.0, math.pi / 2, math.pi, -math.pi / 2)  # rad, of an object on the table
_MAX_GRASPS = 8  # of each hand, tested at the places on the table: each costs an IK call per place

_UPRIGHT_COSINE = math.cos(math.radians(3.0))  # of the tilt; an object with a larger cosine stays upright
_TILTED_COSINE = 0.6  # of the tilt; an object with a smaller cosine stays on its side or head

_MAX_FREE_DISTANCE = 0.040  # m, largest measured free distance on each side before a slide
_MIN_HORIZONTAL = 0.5  # cosine of the longest side's angle above horizontal; with less, an object stands on its end
_MIN_SLIDE = 0.005  # m, shorter slides are not tried
_MIN_SLID_DISTANCE = 0.002  # m; an object that moved less has not slid
_FLAT_HEIGHT = 0.006  # m, pressed top over the object's lowest point; a higher part would roll
_EDGE_HEIGHT = 0.006  # m, under the top of an object on its side, of parts whose edge is pressed; no other was tried
# m, path of the pressing hand that makes an object on its side fall over: its upper edge passes over the lower one.
# Cutlery is up to 31 mm wide.
_TOPPLING_DISTANCE = 0.025
_PRESS_POINT_SPACING = 0.012  # m, between places to press
_APPROACH_HEIGHT = 0.07  # m over the pressing pose, where the descent starts
_CHECK_HEIGHT = 0.012  # m over the pressing pose, where contacts with other objects are checked
_SLIDE_SPEED = 0.10  # m/s, speed of a pressing hand
_OVERTRAVEL = 0.006  # m, extra path, because friction shortens a slide

_SIDE_TILTS = tuple(math.radians(angle) for angle in (0, 20, -20, 35, -35))  # rad, of the hand to the side
_LONG_TILTS = tuple(math.radians(angle) for angle in (0, 20, -20, 40, -40))  # rad, of the hand along the object


class PlaceInCompartment(PlaceSkill):
    """Place a long object along a compartment, beside objects of the roles `beside` if there is room, else on them."""

    ROLES: ClassVar[tuple[str, ...]] = ("thing", "into")
    LOWERING_SPEED: ClassVar[float] = 0.25
    into: str
    beside: tuple[str, ...]

    def support_name(self, roles: RoleAssignment) -> str:
        """Return the name of the compartment."""
        return roles.object_of(self.into)

    def goal_poses(self, context: PlanningContext, roles: RoleAssignment, thing: str) -> list[Array]:
        """Return poses (4, 4) along the compartment: free places first, then the lowest on other objects."""
        world, into, local_box = context.world, roles.object_of(self.into), context.world.local_box(thing)
        others = [
            footprint_corners(world.local_box(name), world.pose(name))
            for name in itertools.chain.from_iterable(map(roles.objects_of, self.beside))
            if name != thing
        ]
        free, occupied = list[Array](), list[tuple[float, Array]]()
        for orientation in _orientations(world, thing):
            unoccupied = list[Array]()
            for off, T_goal in sorted(
                self._poses_along_compartment(context, thing, into, orientation), key=lambda each: each[0]
            ):
                there = footprint_corners(local_box, T_goal)
                if any(footprint_distance(there, other) < _FREE_DISTANCE for other in others):
                    occupied.append((off, T_goal))
                else:
                    unoccupied.append(T_goal)
            free += unoccupied[:: math.ceil(len(unoccupied) / _MAX_PLACES)] if unoccupied else []
        _set_rest_heights(context, thing, into, free)
        for _, T_goal in occupied:
            T_goal[2, 3] = context.rest_height_of(thing, T_goal, into)
        occupied.sort(key=lambda each: (round(each[1][2, 3] / _HEIGHT_STEP), each[0]))
        goals = [*free, *(T_goal for _, T_goal in occupied[:_MAX_PLACES])]
        return [*goals, *(pose_raised_by(T_goal, _DROP_HEIGHT) for T_goal in goals)]

    @staticmethod
    def _poses_along_compartment(
        context: PlanningContext, thing: str, into: str, orientation: Array
    ) -> Iterator[tuple[float, Array]]:
        """Yield poses (4, 4) along a compartment, without height, and their distance to its middle, m."""
        world = context.world
        T, (low, high), local_box = world.pose(into), world.local_box(into), world.local_box(thing)
        for R in _rotations_along(local_box, orientation, T):
            corners = footprint_corners(local_box, pose(rotation=T[:3, :3].T @ R))
            first, last = low[:2] - corners.min(axis=0), high[:2] - corners.max(axis=0)
            if (first > last).any():
                continue
            for place in itertools.product(*(_places_between(first[k], last[k]) for k in (0, 1))):
                off = math.hypot(*(np.array(place) - (first + last) / 2))
                yield off, pose((T @ (*place, 0.0, 1.0))[:3], R)

    def _release(self, context: PlanningContext, hand: Hand, thing: str) -> Iterator[MotionSegment]:
        """Yield the motions that release the object, with fingers that do not press on the walls."""
        clearances = [share * context.release_clearance(thing) for share in _RELEASE_SHARES]
        free = (
            clearance
            for clearance in clearances
            if not context.find_contact(
                hand,
                hand.joints,
                min(hand.opening + clearance, hand.max_opening),
                grasped=thing,
                finger_clearance=_RELEASE_DISTANCE,
            )
        )
        # The object comes to rest during the retreat. A wait would take one of the benchmark's 200 actions.
        yield from release_and_retreat(context, hand, next(free, clearances[-1]), _RELEASE_DISTANCE)

    def _hover_joints(self, hand: Hand, T_pinch: Array) -> Array | None:
        """Return joints (dof,) over the goal, if needed by a search from the joints at the goal."""
        joints = super()._hover_joints(hand, T_pinch)
        if joints is not None:
            return joints
        at_goal = hand.solve_ik(T_pinch, (hand.joints, hand.ready_joints), WAYPOINT_TOLERANCE)
        if at_goal is None:
            return None
        return hand.solve_ik(pose_raised_by(T_pinch, HOVER_HEIGHT), (at_goal,), WAYPOINT_TOLERANCE)


def _rotations_along(local_box: Array, orientation: Array, T: Array) -> list[Array]:
    """Return rotations (3, 3) of a long object along a compartment at a pose (4, 4), in both directions.

    `local_box` has the object's lowest and highest corner (2, 3) in its frame, m.
    """
    longest = int(np.argmax(local_box[1] - local_box[0]))
    heading = math.atan2(T[1, 1], T[0, 1]) - math.atan2(orientation[1, longest], orientation[0, longest])
    return [rotation_z(heading + turn) @ orientation for turn in (0.0, math.pi)]


def _orientations(world: SimWorld, thing: str) -> list[Array]:
    """Return rotations (3, 3), up to the heading, to put an object down: upright and in the present orientation."""
    now = world.pose(thing)[:3, :3]
    upright = rotation_z(yaw(world.pose(thing)))
    return [upright] if now[2, 2] > _UPRIGHT_COSINE else [upright, now] if now[2, 2] > _TILTED_COSINE else [now]


def _set_rest_heights(context: PlanningContext, thing: str, onto: str, goals: Sequence[Array]) -> None:
    """Set the heights of poses (4, 4) on a flat free floor; they depend on the orientation alone."""
    heights = dict[tuple[float, ...], float]()
    for T in goals:
        orientation = tuple(T[2, :3].round(6))
        if orientation not in heights:
            heights[orientation] = context.rest_height_of(thing, T, onto)
        T[2, 3] = heights[orientation]


class PutBesideTray(PlaceSkill):
    """Put a long object down on a free place of the table from which `next_place_skill` can follow."""

    next_place_skill: PlaceSkill | None = None

    def goal_poses(self, context: PlanningContext, roles: RoleAssignment, thing: str) -> list[Array]:
        """Return poses (4, 4) on free places of the table: by grasp for `next_place_skill`, then by distance."""
        world, (low, high) = context.world, context.world.aabb(TABLE)
        others = [
            footprint_corners(world.local_box(name), world.pose(name)) for name in world.object_names if name != thing
        ]
        block, now = world.local_box(thing), world.pose(thing)[:2, 3]
        goals = list[Array]()
        for x, y in itertools.product(*(np.arange(float(low[k]), float(high[k]), _TABLE_GRID_STEP) for k in (0, 1))):
            if math.hypot(x - now[0], y - now[1]) > _MAX_ASIDE_DISTANCE:
                continue
            for R, turn in itertools.product(_orientations(world, thing), _ASIDE_HEADINGS):
                T = pose((x, y, 0.0), rotation_z(turn) @ R)
                there = footprint_corners(block, T)
                on_table = (there >= low[:2]).all() and (there <= high[:2]).all()
                if on_table and all(footprint_distance(there, other) >= _ASIDE_GAP for other in others):
                    goals.append(T)
        _set_rest_heights(context, thing, TABLE, goals)
        goals.sort(key=lambda T: float(np.linalg.norm(T[:2, 3] - now)))
        grasps = (
            [] if self.next_place_skill is None else _grasps_that_allow(context, roles, thing, self.next_place_skill)
        )
        return sorted(
            goals,
            key=lambda T: next(
                (rank for rank, hand, T_pinch in grasps if _can_approach_grasp(hand, T @ T_pinch)), math.inf
            ),
        )


def _grasps_that_allow(
    context: PlanningContext, roles: RoleAssignment, thing: str, put: PlaceSkill
) -> list[tuple[int, Hand, Array]]:
    """Return rank, hand, and pinch frame (4, 4) in the object's frame of the grasps with which `put` succeeds, best
    first.
    """
    found = list[tuple[int, Hand, Array]]()
    for hand in context.acting_hands:
        suitable = (
            (rank, hand, grip.T_pinch_in_thing)
            for rank, grip in enumerate(context.grasp_candidates(thing, hand.max_opening))
            if not hand.is_similar_to_failed_grasp(thing, grip.T_pinch_in_thing)
            and put.infeasibility_reason(
                context, roles, hand, thing, invert_pose(grip.T_pinch_in_thing), hand.ready_joints
            )
            is None
        )
        found += itertools.islice(suitable, _MAX_GRASPS)
    return sorted(found, key=lambda each: each[0])


def _can_approach_grasp(hand: Hand, T_pinch: Array) -> bool:
    if not is_orientation_plausible(T_pinch, hand.arm.T_base_in_world):
        return False
    at = hand.solve_ik(T_pinch, (hand.ready_joints,))
    return at is not None and hand.solve_ik(pose_raised_by(T_pinch, _LIFT_HEIGHT), (at,)) is not None


def _places_between(first: float, last: float) -> Array:
    return np.linspace(first, last, max(1, math.ceil((last - first) / _GRID_STEP)) + 1)


@dataclass(frozen=True)
class _PressPose:
    """Joints (dof,) above a point to press, and poses (4, 4) of the pinch frame above and pressing."""

    above: Array
    T_above: Array
    T_press: Array


class Slide(Skill):
    """Press closed fingers onto an object, and slide it sideways to the middle of its free space.

    An object on its side is pressed on its upper edge, and falls over.
    """

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    REQUIRES_HELD_OBJECT: ClassVar[bool | None] = False
    thing: str
    arm: ArmSelector = "any"

    def run(
        self, context: PlanningContext, roles: RoleAssignment, next_skills: Sequence[Skill]
    ) -> Iterator[MotionSegment]:
        """Yield the motions that press on the object and slide it; see `Skill.run`."""
        thing = roles.object_of(self.thing)
        across = _slide_direction(context, thing)
        one, other = (
            context.collision_checker.free_distance(context.qpos, thing, side * across, _MAX_FREE_DISTANCE)
            for side in (1.0, -1.0)
        )
        if on_side := is_on_side(context.world, thing):
            toppling = math.copysign(_TOPPLING_DISTANCE, one - other)
            distances = [toppling, -toppling]
        elif abs(one - other) / 2 >= _MIN_SLIDE:
            distances = [(one - other) / 2]
        else:
            raise SkillFailedError(
                FailureCause.UNREACHABLE, f"the {thing} has no more room on one side than on the other"
            )
        before = context.world.pose(thing)[:2, 3].copy()
        hands = sorted(
            context.free_hands(self.arm),
            key=lambda hand: float(np.linalg.norm(hand.arm.T_base_in_world[:2, 3] - before)),
        )
        for distance, hand in itertools.product(distances, hands):
            shift = distance * across
            for press in self._press_poses(context, hand, thing, shift):
                yield from park_free_hands(context, hand)
                yield from _slide_motions(context, hand, press, shift)
                moved = float((context.world.pose(thing)[:2, 3] - before) @ shift) / abs(distance)
                if on_side and is_on_side(context.world, thing):
                    raise SkillFailedError(FailureCause.OFF_TARGET, f"the {thing} did not fall over")
                if not on_side and moved < _MIN_SLID_DISTANCE:
                    raise SkillFailedError(FailureCause.OFF_TARGET, f"the {thing} did not slide")
                return
        raise SkillFailedError(FailureCause.UNREACHABLE, f"no arm reaches a place where it could press on the {thing}")

    def _press_poses(self, context: PlanningContext, hand: Hand, thing: str, shift: Array) -> Iterator[_PressPose]:
        """Yield poses with which a hand slides an object; at the start and the end, it touches no other one."""
        away = shift / np.linalg.norm(shift)
        down = np.array((0.0, 0.0, -1.0))
        upright = np.column_stack([np.cross((*away, 0.0), down), (*away, 0.0), down])
        far = np.array((*(shift + _OVERTRAVEL * away), 0.0))
        places = _press_points(context, thing, away)
        for tilt, lean, place, turn in itertools.product(_SIDE_TILTS, _LONG_TILTS, places, (0.0, math.pi)):
            turned = rotation_from_vector([tilt, 0.0, 0.0]) @ rotation_from_vector([0.0, lean, 0.0])
            R = upright @ turned @ rotation_from_vector([0.0, 0.0, turn])
            T_press = pose(place, R)
            T_touching, T_above, T_end = (T_press.copy() for _ in range(3))
            T_touching[2, 3] += _CHECK_HEIGHT
            T_above[2, 3] += _APPROACH_HEIGHT
            T_end[:3, 3] += far
            above = hand.solve_ik(T_above, (hand.joints, hand.ready_joints), WAYPOINT_TOLERANCE)
            if above is None or context.find_contact(hand, above, 0.0):
                continue
            touching = hand.solve_ik(T_touching, (above,), WAYPOINT_TOLERANCE)
            if touching is None or context.find_contact(hand, touching, 0.0, grasped=thing):
                continue
            T_touching[:3, 3] += far
            end = hand.solve_ik(T_touching, (touching,), WAYPOINT_TOLERANCE)
            if end is None or context.find_contact(hand, end, 0.0, grasped=thing):
                continue
            yield _PressPose(above, T_above, T_press)


def _slide_motions(context: PlanningContext, hand: Hand, press: _PressPose, shift: Array) -> Iterator[MotionSegment]:
    closed = {hand: FingerTarget(0.0)}
    yield context.make_segment({hand: context.plan_free_path(hand, press.above)}, closed, wait_for_arrival=False)
    yield context.make_segment({hand: context.plan_line(hand, press.T_press)})
    T_end = press.T_press.copy()
    T_end[:2, 3] += shift * (1.0 + _OVERTRAVEL / float(np.linalg.norm(shift)))
    yield context.make_segment({hand: context.plan_line(hand, T_end, _SLIDE_SPEED)})
    T_up = T_end.copy()
    T_up[2, 3] = press.T_above[2, 3]
    yield context.make_segment({hand: context.plan_line(hand, T_up)}, wait_for_arrival=False)
    yield rest_segment(context)


def _slide_direction(context: PlanningContext, thing: str) -> Array:
    """Return the horizontal direction (2,) in `world` across an object's longest side.

    Raise SkillFailedError if the object stands on its end.
    """
    low, high = context.world.local_box(thing)
    longest = context.world.pose(thing)[:2, int(np.argmax(high - low))]
    if np.linalg.norm(longest) < _MIN_HORIZONTAL:
        raise SkillFailedError(FailureCause.UNREACHABLE, f"the {thing} stands on its end")
    across: Array = np.array((-longest[1], longest[0])) / np.linalg.norm(longest)
    return across


def _press_points(context: PlanningContext, thing: str, away: Array) -> list[Array]:
    """Return points (3,) on top of an object's flat parts in `world`, m, the farthest along the slide first.

    If the object is on its side, the points are on its upper edge.
    """
    bounds = context.world.geom_aabbs(thing)
    (lowest, highest), middle = np.array(context.world.aabb(thing))[:, 2], context.world.pose(thing)[:2, 3]
    tops = [np.array((*(first + last)[:2] / 2, last[2])) for first, last in bounds]
    if is_on_side(context.world, thing):
        tops = [top for top in tops if top[2] > highest - _EDGE_HEIGHT]
    else:
        tops = [top for top in tops if top[2] < lowest + _FLAT_HEIGHT]
    found: list[Array] = []
    for place in sorted(tops, key=lambda place: -float((place[:2] - middle) @ away)):
        if all(np.linalg.norm(place - other) > _PRESS_POINT_SPACING for other in found):
            found.append(place)
    return found


def is_on_side(world: SimWorld, thing: str) -> bool:
    """Whether an object lies on its side."""
    return abs(float(world.pose(thing)[2, 2])) < _TILTED_COSINE


class Sort(Skill):
    """Put the objects of each role into the compartment `into[role]`, a region, unless they are there."""

    ROLES: ClassVar[tuple[str, ...]] = ()
    REGION_ARGUMENTS: ClassVar[tuple[str, ...]] = ("into",)
    REQUIRES_HELD_OBJECT: ClassVar[bool | None] = False
    TYPICAL_SECONDS: ClassVar[float] = 30.0
    into: Annotated[Mapping[str, str], Field(min_length=1)]

    def roles(self) -> tuple[tuple[str, str], ...]:
        """Return (argument, role) of all objects and compartments."""
        pairs = ((f"into.{role}", name) for role, region in self.into.items() for name in (role, region))
        return tuple(pairs)

    def task_fault(self, task: ProgramTask) -> tuple[str, str] | None:
        """Check that each key names objects, and each value a region."""
        for role, region in self.into.items():
            if role in task.regions:
                return "into", f"the region {role} cannot be sorted; give a role of objects"
            if region not in task.regions:
                known = ", ".join(task.regions) or "(none)"
                return "into", f"{region!r} is not a region of the task; regions: {known}"
        return None

    def run(
        self, context: PlanningContext, roles: RoleAssignment, next_skills: Sequence[Skill]
    ) -> Iterator[MotionSegment]:
        """Yield the motions that sort the objects in turn, until all are done or one has failed four times."""
        tries: dict[str, int] = {}
        failures: dict[str, str] = {}

        while left := self.remaining_objects(context.world, roles, tries):
            name = left[0]
            if tries.get(name, 0) == _MAX_TRIES_PER_OBJECT:
                _LOGGER.warning("the expert leaves the %s where it is: %s", name, failures[name])
                return
            parked = all(np.abs(hand.joints - hand.ready_joints).max() < _PARKED_TOLERANCE for hand in context.hands)
            try:
                yield from self._move_to_compartment(context, roles, name, tries.get(name, 0) + 1)
            except SkillFailedError as error:
                failures[name] = str(error)
                yield from _put_on_table(context, roles, name)
                yield from open_and_park_hands(context)
                # A try without parked arms does not count: one arm may have blocked the other.
                tries[name] = tries.get(name, 0) + parked

    def _compartments(self, roles: RoleAssignment) -> dict[str, str]:
        """Return object -> name of its compartment."""
        return {name: region for role, region in self.into.items() for name in roles.objects_of(role)}

    def _in_tray(self, world: SimWorld, name: str) -> bool:
        return any(world.volume_fraction_inside(name, compartment) > 0.5 for compartment in self.into.values())

    def remaining_objects(self, world: SimWorld, roles: RoleAssignment, tries: Mapping[str, int]) -> list[str]:
        """Return the objects outside their compartment: first those on which nothing lies, with fewer tries, and in the
        tray.
        """
        names = [
            name
            for name, region in self._compartments(roles).items()
            if world.volume_fraction_inside(name, region) < _MIN_SHARE_INSIDE
        ]
        seen = {name: footprint_corners(world.local_box(name), world.pose(name)) for name in names}

        def sorting_rank(name: str) -> tuple[bool, float, float]:
            covered = any(
                footprint_distance(seen[name], seen[other]) < 0 and world.pose(other)[2, 3] > world.pose(name)[2, 3]
                for other in names
                if other != name
            )
            waits = tries.get(name, 0) + (0.0 if self._in_tray(world, name) else _OUTSIDE_TRAY_PENALTY)
            return covered, waits, -float(world.pose(name)[1, 3])

        return sorted(names, key=sorting_rank)

    def _move_to_compartment(
        self, context: PlanningContext, roles: RoleAssignment, name: str, number: int
    ) -> Iterator[MotionSegment]:
        """Bring an object to its compartment. `number` counts the tries: 1 by one arm; 2 after a slide; 3 after putting
        it beside the tray; 4 by a handover.
        """
        pick = PickNarrowObject(thing=name, lift=_LIFT_HEIGHT)
        put = PlaceInCompartment(thing=name, into=self._compartments(roles)[name], beside=tuple(self.into))
        if number == 2 or is_on_side(context.world, name):
            with suppress(SkillFailedError):
                yield from Slide(thing=name).run(context, roles, (pick,))
        if number == 3:
            put_aside = PutBesideTray(thing=name, next_place_skill=put)
            yield from pick.run(context, roles, (put_aside,))
            yield from put_aside.run(context, roles, ())
        give = Handover(thing=name, height=_HANDOVER_HEIGHT)
        between = (give,) if number > 3 else ()
        yield from pick.run(context, roles, (*between, put))
        if between:
            yield from give.run(context, roles, (put,))
        yield from put.run(context, roles, ())


class PickNarrowObject(Pick):
    """Grasp a narrow object: the arm need not be at rest before the fingers close.

    A grasp that slips is not tried again with that object.
    """

    WAIT_FOR_REST: ClassVar[bool] = False

    def grasp_and_lift(
        self, context: PlanningContext, hand: Hand, thing: str, found: ReachableGrasp
    ) -> Iterator[MotionSegment]:
        """Yield the motions of `Pick`; note a grasp that slips, so that it is not tried again."""
        try:
            yield from super().grasp_and_lift(context, hand, thing, found)
        except SkillFailedError as error:
            if error.cause in (FailureCause.SLIPPED, FailureCause.DROPPED):
                hand.failed_grasps.append(HeldObject(thing, invert_pose(found.candidate.T_pinch_in_thing)))
            raise


def _put_on_table(context: PlanningContext, roles: RoleAssignment, name: str) -> Iterator[MotionSegment]:
    """Put a held object onto a free place of the table, else release it a little lower."""
    hand = find_holding_hand(context, name)
    if hand is None:
        return
    try:
        yield from PutBesideTray(thing=name).run(context, roles, ())
    except SkillFailedError:
        T = hand.pinch_pose(hand.joints)
        T[2, 3] -= _LIFT_HEIGHT
        with suppress(SkillFailedError):
            yield context.make_segment({hand: context.plan_line(hand, T)})
        yield from release_and_retreat(context, hand, context.release_clearance(name))
