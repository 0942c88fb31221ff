"""A task's goal: predicates joined by all, any and not, and for how long they have to hold."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, cast

from pydantic import Field, FiniteFloat, create_model, model_validator

from ..documents.base import Config
from ..documents.units import Within
from .cast import Cast
from .measure import Measure, worst
from .predicates import PREDICATES, Predicate
from .world import World

# What joins clauses: all of several, any of several, the opposite of one.
_JOINS = ("all", "any", "not")


class _Clause(Config):
    """One key: a predicate's name, or what joins clauses."""

    @model_validator(mode="after")
    def _has_one_key(self) -> _Clause:
        given = self._given()
        if len(given) != 1:
            names = ", ".join((*_JOINS, *PREDICATES))
            said = f"has {' and '.join(given)}" if given else "is empty"
            raise ValueError(f"a clause of a goal has one key, and this one {said}; give one of {names}")
        if given[0] in _JOINS[:2] and not self._value():
            raise ValueError(f"`{given[0]}` of nothing; list at least one clause")
        return self

    def _given(self) -> list[str]:
        return [name for name in (*_JOINS, *PREDICATES) if getattr(self, name) is not None]

    def _value(self) -> Any:
        return getattr(self, self._given()[0])

    def measures(self, world: World, cast: Cast) -> list[Measure]:
        """What has to hold, measured: of `any`, the best clause alone; of `not`, one measure turned round."""
        key, value = self._given()[0], self._value()
        match key:
            case "all":
                return [measure for clause in value for measure in clause.measures(world, cast)]
            case "any":
                return max((clause.measures(world, cast) for clause in value), key=lambda found: worst(found).margin)
            case "not":
                return [_turned(worst(value.measures(world, cast)))]
        return cast_predicate(value).measures(world, cast)

    def holds_if(self, truth: Mapping[str, bool]) -> bool:
        """Whether the clause holds, given for each predicate's `repr` whether it holds."""
        key, value = self._given()[0], self._value()
        match key:
            case "all":
                return all(clause.holds_if(truth) for clause in value)
            case "any":
                return any(clause.holds_if(truth) for clause in value)
            case "not":
                return not value.holds_if(truth)
        return truth[repr(value)]

    def predicates(self, path: tuple[str | int, ...] = ()) -> Iterator[tuple[tuple[str | int, ...], Predicate]]:
        """Every predicate in it, and where it stands."""
        key, value = self._given()[0], self._value()
        if key in ("all", "any"):
            for k, clause in enumerate(value):
                yield from clause.predicates((*path, key, k))
        elif key == "not":
            yield from value.predicates((*path, key))
        else:
            yield (*path, key), cast_predicate(value)


def cast_predicate(value: Any) -> Predicate:
    """A clause's value as the predicate that it is."""
    return cast(Predicate, value)


def _turned(measure: Measure) -> Measure:
    """The measure of the opposite. At a margin of nothing a predicate holds, so its opposite does not."""
    margin = -measure.margin if measure.margin else -1e-9
    return Measure(f"not {measure.what}", margin, measure.unit, measure.detail)


def _optional(annotation: Any) -> Any:
    return Annotated[annotation | None, Field(exclude_if=lambda value: value is None)], None


# Made from the table of predicates, so that a new one is known here too.
Clause: Any = create_model(
    "Clause",
    __base__=_Clause,
    __module__=__name__,
    **{
        "all": (Annotated[tuple["Clause", ...] | None, Field(exclude_if=lambda value: value is None)], None),  # type: ignore[misc]
        "any": (Annotated[tuple["Clause", ...] | None, Field(exclude_if=lambda value: value is None)], None),  # type: ignore[misc]
        "not": (Annotated["Clause | None", Field(exclude_if=lambda value: value is None)], None),
    }
    | {name: _optional(predicate) for name, predicate in PREDICATES.items()},
)


class Goal(Clause):  # type: ignore[misc]
    """A clause, and for how long it has to hold at the end of an attempt.

    Attributes:
        for_s: the time, s of the simulation; 0 asks for the last moment alone.
    """

    for_s: Annotated[FiniteFloat, Within("s", 0, 60)] = 0.0


@dataclass(frozen=True)
class Verdict:
    """Whether a goal is reached.

    Attributes:
        measures: of everything that had to hold.
    """

    measures: tuple[Measure, ...]

    @property
    def reached(self) -> bool:
        """Whether everything holds."""
        return all(measure.holds for measure in self.measures)

    @property
    def worst(self) -> Measure:
        """What is nearest to failing, or the first that failed."""
        return worst(self.measures)


def judge(goal: Goal, world: World, cast: Cast) -> Verdict:
    """Whether a goal holds in the world as it is now."""
    return Verdict(tuple(goal.measures(world, cast)))
