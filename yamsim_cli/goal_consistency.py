"""Finds goals that can never hold, because their predicates contradict each other."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import Any

from .core.config.goals.goal import Clause
from .core.config.goals.predicate import Predicate

PredicateKeyPath = tuple[str | int, ...]
WhyPredicateImpossible = Callable[[Predicate], str | None]

_MAX_PREDICATES = 12  # predicates of a checked goal; each predicate doubles the combinations


def find_contradiction(
    goal: Clause, impossible: WhyPredicateImpossible = lambda predicate: None
) -> tuple[PredicateKeyPath, str] | None:
    """Return key path and description of a contradiction, or None; `impossible`: why a predicate can never hold."""
    # Predicates with a mapping among their arguments have no hash, so `repr` identifies each.
    found = {repr(predicate): (path, predicate) for path, predicate in goal.predicates()}
    if len(found) > _MAX_PREDICATES:
        return None
    predicates = {key: predicate for key, (_, predicate) in found.items()}
    why = {key: reason for key, predicate in predicates.items() if (reason := impossible(predicate))}
    if _can_hold(goal, predicates, set(why)):
        return None
    if why and _can_hold(goal, predicates, set()):
        # Prefer a predicate whose removal alone would make the goal reachable.
        alone = (key for key in why if _can_hold(goal, predicates, set(why) - {key}))
        key = next(alone, next(iter(why)))
        return found[key][0], why[key]
    for one, other in itertools.combinations(predicates, 2):
        if _are_exclusive(predicates[one], predicates[other]):
            thing = _object_role(predicates[one])
            return found[other][0], f"one clause needs the {thing} in a hand and another in no hand; remove one"
    return (), "the goal has a clause and its opposite, so it can never hold; remove one of the two"


def _can_hold(goal: Clause, predicates: dict[str, Predicate], never: set[str]) -> bool:
    return any(goal.holds_if(truth) for truth in _possible_truths(predicates, never))


def _possible_truths(predicates: dict[str, Predicate], never: set[str]) -> Iterator[dict[str, bool]]:
    for holding in itertools.product((True, False), repeat=len(predicates)):
        truth = dict(zip(predicates, holding, strict=True))
        true = [key for key in predicates if truth[key]]
        excluded = any(_are_exclusive(predicates[a], predicates[b]) for a, b in itertools.combinations(true, 2))
        if not excluded and never.isdisjoint(true):
            yield truth


def _are_exclusive(one: Predicate, other: Predicate) -> bool:
    """Return whether one predicate needs an object in a hand, and the other needs the same object in no hand."""
    return {one.IN_HAND, other.IN_HAND} == {True, False} and _object_role(one) == _object_role(other)


def _object_role(predicate: Predicate) -> Any:
    return predicate.roles()[0][1]
