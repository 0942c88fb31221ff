"""Checks of a task in a config: its program, and the reachability of its places."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from .core.config.goals.predicate import Predicate
from .core.config.goals.predicates import HandedOver, Hung, On, WasHandedOver
from .core.config.goals.world import TABLE
from .core.config.objects.object_config import ObjectConfig
from .core.config.program_task import ProgramTask
from .core.config.recording import RecordConfig, check_fingers
from .core.expert.skills.program import build_program, parse_steps
from .core.expert.skills.skill import Skill
from .core.files.documents.config_base import Config, ConflictError
from .core.geometry.se3 import Array
from .core.scene.arm_model import kinematic_model
from .goal_consistency import find_contradiction


def check_task_config(config: Config) -> None:
    """Check that the task of a task or recording config can be performed.

    If not, ConflictError has the paths from the config's root.
    """
    if isinstance(config, ProgramTask):
        check_program(config)
    elif isinstance(config, RecordConfig):
        sides = [config.rig.arms[k].side for k in config.acting_indices]
        # An error that appears only with the sides of the rig's arms is also reported for the keys `rig` and `arm`.
        for known_sides, blamed in ((None, ()), (sides, (("rig",), ("arm",)))):
            try:
                check_program(config.task, known_sides)
            except ConflictError as error:
                raise ConflictError(str(error), *(("task", *path) for path in error.paths), *blamed) from error
        if config.grasp == "weld":
            _check_openings(config, config.task)
        _check_reach(config)
        _check_places(config, config.task)


def check_program(task: ProgramTask, sides: Sequence[str] | None = None) -> None:
    """Check that a task's program names existing skills, roles and parts, and that hands are free when needed.

    `sides` are "left" and "right" of the acting arms; None if unknown. ConflictError has the path from the task's root.
    """
    roles = task.typical_roles
    arms = len(sides) if sides is not None else 2 if task.arms == "all" else 1
    held: set[str] = set()
    reason_against_more_steps: str | None = None
    for path, skill in parse_steps(task.expert, roles, ("expert",), tuple(task.regions)):
        if reason_against_more_steps is not None:
            raise ConflictError(reason_against_more_steps, path)
        for argument, role in skill.roles():
            task.check_argument(skill, argument, role, (*path, *argument.split(".")))
        thing = roles.object_of(skill.roles()[0][1])
        _check_arms(skill, sides, arms, path)
        if skill.REQUIRES_HELD_OBJECT and thing not in held:
            raise ConflictError(f"no hand holds the {thing} at this step; pick it first", path)
        if skill.REQUIRES_HELD_OBJECT is False and thing not in held and len(held) >= arms:
            others = " and the ".join(sorted(held))
            raise ConflictError(f"no hand is free for the {thing}; put the {others} down first", path)
        if skill.LEAVES_OBJECT_HELD is not None:
            held = held | {thing} if skill.LEAVES_OBJECT_HELD else held - {thing}
        for argument, role in skill.roles():
            if task.may_be_cloth(role) != skill.HANDLES_CLOTH and argument not in skill.ROLES_OF_ANY_MATERIAL:
                problem = (
                    "is not cloth; give a role of cloth"
                    if skill.HANDLES_CLOTH
                    else "is cloth; it can only be folded, or have objects placed onto it"
                )
                raise ConflictError(f"the {role} {problem}", (*path, argument))
        if fault := skill.task_fault(task):
            argument, reason = fault
            named = dict(skill.roles()).get(argument)
            objects = () if named is None else (("things", task.role_of(named), "of"),)
            raise ConflictError(reason, (*path, argument), *objects)
        reason_against_more_steps = skill.reason_to_be_last(task)
    if (found := find_contradiction(task.goal)) is not None:
        raise ConflictError(found[1], ("goal", *found[0]))
    for path, predicate in task.goal.predicates():
        if isinstance(predicate, Hung) and (missing := predicate.missing_handle(task.possible_objects)):
            raise ConflictError(missing[1], ("goal", *path, missing[0]))


def _check_arms(skill: Skill, sides: Sequence[str] | None, arms: int, path: tuple[str | int, ...]) -> None:
    if arms < skill.hand_count:
        other = f", or {skill.ONE_HAND_ALTERNATIVE}" if skill.ONE_HAND_ALTERNATIVE else ""
        raise ConflictError(
            f"the step `{path[-1]}` needs two arms; use a rig with two arms, without `arms: one`{other}", path
        )
    for argument in ("arm", "to"):
        named = getattr(skill, argument, None)
        missing = sides is not None and named in ("left", "right") and named not in sides
        if missing or (named == "second" and arms < 2):
            only = sides[0] if sides else "first"
            raise ConflictError(
                f"no {named} arm does this task, only the {only} one; give 'first', or 'any'", (*path, argument)
            )


def _check_openings(config: RecordConfig, task: ProgramTask) -> None:
    roles = task.typical_roles
    picked = {
        skill.roles()[0][1]
        for skill in build_program(task, roles)
        if skill.LEAVES_OBJECT_HELD and not skill.REQUIRES_HELD_OBJECT
    }
    items: dict[tuple[str | int, ...], ObjectConfig] = {
        ("task", "things", role, "of", k): item
        for role, player in task.things.items()
        if picked & {role, *roles.objects_of(role)}
        for k, item in enumerate(player.of)
    }
    check_fingers(config.rig, config.acting_arms, items)


def _check_reach(config: RecordConfig) -> None:
    """Check that each start region on the table has a point nearer to an arm's base than the arm's length."""
    arms = _arm_positions_and_reaches(config)
    for role, start in config.start_regions_in_world.items():
        if start.on != TABLE:
            continue
        short = []
        for base, length in arms:
            nearest = np.clip(base, (start.x[0], start.y[0]), (start.x[1], start.y[1]))
            short.append(float(np.linalg.norm(nearest - base)) - length)
        if min(short) > 0:
            raise ConflictError(
                f"the whole region of the {role} is out of reach: its nearest point is {min(short):.2f} m beyond "
                f"the reach of every arm of rig {config.rig.name!r}",
                ("task", "starts", role, "x"),
            )


def _check_places(config: RecordConfig, task: ProgramTask) -> None:
    """Check that each point on the table that a step names lies within the length of some arm."""
    arms = _arm_positions_and_reaches(config)
    longest = max(length for _, length in arms)
    for path, skill in parse_steps(task.expert, task.typical_roles, ("expert",), tuple(task.regions)):
        if (named := skill.point_on_table()) is None:
            continue
        key, place = named
        if any(float(np.linalg.norm(place - base)) <= length for base, length in arms):
            continue
        nearest = min(float(np.linalg.norm(place - base)) for base, _ in arms)
        raise ConflictError(
            f"[{place[0]:g}, {place[1]:g}] is out of reach: it is {nearest:.2f} m from the nearest arm's base, and the "
            f"arms of rig {config.rig.name!r} reach at most {longest:.2f} m; give x and y in `world`, m",
            ("task", *path, key),
        )


def _arm_positions_and_reaches(config: RecordConfig) -> list[tuple[Array, float]]:
    return [
        (config.rig.T_base_in_world(k)[:2, 3], _arm_length(kinematic_model(config.rig.arms[k])))
        for k in config.acting_indices
    ]


def _arm_length(model: mujoco.MjModel) -> float:
    """Return an upper bound on the distance from base to pinch point, m: the sum of all offsets."""
    site = model.site("pinch_site")
    length, body = float(np.linalg.norm(site.pos)), int(np.ravel(site.bodyid)[0])
    while model.body_parentid[body]:
        length += float(np.linalg.norm(model.body_pos[body]))
        body = int(model.body_parentid[body])
    return length


def program_contradiction(task: ProgramTask) -> str | None:
    """Return how a task's program contradicts its goal; None if no contradiction is known."""
    roles = task.typical_roles
    program = build_program(task, roles)
    held, moved, handed_over = set[str](), set[str](), set[str]()
    for skill in program:
        things = {thing for _, role in skill.roles() for thing in roles.objects_of(role)}
        thing = roles.object_of(skill.roles()[0][1])
        moved |= things
        if skill.LEAVES_OBJECT_HELD is not None:
            held = held | {thing} if skill.LEAVES_OBJECT_HELD else held - {thing}
        if skill.HANDS_OVER:
            handed_over.add(thing)

    def impossible(predicate: Predicate) -> str | None:
        things = set(roles.objects_of(predicate.roles()[0][1]))
        named = " and the ".join(sorted(things))
        if isinstance(predicate, HandedOver | WasHandedOver) and not things <= handed_over:
            return f"no step of the expert hands over the {named}; add `handover`"
        if predicate.IN_HAND is True and not things <= held:
            instead = ", or ask for `was_handed_over`" if isinstance(predicate, HandedOver) else ""
            return f"it needs the {named} in a hand at the end, but the expert puts it down; keep it held{instead}"
        if predicate.IN_HAND is False and things & held:
            return f"it needs the {named} in no hand, but the expert still holds it at the end; put it down"
        if (
            isinstance(predicate, On)
            and not things & moved
            and _support_at_start(task, predicate.thing) != predicate.surface
        ):
            return f"no step of the expert moves the {named} onto the {predicate.surface}; add `place`"
        return None

    found = find_contradiction(task.goal, impossible)
    return None if found is None else f"goal.{'.'.join(map(str, found[0]))}: {found[1]}"


def _support_at_start(task: ProgramTask, name: str) -> str | None:
    roles = task.typical_roles
    return next((start.on for role, start in task.starts.items() if name in (role, *roles.objects_of(role))), None)
