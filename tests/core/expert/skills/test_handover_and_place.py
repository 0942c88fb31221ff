"""A handed-over object is placed: the receiving hand grasps it so that it can be placed."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.programs import STATION, changed, first_attempt, session_of
from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.execution import simulate_expert
from yamsim_cli.core.episode.sampling import sample_attempt
from yamsim_cli.core.episode.simulator import SimulatorCache
from yamsim_cli.session_opener import SessionOpener

TASK = changed(
    {
        ("rig",): STATION,
        ("things",): {"bottle": {"of": "kitchen_bottle"}},
        ("starts",): {"bottle": {"x": [0.30, 0.36], "y": [0.14, 0.20]}},
        ("goal",): {
            "all": [
                {"was_handed_over": {"thing": "bottle", "to": "right"}},
                {"on": {"thing": "bottle", "surface": "table"}},
            ]
        },
        ("expert",): [
            {"pick": {"thing": "bottle", "arm": "left"}},
            {"handover": {"thing": "bottle", "to": "right"}},
            {"place": {"thing": "bottle", "on": "table", "at": [0.32, -0.2]}},
        ],
    }
)


@pytest.mark.slow
def test_a_bottle_is_handed_over_and_put_down(tmp_path: Path) -> None:
    with SimulatorCache(session_of(tmp_path, TASK)) as simulators:
        simulator, attempt = first_attempt(simulators)
        outcome = simulate_expert(simulator, attempt).outcome
    assert outcome.success, outcome.detail


CUBE = changed(
    {
        ("rig",): STATION,
        ("things",): {"cube": {"of": "cube_red"}},
        ("starts",): {"cube": {"x": [0.30, 0.36], "y": [0.14, 0.20]}},
        ("goal",): {
            "all": [
                {"was_handed_over": {"thing": "cube", "to": "right"}},
                {"on": {"thing": "cube", "surface": "table"}},
                {"near": {"thing": "cube", "place": [0.32, -0.2], "radius": 0.04}},
            ]
        },
        ("expert",): [
            {"pick": {"thing": "cube", "arm": "left"}},
            {"handover": {"thing": "cube", "to": "right"}},
            {"place": {"thing": "cube", "on": "table", "at": [0.32, -0.2]}},
        ],
    }
)


@pytest.mark.slow
def test_a_cube_is_handed_over_and_put_down_on_another_face(tmp_path: Path) -> None:
    with SimulatorCache(session_of(tmp_path, CUBE)) as simulators:
        simulator, attempt = first_attempt(simulators)
        outcome = simulate_expert(simulator, attempt).outcome
    assert outcome.success, outcome.detail


@pytest.mark.slow
def test_an_object_wider_than_the_hand_is_refused_with_both_widths(tmp_path: Path) -> None:
    task = changed({("things", "cube", "of"): "054_softball"})
    with SimulatorCache(session_of(tmp_path, task)) as simulators:
        simulator, attempt = first_attempt(simulators)
        outcome = simulate_expert(simulator, attempt).outcome
    assert not outcome.success
    assert "mm wide where it can be held, and the right hand opens 95.0 mm" in (outcome.detail or ""), outcome.detail


@pytest.mark.slow
@pytest.mark.parametrize(("task", "number"), [("handover", 0), ("handover", 5), ("pickplace", 0)])
def test_joints_stay_away_from_their_stops(task: str, number: int) -> None:
    """Regression: in a handover, joints went down to 0 rad, because grips and retreats ignored the limits."""
    opener = SessionOpener({}, lambda text: None, str)
    where = opener.find_locations()
    job = AttemptJob(7, number)
    with SimulatorCache(
        Session(opener.load_record_config("default", where, task=task), where).without_meshes()
    ) as simulators:
        simulator = simulators.get(job)
        outcome = simulate_expert(simulator, sample_attempt(simulator, job)).outcome
    assert outcome.success, outcome.detail
    assert outcome.margins is not None
    assert outcome.margins.joint > 0.08
