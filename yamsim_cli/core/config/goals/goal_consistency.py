"""Goals that contradict themselves."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import Any

from .goal import Clause
from .predicates import Predicate

Path = tuple[str | int, ...]
Impossible = Callable[[Predicate], str | None]

_MAX_PREDICATES = 12  # goals with more are not checked, since each predicate doubles the combinations


def find_contradiction(goal: Clause, impossible: Impossible = lambda predicate: None) -> tuple[Path, str] | None:
    """Key path and description of a goal's contradiction; None if its clauses can all hold.

    Args:
        impossible: why a predicate can never hold; None where it can.
    """
    # Predicates with a mapping among their arguments have no hash, so `repr` identifies each.
    found = {repr(predicate): (path, predicate) for path, predicate in goal.predicates()}
    if len(found) > _MAX_PREDICATES:
        return None
    predicates = {key: predicate for key, (_, predicate) in found.items()}
    why = {key: reason for key, predicate in predicates.items() if (reason := impossible(predicate))}
    if _can_hold(goal, predicates, set(why)):
        return None
    if why and _can_hold(goal, predicates, set()):
        # Name a predicate whose absence alone would make the goal reachable, if there is one.
        alone = (key for key in why if _can_hold(goal, predicates, set(why) - {key}))
        key = next(alone, next(iter(why)))
        return found[key][0], why[key]
    for one, other in itertools.combinations(predicates, 2):
        if _exclude(predicates[one], predicates[other]):
            thing = _thing(predicates[one])
            return found[other][0], f"one clause needs the {thing} in a hand and another needs it in none; drop one"
    return (), "the goal asks for a clause and for its opposite, so it can never hold; drop one of the two"


def _can_hold(goal: Clause, predicates: dict[str, Predicate], never: set[str]) -> bool:
    return any(goal.holds_if(truth) for truth in _possible_truths(predicates, never))


def _possible_truths(predicates: dict[str, Predicate], never: set[str]) -> Iterator[dict[str, bool]]:
    """The combinations of predicates that can hold at once."""
    for holding in itertools.product((True, False), repeat=len(predicates)):
        truth = dict(zip(predicates, holding, strict=True))
        true = [key for key in predicates if truth[key]]
        excluded = any(_exclude(predicates[a], predicates[b]) for a, b in itertools.combinations(true, 2))
        if not excluded and never.isdisjoint(true):
            yield truth


def _exclude(one: Predicate, other: Predicate) -> bool:
    """Whether one predicate needs a thing in a hand, and the other needs the same thing in no hand."""
    return {one.IN_HAND, other.IN_HAND} == {True, False} and _thing(one) == _thing(other)


def _thing(predicate: Predicate) -> Any:
    return predicate.roles()[0][1]
