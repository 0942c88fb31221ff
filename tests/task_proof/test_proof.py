"""Validation of tasks: its checks, and its findings for faulty tasks."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.programs import ONTO_PLATE, changed, first_attempt, session_of
from yamsim_cli.core.episode.execution import simulate_expert
from yamsim_cli.core.episode.simulator import SimulatorCache
from yamsim_cli.core.errors import SimulationError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.task_validation.task_catalog import task_entries, task_entry
from yamsim_cli.task_validation.validation import (
    check_holding_still,
    check_near_misses,
    check_open_fingers,
    check_reach,
    require_passed,
    validate_task,
)


@pytest.fixture(scope="module")
def simulators(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimulatorCache]:
    missed = {"thing": "cube", "what": "60 mm higher", "move": [0, 0, 0.06]}
    task = changed({("near_misses",): [missed]})
    with SimulatorCache(session_of(tmp_path_factory.mktemp("task"), task)) as made:
        yield made


def test_near_misses_of_a_good_goal_do_not_count(simulators: SimulatorCache) -> None:
    simulator, attempt = first_attempt(simulators)
    check = check_near_misses(simulator, simulate_expert(simulator, attempt))
    assert check.ok and check.value == 0 and check.detail == "2 near misses, none counts"


def test_a_near_miss_that_counts_is_named(tmp_path: Path) -> None:
    ahead = {"thing": "cube", "what": "20 mm ahead", "move": [0.02, 0, 0.0]}
    task = changed({("near_misses",): [ahead], ("goal",): {"on": {"thing": "cube", "surface": "plate"}}})
    with SimulatorCache(session_of(tmp_path, task)) as simulators:
        simulator, attempt = first_attempt(simulators)
        check = check_near_misses(simulator, simulate_expert(simulator, attempt))
    assert check.ok is False and "of which these count: the cube 20 mm ahead" in check.detail


def test_each_near_miss_starts_from_the_success(tmp_path: Path) -> None:
    """The goal concerns one of two cubes: displacing the other one counts, whatever was tried before."""
    task = changed(
        {
            ("things", "cube", "count"): 2,
            ("starts", "cube", "x"): [0.28, 0.42],
            ("starts", "cube", "y"): [0.02, 0.16],
            ("starts", "cube", "apart"): 0.03,
            ("goal",): {"on": {"thing": "cube_1", "surface": "plate"}},
            ("expert",): [{"pick": {"thing": "cube_1"}}, {"place": {"thing": "cube_1", "on": "plate"}}],
            ("near_misses",): [{"thing": "cube", "what": "60 mm higher", "move": [0, 0, 0.06]}],
        }
    )
    with SimulatorCache(session_of(tmp_path, task)) as simulators:
        simulator, attempt = first_attempt(simulators)
        done = simulate_expert(simulator, attempt)
        assert done.outcome.success, done.outcome
        check = check_near_misses(simulator, done)
    assert check.detail == "3 near misses, of which these count: the cube_2 60 mm higher"


def test_the_share_in_reach_is_measured(simulators: SimulatorCache, tmp_path: Path) -> None:
    simulator, _ = first_attempt(simulators)
    assert check_reach(simulator).value == 1.0
    far = changed({("starts", "cube", "x"): [0.3, 1.1], ("starts", "cube", "y"): [0.0, 0.0]})
    with SimulatorCache(session_of(tmp_path, far)) as others:
        other, _ = first_attempt(others)
        check = check_reach(other)
    assert check.ok is False and check.value is not None and 0.2 < check.value < 0.6
    assert "cube" in check.detail and "at least 90% is needed" in check.detail


def test_nothing_and_open_fingers_reach_nothing(simulators: SimulatorCache) -> None:
    assert check_holding_still(simulators, 0, 1).ok
    assert check_open_fingers(simulators, 0, 1).ok


def test_a_goal_that_nothing_is_needed_for_has_no_start(tmp_path: Path) -> None:
    lying = changed({("goal",): {"upright": {"thing": "cube"}}})
    with SimulatorCache(session_of(tmp_path, lying)) as simulators:
        check = check_holding_still(simulators, 0, 1)
    assert check.ok is False and check.detail == "no attempt had a start"


@pytest.mark.slow
def test_a_proof_has_everything(tmp_path: Path) -> None:
    report = validate_task(session_of(tmp_path, ONTO_PLATE, n=2), 0.5, lambda done, wanted: None)
    assert report["ok"] and report["success_rate"] == 1.0 and report["n"] == 2
    names = [check["name"] for check in report["checks"]]
    assert names == ["program", "expert", "reach", "hold_still", "open_fingers", "near_misses"]
    require_passed(report)


def test_a_failed_proof_is_an_error() -> None:
    failed = {"name": "reach", "ok": False, "detail": "of each region: cube 10%"}
    with pytest.raises(SimulationError, match="task 'small': reach: of each region: cube 10%"):
        require_passed({"task": "small", "checks": [{"name": "expert", "ok": True, "detail": ""}, failed]})


def test_tasks_are_listed_with_what_they_are(locations: Locations) -> None:
    items = {item["name"]: item for item in task_entries(locations)}
    assert items["tower"]["skills"] == ["pick", "place"] and items["tower"]["goal"] == ["stacked"]
    assert items["pickplace"]["things"] == {"object": ["banana"], "target": ["plate"]}
    assert task_entry("tower", locations)["counts"] == {"cube": 3}
