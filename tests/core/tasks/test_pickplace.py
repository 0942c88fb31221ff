from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from yamsim_cli.core.config.record import RecordConfig
from yamsim_cli.core.geometry.se3 import pose, rotation_z, yaw
from yamsim_cli.core.tasks.pickplace import candidate_plans, judge, knocked, sample_layout
from yamsim_cli.core.tasks.randomness import Stream, generator
from yamsim_cli.core.types import Cause, EpisodeJob, Layout


def _layouts(config: RecordConfig, n: int) -> list[Layout]:
    layouts = [sample_layout(config.task, config.table, generator(EpisodeJob(5, k), Stream.LAYOUT)) for k in range(n)]
    assert all(layouts)
    return [layout for layout in layouts if layout]


def test_layouts_fill_the_box_and_keep_their_distance(config: RecordConfig) -> None:
    box = config.task.sampling
    layouts = _layouts(config, 500)
    for name in ("banana", "plate"):
        xy = np.array([layout.T_in_world[name][:2, 3] for layout in layouts])
        for axis, (low, high) in enumerate((box.x, box.y)):
            assert low <= xy[:, axis].min() < low + 0.02
            assert high - 0.02 < xy[:, axis].max() <= high
    apart = [
        np.linalg.norm(layout.T_in_world["banana"][:2, 3] - layout.T_in_world["plate"][:2, 3]) for layout in layouts
    ]
    assert min(apart) >= 0.15
    assert max(abs(yaw(layout.T_in_world["banana"])) for layout in layouts) <= np.pi / 2
    assert max(abs(yaw(layout.T_in_world["plate"])) for layout in layouts) > 3


def test_banana_positions_are_uniform(config: RecordConfig) -> None:
    """Drawing again for want of room must not push the object out of the middle."""
    x = np.array([layout.T_in_world["banana"][0, 3] for layout in _layouts(config, 2000)])
    counts, _ = np.histogram(x, bins=5, range=config.task.sampling.x)
    assert counts.min() > 2000 / 5 * 0.85


def test_an_attempt_depends_on_its_own_numbers_alone(config: RecordConfig) -> None:
    def draw(seed: int, attempt: int) -> np.ndarray:
        layout = sample_layout(config.task, config.table, generator(EpisodeJob(seed, attempt), Stream.LAYOUT))
        assert layout is not None
        return layout.T_in_world["banana"]

    assert (draw(1, 2) == draw(1, 2)).all()
    assert not np.array_equal(draw(1, 2), draw(2, 1))
    assert not np.array_equal(draw(1, 2), draw(1, 3))


def test_a_box_too_small_for_both_gives_no_layout(make_config: Callable[..., RecordConfig]) -> None:
    config = make_config({("task", "sampling", "x"): [0.4, 0.45], ("task", "sampling", "y"): [0.0, 0.05]})
    assert sample_layout(config.task, config.table, np.random.default_rng(0)) is None


def test_plan_carries_the_object_not_the_hand_over_the_plate(config: RecordConfig) -> None:
    (layout,) = _layouts(config, 1)
    for plan in candidate_plans(config.task, layout, np.eye(4)):
        assert [waypoint.name for waypoint in plan.waypoints] == [
            "pre-grasp",
            "grasp",
            "lift",
            "arc-top",
            "pre-place",
            "place",
            "retract",
        ]
        grasp, place = plan.waypoints[plan.grasp], plan.waypoints[plan.release]
        np.testing.assert_allclose(grasp.T_object_in_world, layout.T_in_world["banana"])
        np.testing.assert_allclose(place.T_object_in_world[:2, 3], layout.T_in_world["plate"][:2, 3])
        # Held upright, a finger's breadth above where it will lie.
        np.testing.assert_allclose(place.T_object_in_world[2, :3], (0, 0, 1), atol=1e-12)
        rest = layout.T_in_world["plate"][2, 3] + config.task.target.support_height + config.task.object.rest_height
        assert place.T_object_in_world[2, 3] - rest == pytest.approx(config.task.heights.release)


def test_the_two_candidates_take_the_object_from_opposite_sides(config: RecordConfig) -> None:
    (layout,) = _layouts(config, 1)
    one, other = candidate_plans(config.task, layout, np.eye(4))
    # Held poses differ by half a turn about the approach direction.
    half_turn = one.T_object_in_pinch[:3, :3] @ other.T_object_in_pinch[:3, :3].T
    np.testing.assert_allclose(half_turn, rotation_z(np.pi), atol=1e-12)


@pytest.mark.parametrize(
    ("offset", "speed", "cause"),
    [
        ((0.0, 0.0, 0.02), 0.0, None),
        ((0.03, 0.039, 0.02), 0.0, None),
        ((0.04, 0.04, 0.02), 0.0, Cause.OFF_TARGET),
        ((0.0, 0.0, 0.12), 0.0, Cause.OFF_TARGET),
        ((0.0, 0.0, -0.01), 0.0, Cause.DROPPED),
        ((0.2, 0.0, -0.5), 0.0, Cause.DROPPED),
        ((0.0, 0.0, 0.02), 0.2, Cause.UNSTABLE),
    ],
)
def test_judge(config: RecordConfig, offset: tuple[float, ...], speed: float, cause: Cause | None) -> None:
    T_plate = pose((0.4, 0.1, 0.0))
    outcome = judge(config.task, pose(T_plate[:3, 3] + offset), T_plate, speed, 0.0, 0.0)
    assert (outcome.success, outcome.cause) == (cause is None, cause)
    assert outcome.dxy == pytest.approx(np.hypot(*offset[:2]))
    assert outcome.dz == pytest.approx(offset[2])
    assert bool(outcome.detail) is (cause is not None)


def test_knocked() -> None:
    assert knocked(pose(), pose((0.019, 0, 0)), 0, 0) is None
    outcome = knocked(pose(), pose((0.03, 0, 0)), 0, 0)
    assert outcome is not None
    assert outcome.cause is Cause.KNOCKED
    assert "30 mm" in outcome.detail


def test_layout_leaves_room_for_the_fingers(config: RecordConfig) -> None:
    """The open fingers come down beside the banana, not onto the plate's rim."""
    grasp = config.task.object.grasp
    assert grasp is not None
    for layout in _layouts(config, 300):
        T_banana, T_plate = layout.T_in_world["banana"], layout.T_in_world["plate"]
        for x, y, radius in grasp.fingers(0.0375):
            finger = (T_banana @ (x, y, 0, 1))[:2]
            assert np.linalg.norm(finger - T_plate[:2, 3]) - radius >= 0.1305 + config.task.sampling.clearance - 1e-9


def test_outcomes_are_values(config: RecordConfig) -> None:
    outcome = judge(config.task, pose(), pose(), 0.0, 0.0, 0.0)
    assert replace(outcome) == outcome
