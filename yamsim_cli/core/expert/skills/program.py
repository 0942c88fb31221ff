from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Collection, Generator, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from pydantic import ValidationError

from ...attempt_data import FailureCause
from ...config.goals.role_assignment import RoleAssignment
from ...config.goals.world import TABLE
from ...config.program_task import ProgramTask
from ...errors import ConfigError, suggest_similar
from ...files.documents.config_base import ConflictError
from ...files.documents.validation_messages import format_key_path
from .cloth.flatten import Flatten
from .cloth.fold import Fold
from .common_motions import open_and_park_hands
from .handover import Handover
from .hang import Hang
from .insert import Insert
from .lift import BimanualLift
from .operate import Operate
from .pick import Pick
from .place import Place, PlaceSkill
from .planning_context import MotionSegment, PlanningContext, SkillFailedError
from .push import Push
from .put_aside import PutAside, Regrasp, put_down_failed_object
from .set_upright import SetUpright, TurnTowardsArms
from .skill import Skill, find_holding_hand

# The skills of this package. A new skill is a module here, and an entry. `skill_names` also lists the skills of other
# packages.
SKILLS: Mapping[str, type[Skill]] = {
    "pick": Pick,
    "place": Place,
    "insert": Insert,
    "handover": Handover,
    "put_aside": PutAside,
    "push": Push,
    "set_upright": SetUpright,
    "turn": TurnTowardsArms,
    "regrasp": Regrasp,
    "operate": Operate,
    "lift": BimanualLift,
    "hang": Hang,
    "fold": Fold,
    "flatten": Flatten,
}
#: Group of the entry points of skills in other packages: name in programs -> subclass of `Skill`.
SKILL_GROUP = "yamsim.skills"

# Key of a loop over the objects of a role: `each: {of: cup, do: [...]}`.
_LOOP_KEY = "each"

# attempts at a skill before the program fails; attempts after which a held object is put down and grasped again
_MAX_ATTEMPTS, _ATTEMPTS_WITH_SAME_GRASP = 3, 2


@dataclass(frozen=True)
class SkillRetry:
    """A skill that failed and was tried again.

    Attributes:
        step: index of the skill in the unrolled program.
        detail: why the skill failed.
    """

    step: int
    skill: str
    detail: str


@dataclass
class RecoveryLog:
    """Collects retries while a program runs."""

    recoveries: list[SkillRetry] = field(default_factory=list)


def build_program(task: ProgramTask, roles: RoleAssignment) -> list[Skill]:
    """Return the skills of a task's expert, with loops unrolled.

    Only unchecked configs, such as a dataset's, have invalid programs, which raise ConfigError.
    """
    try:
        return parse_program(task.expert, roles, tuple(task.regions))
    except ConflictError as error:
        raise ConfigError(f"task {task.name!r}: expert{format_key_path(error.paths[0])}: {error}") from error


def parse_program(
    steps: Sequence[Mapping[str, Any]], roles: RoleAssignment, regions: Sequence[str] = ()
) -> list[Skill]:
    """Return the skills of a program, with loops unrolled. An invalid step raises ConflictError with its path.

    Args:
        steps: as in a task's YAML: each step has one key, a skill's name or `each`.
        regions: names of the task's regions, which steps may name like roles.
    """
    return [skill for _, skill in parse_steps(steps, roles, (), regions)]


def parse_steps(
    steps: Sequence[Mapping[str, Any]],
    roles: RoleAssignment,
    path: tuple[str | int, ...] = (),
    regions: Sequence[str] = (),
) -> Iterator[tuple[tuple[str | int, ...], Skill]]:
    """Yield each skill of a program with its path in the config: `path`, and the keys below. See `parse_program`."""
    known = {TABLE, *regions, *roles.objects_by_role, *itertools.chain.from_iterable(roles.objects_by_role.values())}
    for k, step in enumerate(steps):
        yield from _read_step(step, roles, (*path, k), {}, known)


def _read_step(
    step: Mapping[str, Any],
    roles: RoleAssignment,
    path: tuple[str | int, ...],
    names: Mapping[str, str | int],
    known: Collection[str],
) -> Iterator[tuple[tuple[str | int, ...], Skill]]:
    if len(step) != 1:
        keys = ", ".join((_LOOP_KEY, *skill_names()))
        raise ConflictError(f"a step of a program has one key; give one of {keys}", path)
    key, given = next(iter(step.items()))
    if key == _LOOP_KEY:
        yield from _unroll_loop(given, roles, (*path, key), names, known)
    elif key not in skill_names():
        raise ConflictError(f"unknown skill {key!r}; {suggest_similar(key, [*skill_names(), _LOOP_KEY])}", (*path, key))
    else:
        yield (*path, key), _read_skill(key, given, (*path, key), names, known)


def _unroll_loop(
    given: Any,
    roles: RoleAssignment,
    path: tuple[str | int, ...],
    names: Mapping[str, str | int],
    known: Collection[str],
) -> Iterator[tuple[tuple[str | int, ...], Skill]]:
    """Yield the steps of a loop, once for each object of a role.

    `given` has the keys `of`, a role, and `do`, the steps. In the steps, `it` is the present object, `previous` the
    object before, and `number` the index of the object. The optional `skip` is the number of objects that are left out
    at the start. The optional `order` lists config names: only their objects are visited, in this order.
    """
    if not isinstance(given, Mapping) or not {"of", "do"} <= set(given) <= {"of", "do", "skip", "order"}:
        raise ConflictError(
            "`each` needs the keys `of` (a role) and `do` (a list of steps), and can have `skip` and `order`", path
        )
    if given["of"] not in roles.objects_by_role:
        raise ConflictError(
            f"unknown role {given['of']!r}; {suggest_similar(str(given['of']), roles.objects_by_role)}", (*path, "of")
        )
    if not isinstance(given["do"], list | tuple) or not given["do"]:
        raise ConflictError("`do` must be a list of steps", (*path, "do"))
    things = list(roles.objects_of(given["of"]))
    order = list(given.get("order", ()))
    if order:
        things = sorted(
            (name for name in things if roles.config_names[name] in order),
            key=lambda name: order.index(roles.config_names[name]),
        )
    skip = given.get("skip", 0)
    if not isinstance(skip, int) or skip < 0:
        raise ConflictError(f"`skip` {skip!r} is not valid: give a number of objects, 0 or more", (*path, "skip"))
    for number in range(skip, len(things)):
        inner = {**names, "it": things[number], "number": number} | ({"previous": things[number - 1]} if number else {})
        for k, step in enumerate(given["do"]):
            yield from _read_step(step, roles, (*path, "do", k), inner, known)


def _read_skill(
    key: str, given: Any, path: tuple[str | int, ...], names: Mapping[str, str | int], known: Collection[str]
) -> Skill:
    try:
        kind = skill_class(key)
    except ImportError as error:
        raise ConflictError(str(error), path) from error
    if not isinstance(given, Mapping):
        raise ConflictError(f"`{key}` must be a mapping with these keys: {', '.join(kind.model_fields)}", path)
    filled = {name: names.get(value, value) if isinstance(value, str) else value for name, value in given.items()}
    try:
        skill = kind.model_validate(filled)
    except ValidationError as error:
        # A misspelt key is reported both as unknown and as missing. The unknown key comes first: it has a location.
        found = sorted(error.errors(include_url=False), key=lambda fault: fault["type"] == "missing")
        first = found[0]
        message = first["msg"].removeprefix("Value error, ").replace("Input should be", "must be")
        if first["type"] == "extra_forbidden":
            message = f"unknown key; {suggest_similar(str(first['loc'][-1]), kind.model_fields)}"
        elif first["type"] == "missing":
            message = "missing; add it"
        raise ConflictError(message, (*path, *first["loc"])) from error
    for argument, role in skill.roles():
        if role not in known:
            raise ConflictError(f"unknown role {role!r}; {suggest_similar(role, sorted(known))}", (*path, argument))
    return skill


def run_program(
    program: Sequence[Skill], context: PlanningContext, roles: RoleAssignment, log: RecoveryLog
) -> Generator[MotionSegment, None, None]:
    """Yield the segments of skills in order; a skill that fails is retried from the present state."""
    number = 0
    tries: dict[int, int] = {}
    while number < len(program):
        skill = program[number]
        try:
            yield from skill.run(context, roles, program[number + 1 :])
        except SkillFailedError as error:
            tries[number] = tries.get(number, 0) + 1
            if tries[number] >= _MAX_ATTEMPTS:
                raise
            log.recoveries.append(SkillRetry(number, skill_name(skill), str(error)))
            # Arms without a free path, and arms that follow a pushed object, do not move.
            with suppress(SkillFailedError):
                yield from () if error.cause is FailureCause.KNOCKED else open_and_park_hands(context)
            if (
                tries[number] == _ATTEMPTS_WITH_SAME_GRASP
                and isinstance(skill, PlaceSkill)
                and _last_picked(program[:number]) == skill.thing
            ):
                with suppress(SkillFailedError):
                    yield from put_down_failed_object(context, roles, skill.thing)
            number = _step_to_retry(program, number, context, roles)
        else:
            number += 1


def skill_names() -> tuple[str, ...]:
    """Return the names of all skills in programs: those of this package, then those of entry points."""
    return (*SKILLS, *_skill_entry_points())


def skill_class(name: str) -> type[Skill]:
    """Return the class of a skill.

    Raises:
        KeyError: no skill has the name.
        ImportError: the skill of another package cannot be used; the message says why, and what to do.
    """
    if name in SKILLS:
        return SKILLS[name]
    first, *others = _skill_entry_points()[name]
    if others:
        places = ", ".join(one.value for one in (first, *others))
        raise ImportError(f"several packages have a skill {name!r} ({places}); rename the one that is not yamsim's")
    try:
        kind = first.load()
    except Exception as error:  # the module is code of another package
        raise ImportError(
            f"the skill {name!r} ({first.value}) cannot be loaded: {error}; correct its package, or install it again"
        ) from error
    if not (isinstance(kind, type) and issubclass(kind, Skill)):
        raise ImportError(
            f"the skill {name!r} ({first.value}) is not a subclass of Skill; correct the entry point in its package"
        )
    if not kind.ROLES and kind.roles is Skill.roles:
        raise ImportError(f"the skill {name!r} ({first.value}) names no role; list its arguments in `ROLES`")
    return kind


@functools.cache
def _skill_entry_points() -> Mapping[str, tuple[EntryPoint, ...]]:
    """Return name -> entry points of other packages' skills; names of `SKILLS` and `each` are not overridden."""
    found: dict[str, tuple[EntryPoint, ...]] = {}
    for point in entry_points(group=SKILL_GROUP):
        if point.name not in SKILLS and point.name != _LOOP_KEY:
            found[point.name] = (*found.get(point.name, ()), point)
    return found


def skill_name(skill: Skill) -> str:
    """Return the name of a skill in programs; for any other subclass of `Skill`, its class's name."""
    kind = type(skill)
    for name, own in SKILLS.items():
        if kind is own:
            return name
    where = f"{kind.__module__}:{kind.__qualname__}"
    names = (name for name, points in _skill_entry_points().items() if any(one.value == where for one in points))
    return next(names, kind.__name__.lower())


def _last_picked(program: Sequence[Skill]) -> str | None:
    return next((step.thing for step in reversed(program) if isinstance(step, Pick)), None)


def _step_to_retry(program: Sequence[Skill], number: int, context: PlanningContext, roles: RoleAssignment) -> int:
    """Return the index of the step from which to continue after step `number` failed.

    If the step needs its object in a hand and no hand holds it, this is the last step before that picks it up.
    """
    if not program[number].REQUIRES_HELD_OBJECT:
        return number
    thing = skill_object(program[number], roles)
    if find_holding_hand(context, thing) is not None:
        return number
    takes = (
        k for k in reversed(range(number)) if program[k].LEAVES_OBJECT_HELD and not program[k].REQUIRES_HELD_OBJECT
    )
    return next((k for k in takes if skill_object(program[k], roles) == thing), number)


def skill_object(skill: Skill, roles: RoleAssignment) -> str:
    """Return the object of a skill's first role, to which `REQUIRES_HELD_OBJECT` and `LEAVES_OBJECT_HELD` refer."""
    return roles.object_of(skill.roles()[0][1])


_FOLD_IN_THIRDS_FACTOR = 1.6  # of "fold", measured: folding in thirds takes two folds in one reach


def typical_tick_count(task: ProgramTask) -> int:
    """Return the typical number of control ticks of a successful attempt at a task.

    No hold time is added: most goals have held long enough when the last skill ends.
    """
    seconds = sum(_typical_seconds(skill) for skill in build_program(task, task.typical_roles))
    return min(task.max_ticks, math.ceil(seconds / task.timing.tick_seconds))


def _typical_seconds(skill: Skill) -> float:
    return skill.TYPICAL_SECONDS * (_FOLD_IN_THIRDS_FACTOR if isinstance(skill, Fold) and skill.how == "thirds" else 1)
