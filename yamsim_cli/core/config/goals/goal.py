"""A task's goal: predicates joined by `all`, `any` and `not`, and their hold time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import Field, FiniteFloat, create_model, model_validator

from ...files.documents.config_base import Config
from ...files.documents.units import QuantityBounds
from .measure import GoalMeasure, worst_measure
from .predicate import Predicate
from .predicates import PREDICATES
from .role_assignment import RoleAssignment
from .world import GoalWorld

# Keys that join clauses: conjunction, disjunction and negation.
_BOOLEAN_OPERATORS = ("all", "any", "not")


class _Clause(Config):
    """A mapping with one key: a predicate's name, or a key that joins clauses."""

    @model_validator(mode="after")
    def _has_one_key(self) -> _Clause:
        given = [name for name in (*_BOOLEAN_OPERATORS, *PREDICATES) if getattr(self, name) is not None]
        if len(given) != 1:
            names = ", ".join((*_BOOLEAN_OPERATORS, *PREDICATES))
            found = f"has {' and '.join(given)}" if given else "is empty"
            raise ValueError(f"a clause of a goal must have one key, but this one {found}; give one of {names}")
        if given[0] in ("all", "any") and not getattr(self, given[0]):
            raise ValueError(f"`{given[0]}` has no clauses; list at least one")
        return self

    @property
    def _only_item(self) -> tuple[str, Any]:
        return next(
            (name, value) for name in (*_BOOLEAN_OPERATORS, *PREDICATES) if (value := getattr(self, name)) is not None
        )

    def measures(self, world: GoalWorld, roles: RoleAssignment) -> list[GoalMeasure]:
        """Return the measures that all have to hold: for `any`, of its best clause; for `not`, one inverted measure."""
        key, value = self._only_item
        match key:
            case "all":
                return [measure for clause in value for measure in clause.measures(world, roles)]
            case "any":
                return max(
                    (clause.measures(world, roles) for clause in value), key=lambda found: worst_measure(found).margin
                )
            case "not":
                return [_negate_measure(worst_measure(value.measures(world, roles)))]
        predicate: Predicate = value
        return predicate.measures(world, roles)

    def holds_if(self, truth: Mapping[str, bool]) -> bool:
        """Return whether the clause holds, given the truth of each predicate by the predicate's `repr`."""
        key, value = self._only_item
        match key:
            case "all":
                return all(clause.holds_if(truth) for clause in value)
            case "any":
                return any(clause.holds_if(truth) for clause in value)
            case "not":
                return not value.holds_if(truth)
        return truth[repr(value)]

    def predicates(self, path: tuple[str | int, ...] = ()) -> Iterator[tuple[tuple[str | int, ...], Predicate]]:
        """Yield the key path below `path`, and the predicate, for every predicate of the clause."""
        key, value = self._only_item
        if key in ("all", "any"):
            for k, clause in enumerate(value):
                yield from clause.predicates((*path, key, k))
        elif key == "not":
            yield from value.predicates((*path, key))
        else:
            yield (*path, key), value


def _negate_measure(measure: GoalMeasure) -> GoalMeasure:
    """Return the measure of the negation. A predicate holds at a margin of 0, so its negation must not."""
    margin = -measure.margin if measure.margin else -1e-9
    return GoalMeasure(f"not {measure.what}", margin, measure.unit, measure.detail)


def _optional_field(annotation: Any) -> Any:
    # A clause has one key, its kind, so the keys of other kinds are not written.
    return Annotated[annotation, Field(exclude_if=lambda value: value is None)], None


# Created from `PREDICATES`, so that a predicate that is added to `PREDICATES` becomes a key without further changes.
Clause: Any = create_model(
    "Clause",
    __base__=_Clause,
    __module__=__name__,
    **{
        "all": _optional_field(tuple["Clause", ...] | None),  # type: ignore[misc]
        "any": _optional_field(tuple["Clause", ...] | None),  # type: ignore[misc]
        "not": _optional_field("Clause | None"),
    }
    | {name: _optional_field(predicate | None) for name, predicate in PREDICATES.items()},
)


class Goal(Clause):  # type: ignore[misc]
    """A clause that has to hold at the end of an attempt, with its hold time.

    Attributes:
        for_s: hold time, s of simulated time; with 0, only the last moment counts.
    """

    for_s: Annotated[FiniteFloat, QuantityBounds("s", 0, 60)] = 0.0


@dataclass(frozen=True)
class GoalVerdict:
    """The measures of a goal in one state of a scene; all have to hold."""

    measures: tuple[GoalMeasure, ...]

    @property
    def reached(self) -> bool:
        """Whether every measure holds."""
        return all(measure.holds for measure in self.measures)

    @property
    def worst(self) -> GoalMeasure:
        """The first measure that fails, or else the measure with the least margin."""
        return worst_measure(self.measures)


def evaluate_goal(goal: Goal, world: GoalWorld, roles: RoleAssignment) -> GoalVerdict:
    """Return whether, and by which margins, a goal holds in the current state of a scene."""
    return GoalVerdict(tuple(goal.measures(world, roles)))
