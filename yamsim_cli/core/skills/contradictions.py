"""Whether a task's program can reach its goal, as far as its steps tell."""

from __future__ import annotations

from ..config.program_task import ProgramTask
from ..goals.contradictions import contradiction
from ..goals.predicates import HandedOver, On, Predicate, WasHandedOver
from .handover import Handover
from .program import read_program


def program_contradiction(task: ProgramTask) -> str | None:
    """How a task's program contradicts its goal; None if it does not, as far as its steps tell."""
    cast = task.typical_cast
    program = read_program(task.expert, cast)
    held, moved, passed = set[str](), set[str](), set[str]()
    for skill in program:
        things = {thing for _, role in skill.roles() for thing in cast.of(role)}
        thing = cast.one(skill.roles()[0][1])
        moved |= things
        if skill.LEAVES is not None:
            held = held | {thing} if skill.LEAVES else held - {thing}
        if isinstance(skill, Handover):
            passed.add(thing)

    def impossible(predicate: Predicate) -> str | None:
        things = set(cast.of(predicate.roles()[0][1]))
        named = " and the ".join(sorted(things))
        if isinstance(predicate, HandedOver | WasHandedOver) and not things <= passed:
            return f"no step of the expert hands over the {named}; add `handover`"
        if predicate.IN_HAND is True and not things <= held:
            instead = ", or ask for `was_handed_over`" if isinstance(predicate, HandedOver) else ""
            return f"it needs the {named} in a hand at the end, and no hand of the expert has it; keep it held{instead}"
        if predicate.IN_HAND is False and things & held:
            return f"it needs the {named} in no hand, and the expert still holds it at the end; put it down"
        if isinstance(predicate, On) and not things & moved and _starts_on(task, predicate.thing) != predicate.surface:
            return f"no step of the expert moves the {named} onto the {predicate.surface}; add `place`"
        return None

    found = contradiction(task.goal, impossible)
    return None if found is None else f"goal.{'.'.join(map(str, found[0]))}: {found[1]}"


def _starts_on(task: ProgramTask, name: str) -> str | None:
    """What a role starts on, or the thing of a role."""
    cast = task.typical_cast
    return next((start.on for role, start in task.starts.items() if name in (role, *cast.of(role))), None)
