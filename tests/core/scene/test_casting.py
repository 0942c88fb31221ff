"""Casting: the same numbers give the same roles, words and places; objects keep their distance; lack of room is
reported.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from tests.programs import changed, session_of
from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.scene import Table
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.geometry.se3 import Array, tilt_angle
from yamsim_cli.core.scene.start_sampling import (
    ObjectPlacement,
    footprint_distance,
    sample_phrasing,
    sample_placements,
    sample_roles,
)

BLOCK = np.array([[-0.02, -0.03, 0.0], [0.02, 0.03, 0.05]])

THREE = changed(
    {
        ("things",): {"cube": {"of": ["cube_red", "cube_green", "cube_blue"], "count": 3}},
        ("starts",): {"cube": {"x": [0.25, 0.45], "y": [-0.2, 0.2], "apart": 0.04}},
        ("goal",): {"stacked": {"things": "cube"}},
        ("expert",): [{"pick": {"thing": "cube_1"}}],
    }
)


@pytest.fixture(scope="module")
def three(tmp_path_factory: pytest.TempPathFactory) -> Session:
    return session_of(tmp_path_factory.mktemp("task"), THREE)


def _places(session: Session, job: AttemptJob) -> dict[str, ObjectPlacement]:
    task = session.config.task
    cast = sample_roles(task, job)
    found = sample_placements(task, cast, lambda name, opened: BLOCK, session.config.widened_table, job)
    assert isinstance(found, dict)
    return found


def test_the_same_numbers_give_the_same_draw(three: Session) -> None:
    job, task = AttemptJob(4, 7), three.config.task
    assert sample_roles(task, job) == sample_roles(task, job)
    assert sample_phrasing(task, job) == sample_phrasing(task, job)
    one, again = _places(three, job), _places(three, job)
    assert all(np.array_equal(one[name].T, again[name].T) for name in one)
    other = _places(three, AttemptJob(4, 8))
    assert not any(np.array_equal(one[name].T, other[name].T) for name in one)


def test_no_object_is_drawn_twice_while_others_are_left(three: Session) -> None:
    task = three.config.task
    casts = [sample_roles(task, AttemptJob(0, k)) for k in range(30)]
    assert all(sorted(cast.config_names.values()) == ["cube_blue", "cube_green", "cube_red"] for cast in casts)
    assert len({tuple(cast.config_names.values()) for cast in casts}) > 3
    assert casts[0].objects_of("cube") == ("cube_1", "cube_2", "cube_3")


def _outline(T: Array) -> Array:
    """Points (n, 2) along the edge of the block's outline, from above."""
    (x0, y0, _), (x1, y1, _) = BLOCK
    share = np.linspace(0, 1, 41)
    xs, ys = x0 + share * (x1 - x0), y0 + share * (y1 - y0)
    edge = np.concatenate(
        [np.column_stack(pair) for pair in ((xs, 0 * ys + y0), (xs, 0 * ys + y1), (0 * xs + x0, ys), (0 * xs + x1, ys))]
    )
    outline: Array = edge @ T[:2, :2].T + T[:2, 3]
    return outline


def test_things_have_their_distance(three: Session) -> None:
    nearest = math.inf
    for number in range(40):
        placed = _places(three, AttemptJob(1, number))
        for one, other in itertools.combinations(placed.values(), 2):
            a, b = _outline(one.T), _outline(other.T)
            nearest = min(nearest, float(np.linalg.norm(a[:, None] - b[None], axis=-1).min()))
        for there in placed.values():
            middle = (there.T @ np.array([*BLOCK.mean(axis=0), 1.0]))[:2]
            assert 0.25 <= middle[0] <= 0.45 and -0.2 <= middle[1] <= 0.2
    assert 0.04 - 1e-9 <= nearest < 0.06


def test_a_gap_is_that_of_rectangles() -> None:
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    assert footprint_distance(square, square + np.array([1.5, 0.2])) == pytest.approx(0.5)
    assert footprint_distance(square, square + np.array([0.5, 0.5])) < 0
    turned = square @ np.array([[1, 1], [-1, 1]]) / math.sqrt(2)
    assert footprint_distance(square, turned + np.array([0.5, 1.3])) == pytest.approx(0.3)


def test_an_object_without_room_is_named(tmp_path_factory: pytest.TempPathFactory) -> None:
    tight = changed({("starts", "cube"): {"x": [0.30, 0.32], "y": [0.0, 0.02]}}, THREE)
    session = session_of(tmp_path_factory.mktemp("task"), tight)
    task, job = session.config.task, AttemptJob(0, 0)
    cast = sample_roles(task, job)
    found = sample_placements(task, cast, lambda name, opened: BLOCK, session.config.widened_table, job)
    assert found in ("cube_2", "cube_3")


@pytest.mark.parametrize(("attitude", "leans"), [("upright", 0.0), ("lying", math.pi / 2), ("upside_down", math.pi)])
def test_things_lie_as_they_are_said_to(
    attitude: str, leans: float, three: Session, tmp_path_factory: pytest.TempPathFactory
) -> None:
    start = {"x": [0.3, 0.4], "y": [-0.1, 0.1], "attitudes": [attitude]}
    one = {("things", "cube", "count"): 1, ("starts", "cube"): start, ("expert",): [{"pick": {"thing": "cube"}}]}
    session = session_of(tmp_path_factory.mktemp("task"), changed(one, THREE))
    placed = _places(session, AttemptJob(0, 0))
    assert tilt_angle(placed["cube"].T[:3, :3]) == pytest.approx(leans, abs=1e-6)


def test_what_starts_on_another_thing_moves_with_it(tmp_path_factory: pytest.TempPathFactory) -> None:
    on_it = changed({("starts", "cube"): {"on": "plate", "x": [0.05, 0.05], "y": [0, 0], "yaw_deg": [0, 0]}})
    session = session_of(
        tmp_path_factory.mktemp("task"), on_it | {"goal": {"on": {"thing": "cube", "surface": "table"}}}
    )
    task, job, table = session.config.task, AttemptJob(0, 3), session.config.widened_table
    assert isinstance(table, Table)
    placed = sample_placements(task, sample_roles(task, job), lambda name, opened: BLOCK, table, job)
    assert isinstance(placed, dict) and placed["cube"].support_name == "plate"
    apart = np.linalg.inv(placed["plate"].T) @ placed["cube"].T
    assert apart[:2, 3] == pytest.approx((0.05, 0.0), abs=1e-9)


@pytest.mark.slow
def test_places_fill_their_regions_evenly_although_things_need_room(config: RecordConfig) -> None:
    """Sampling again for lack of room does not bias the object towards the region's edge."""
    halves = {"banana": (0.10, 0.03, 0.02), "plate": (0.13, 0.13, 0.01)}
    blocks = {name: np.array([[-x, -y, -z], [x, y, z]]) for name, (x, y, z) in halves.items()}
    task = config.task.model_copy(update={"starts": config.start_regions_in_world})
    drawn: dict[str, list[Array]] = {name: [] for name in blocks}
    for number in range(1000):
        found = sample_placements(
            task, task.typical_roles, lambda name, opened: blocks[name], config.widened_table, AttemptJob(5, number)
        )
        assert isinstance(found, dict)
        for name, placed in found.items():
            drawn[name].append(placed.T)
    for role, name in (("object", "banana"), ("target", "plate")):
        start, places = task.starts[role], np.array(drawn[name])
        for axis, (low, high) in enumerate((start.x, start.y)):
            assert low <= places[:, axis, 3].min() < low + 0.02
            assert high - 0.02 < places[:, axis, 3].max() <= high
        turns = np.degrees(np.arctan2(places[:, 1, 0], places[:, 0, 0]))
        assert start.yaw_deg[0] <= turns.min() < start.yaw_deg[0] + 5
        assert start.yaw_deg[1] - 5 < turns.max() <= start.yaw_deg[1]
    x = np.array(drawn["banana"])[:, 0, 3]
    counts, _ = np.histogram(x, bins=5, range=task.starts["object"].x)
    assert counts.min() > 1000 / 5 * 0.85
