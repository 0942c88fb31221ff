"""Goals: every predicate at its limit and just beyond, and combinations."""

from __future__ import annotations

import math

import pytest
from pydantic import ValidationError

from yamsim_cli.core.config.goals.goal import Goal, evaluate_goal
from yamsim_cli.core.config.goals.predicates import PREDICATES
from yamsim_cli.core.config.goals.role_assignment import RoleAssignment
from yamsim_cli.core.geometry.se3 import Array, pose

from .still_world import StillWorld, flat_sheet, folded_sheet

Place = tuple[float, float, float]
CAST = RoleAssignment(
    {"cup": ("cup",), "plate": ("plate",), "cube": ("cube_1", "cube_2")}, {"cube_1": "red", "cube_2": "blue"}
)
ON_PLATE = StillWorld({"cup": (0.3, 0.01, 0.06), "plate": (0.3, 0.0, 0.02)}, touches=[("cup", "plate")])
IN_AIR = StillWorld({"cup": (0.3, 0.0, 0.20), "plate": (0.3, 0.0, 0.02)}, held={"cup": frozenset({"left"})})

# Predicate in a goal, a world in which it holds, its margin there, and a near miss.
CASES = {
    "on": (
        {"thing": "cup", "surface": "plate"},
        ON_PLATE,
        0.01,
        StillWorld({"cup": (0.3, 0.021, 0.06), "plate": (0.3, 0.0, 0.02)}, touches=[("cup", "plate")]),
    ),
    "in": (
        {"thing": "cup", "container": "plate"},
        StillWorld({"cup": (0, 0, 0), "plate": (0, 0, 0)}, shares={("cup", "plate"): 0.9}),
        0.1,
        StillWorld({"cup": (0, 0, 0), "plate": (0, 0, 0)}, shares={("cup", "plate"): 0.79}),
    ),
    "stacked": (
        {"things": "cube"},
        StillWorld({"cube_1": (0, 0, 0.02), "cube_2": (0.005, 0, 0.06)}, touches=[("cube_1", "cube_2")]),
        0.015,
        StillWorld({"cube_1": (0, 0, 0.02), "cube_2": (0.03, 0, 0.02)}, touches=[("cube_1", "cube_2")]),
    ),
    "over": (
        {"thing": "cup", "surface": "plate"},
        StillWorld({"cup": (0.3, 0.01, 0.065), "plate": (0.3, 0.0, 0.02)}),
        0.01,
        StillWorld({"cup": (0.3, 0.0, 0.081), "plate": (0.3, 0.0, 0.02)}),
    ),
    "piled": (
        {"things": ["cube"]},
        StillWorld({"cube_1": (0, 0, 0.02), "cube_2": (0.005, 0, 0.03)}),
        0.015,
        StillWorld({"cube_1": (0, 0, 0.02), "cube_2": (0, 0, 0.02)}),
    ),
    "upright": (
        {"thing": "cup", "tilt_deg": 10},
        StillWorld({"cup": (0, 0, 0)}, leaning={"cup": math.radians(4)}),
        6.0,
        StillWorld({"cup": (0, 0, 0)}, leaning={"cup": math.radians(-11)}),
    ),
    "near": (
        {"thing": "cup", "place": [0.3, 0.0], "radius": 0.02},
        ON_PLATE,
        0.01,
        StillWorld({"cup": (0.3, 0.021, 0.06)}),
    ),
    "above": ({"thing": "cup", "other": "plate", "by": 0.1}, IN_AIR, 0.04, ON_PLATE),
    "held_by": ({"thing": "cup", "arm": "left"}, IN_AIR, 0.0, ON_PLATE),
    "handed_over": (
        {"thing": "cup", "to": "right"},
        StillWorld({"cup": (0, 0, 0)}, passed={"cup": ("left", "right")}),
        0.0,
        StillWorld({"cup": (0, 0, 0)}, passed={"cup": ("right",)}),
    ),
    "was_handed_over": (
        {"thing": "cup", "to": "right"},
        StillWorld({"cup": (0, 0, 0)}, handed={"cup": (("left", "right"),)}),
        0.0,
        StillWorld({"cup": (0, 0, 0)}, handed={"cup": (("right", "left"),)}, passed={"cup": ("left", "right")}),
    ),
    "sorted": (
        {"things": "cube", "order": ["blue", "red"], "axis": "y", "apart": 0.03},
        StillWorld({"cube_1": (0, 0.10, 0), "cube_2": (0, 0.05, 0)}),
        0.02,
        StillWorld({"cube_1": (0, 0.07, 0), "cube_2": (0, 0.05, 0)}),
    ),
    "open": (
        {"thing": "cup", "joint": "lid", "share": 0.7},
        StillWorld({"cup": (0, 0, 0)}, openings={("cup", "lid"): 0.75}),
        0.05,
        StillWorld({"cup": (0, 0, 0)}, openings={("cup", "lid"): 0.69}),
    ),
    "swapped": (
        {"thing": "cup", "other": "plate", "radius": 0.03},
        StillWorld({"cup": (0.3, 0.01, 0), "plate": (0.5, 0, 0)}, starts={"cup": (0.5, 0, 0), "plate": (0.3, 0, 0)}),
        0.02,
        StillWorld({"cup": (0.3, 0.01, 0), "plate": (0.5, 0.04, 0)}, starts={"cup": (0.5, 0, 0), "plate": (0.3, 0, 0)}),
    ),
    "hung": (
        {"thing": "cup", "onto": "plate"},
        StillWorld({}, marks={("plate", "peg"): pose(), ("cup", "eye"): pose((0.010, 0, 0.05))}),
        0.012,
        StillWorld({}, marks={("plate", "peg"): pose(), ("cup", "eye"): pose((0.030, 0, 0.05))}),
    ),
    "folded": (
        {"thing": "cup", "how": "half"},
        StillWorld({}, sheets={"cup": folded_sheet(apart=0.004)}),
        0.004,
        StillWorld({}, sheets={"cup": folded_sheet(apart=0.004, through=0.001)}),
    ),
    "folded_small": (
        {"thing": "cup", "share": 0.6},
        StillWorld({}, boxes={"cup": (0.2, 0.25, 0.01)}, start_boxes={"cup": (0.2, 0.5, 0.01)}),
        0.01,
        StillWorld({}, boxes={"cup": (0.2, 0.31, 0.01)}, start_boxes={"cup": (0.2, 0.5, 0.01)}),
    ),
    "contains": (
        {"container": "plate", "pieces_of": "cup", "least_g": 40, "most_g": 60},
        StillWorld({}, grams={("cup", "plate"): 55.0}),
        5.0,
        StillWorld({}, grams={("cup", "plate"): 60.5}),
    ),
    "spread": (
        {"thing": "cup", "height": 0.01},
        StillWorld({}, sheets={"cup": flat_sheet(high=0.004)}),
        0.006,
        StillWorld({}, sheets={"cup": folded_sheet(apart=0.004)}),
    ),
}


@pytest.mark.parametrize(
    ("box", "held", "holds"),
    [((0.2, 0.25, 0.01), (), True), ((0.2, 0.25, 0.05), (), False), ((0.2, 0.25, 0.01), ("left",), False)],
)
def test_a_high_or_held_cloth_is_not_folded_small(box: Place, held: tuple[str, ...], holds: bool) -> None:
    goal = Goal.model_validate({"folded_small": {"thing": "cup", "area": 0.06, "height": 0.04}})
    world = StillWorld({}, boxes={"cup": box}, held={"cup": frozenset(held)})
    assert evaluate_goal(goal, world, CAST).reached == holds


@pytest.mark.parametrize(
    ("clause", "said"),
    [
        ({"folded_small": {"thing": "cup"}}, "give either `area` or `share`"),
        ({"folded_small": {"thing": "cup", "area": 0.1, "share": 0.5}}, "give either `area` or `share`"),
        ({"contains": {"container": "plate", "pieces_of": "cup", "least_g": 9, "most_g": 8}}, "9 is above `most_g` 8"),
    ],
)
def test_contradicting_arguments_are_refused(clause: dict[str, object], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        Goal.model_validate(clause)


def test_every_predicate_has_a_case() -> None:
    assert set(CASES) == set(PREDICATES)


def test_what_leans_against_a_thing_is_not_on_it() -> None:
    goal = Goal.model_validate({"on": {"thing": "cup", "surface": "plate", "radius": 0.05}})
    assert evaluate_goal(goal, ON_PLATE, CAST).worst.margin == pytest.approx(0.04)
    leaning = StillWorld(ON_PLATE.places, touches=[("cup", "plate"), ("cup", "table")])
    verdict = evaluate_goal(goal, leaning, CAST)
    assert not verdict.reached and verdict.worst.detail == "it touches the table"


@pytest.mark.parametrize("name", CASES)
def test_holds_with_its_margin_and_not_in_a_near_miss(name: str) -> None:
    arguments, world, margin, near_miss = CASES[name]
    goal = Goal.model_validate({name: arguments})
    verdict = evaluate_goal(goal, world, CAST)
    assert verdict.reached
    assert verdict.worst.margin == pytest.approx(margin, abs=1e-9)
    missed = evaluate_goal(goal, near_miss, CAST)
    assert not missed.reached
    assert missed.worst.margin < 0


@pytest.mark.parametrize("name", CASES)
def test_not_inverts_a_goal(name: str) -> None:
    arguments, world, _, near_miss = CASES[name]
    goal = Goal.model_validate({"not": {name: arguments}})
    assert not evaluate_goal(goal, world, CAST).reached
    assert evaluate_goal(goal, near_miss, CAST).reached


@pytest.mark.parametrize(
    ("marks", "touches", "held", "said"),
    [
        ((0, 0, 0.010), (), {}, "its tip 10 mm through"),
        ((0, 0, -0.05), (), {}, "its tip -50 mm through"),
        ((0, 0, 0.05), [("cup", "table")], {}, "it touches the table"),
        ((0, 0, 0.05), (), {"cup": frozenset({"left"})}, "the left hand holds it"),
    ],
)
def test_what_is_not_hung_says_why(
    marks: tuple[float, float, float], touches: list[tuple[str, str]], held: dict[str, frozenset[str]], said: str
) -> None:
    world = StillWorld({}, marks={("plate", "peg"): pose(), ("cup", "eye"): pose(marks)}, touches=touches, held=held)
    verdict = evaluate_goal(Goal.model_validate({"hung": {"thing": "cup", "onto": "plate"}}), world, CAST)
    assert not verdict.reached
    assert said in verdict.worst.detail


@pytest.mark.parametrize(
    ("how", "sheet", "said"),
    [
        ("half", folded_sheet(apart=0.004, off=0.021), "folded(cup, half)"),
        ("half", folded_sheet(apart=0.031), "folded(cup, half): flat"),
        ("diagonal", folded_sheet(apart=0.004), "folded(cup, diagonal)"),
    ],
)
def test_cloth_folded_in_another_way_does_not_count(how: str, sheet: Array, said: str) -> None:
    verdict = evaluate_goal(
        Goal.model_validate({"folded": {"thing": "cup", "how": how}}), StillWorld({}, sheets={"cup": sheet}), CAST
    )
    assert not verdict.reached
    assert verdict.worst.what == said


def test_all_any_and_the_worst() -> None:
    on, upright = {"on": {"thing": "cup", "surface": "plate"}}, {"upright": {"thing": "cup", "tilt_deg": 5}}
    tilted = StillWorld(ON_PLATE.places, leaning={"cup": 0.5}, touches=ON_PLATE.touches)
    every = evaluate_goal(Goal.model_validate({"all": [on, upright]}), tilted, CAST)
    assert not every.reached
    assert every.worst.what == "upright(cup)"
    assert evaluate_goal(Goal.model_validate({"any": [on, upright]}), tilted, CAST).reached
    assert not evaluate_goal(Goal.model_validate({"any": [upright, {"not": on}]}), tilted, CAST).reached


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({}, "is empty"),
        ({"on": {"thing": "a", "surface": "b"}, "upright": {"thing": "a"}}, "has on and upright"),
        ({"all": []}, "`all` has no clauses"),
        ({"staked": {}}, "staked"),
        ({"near": {"thing": "a", "radius": 0.1}}, "either `other` or `place`"),
        ({"sorted": {"things": "a"}}, "either `order` or `into`"),
    ],
)
def test_an_invalid_goal_is_refused_with_the_reason(given: dict[str, object], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        Goal.model_validate(given)


def test_a_goal_survives_its_own_dump() -> None:
    goal = Goal.model_validate({"all": [{"not": {"held_by": {"thing": "cup"}}}], "for_s": 0.5})
    assert Goal.model_validate(goal.model_dump(mode="json")) == goal


@pytest.mark.parametrize(
    ("side", "inside", "outside"),
    [
        ("right", (0.32, -0.05, 0.0), (0.30, 0.05, 0.0)),
        ("left", (0.32, 0.05, 0.0), (0.36, 0.05, 0.0)),
        ("front", (0.25, 0.02, 0.0), (0.35, 0.0, 0.0)),
        ("behind", (0.35, 0.02, 0.0), (0.25, 0.0, 0.0)),
    ],
)
def test_near_on_a_side_as_seen_from_the_base(side: str, inside: Place, outside: Place) -> None:
    goal = Goal.model_validate({"near": {"thing": "cup", "other": "plate", "radius": 0.1, "side": side}})
    plate = (0.3, 0.0, 0.0)
    assert evaluate_goal(goal, StillWorld({"cup": inside, "plate": plate}), CAST).reached
    verdict = evaluate_goal(goal, StillWorld({"cup": outside, "plate": plate}), CAST)
    assert not verdict.reached and side in verdict.worst.detail
    assert not evaluate_goal(goal, StillWorld({"cup": plate, "plate": inside}), CAST).reached
