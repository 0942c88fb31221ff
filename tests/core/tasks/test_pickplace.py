from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from yamsim_cli.core.tasks.pickplace import Poses, judge, sample_layout

from yamsim_cli.core.config.recording import GraspKind, RecordConfig
from yamsim_cli.core.geometry.se3 import pose, yaw
from yamsim_cli.core.tasks.randomness import Stream, generator
from yamsim_cli.core.types import Cause, EpisodeJob, Layout, Margins, Motion, Outcome


def _layouts(config: RecordConfig, n: int) -> list[Layout]:
    layouts = [sample_layout(config, generator(EpisodeJob(5, k), Stream.LAYOUT)) for k in range(n)]
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
        layout = sample_layout(config, generator(EpisodeJob(seed, attempt), Stream.LAYOUT))
        assert layout is not None
        return layout.T_in_world["banana"]

    assert (draw(1, 2) == draw(1, 2)).all()
    assert not np.array_equal(draw(1, 2), draw(2, 1))
    assert not np.array_equal(draw(1, 2), draw(1, 3))


def test_a_box_too_small_for_both_gives_no_layout(make_config: Callable[..., RecordConfig]) -> None:
    config = make_config({("task", "sampling", "x"): [0.4, 0.45], ("task", "sampling", "y"): [0.0, 0.05]})
    assert sample_layout(config, np.random.default_rng(0)) is None


def _motion(**changes: object) -> Motion:
    margins = Margins(velocity=0.5, torque=0.4, joint=0.2, slip=0.001, tilt=0.01)
    named = {key: changes.pop(key) for key in list(changes) if key in ("velocity", "torque", "joint", "slip", "tilt")}
    return Motion(**{"margins": replace(margins, **named), "lost": None, "collision": None, **changes})


def _poses(end: np.ndarray, target: np.ndarray, pushed: float = 0.0) -> Poses:
    return Poses(pose((0.4, 0, 0)), pose((0.4, pushed, 0)), end, target)


def _judge(config: RecordConfig, grasp: GraspKind = "contact", motion: Motion | None = None, **poses: float) -> Outcome:
    return judge(
        config.task, grasp, _poses(pose((0, 0, 0.02)), pose(), **poses), 0.0, motion or _motion(), planned=True
    )


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
    poses = _poses(pose(T_plate[:3, 3] + offset), T_plate)
    outcome = judge(config.task, "weld", poses, speed, _motion(), planned=True)
    assert (outcome.success, outcome.cause) == (cause is None, cause)
    assert outcome.dxy == pytest.approx(np.hypot(*offset[:2]))
    assert outcome.dz == pytest.approx(offset[2])
    assert bool(outcome.detail) is (cause is not None)


@pytest.mark.parametrize(
    ("target", "height", "cause"),
    [
        # The can's top is 17 mm over its middle.
        ("007_tuna_fish_can", 0.042, None),
        ("007_tuna_fish_can", 0.008, Cause.DROPPED),
        # The bowl's floor is 2 mm over its foot.
        ("024_bowl", 0.026, None),
        ("024_bowl", -0.005, Cause.DROPPED),
        # What stands on it with its origin at its foot, as a mug, sinks in by a hair.
        ("007_tuna_fish_can", 0.0164, None),
        ("007_tuna_fish_can", 0.0150, Cause.DROPPED),
    ],
)
def test_what_lies_under_what_carries_it_was_dropped(
    target: str, height: float, cause: Cause | None, make_config: Callable[..., RecordConfig]
) -> None:
    config = make_config({("task", "object"): "061_foam_brick", ("task", "target"): target})
    T_target = pose((0.4, 0.1, 0.0165))
    poses = _poses(pose(T_target[:3, 3] + (0.045, 0, height)), T_target)
    assert judge(config.task, "weld", poses, 0.0, _motion(), planned=True).cause is cause


def test_knocked(config: RecordConfig) -> None:
    assert _judge(config, pushed=0.019).success
    outcome = _judge(config, pushed=0.03)
    assert outcome.cause is Cause.KNOCKED
    assert "30 mm" in outcome.detail


@pytest.mark.parametrize(
    ("motion", "cause", "told"),
    [
        (_motion(), None, ""),
        (_motion(lost=1.472), Cause.DROPPED, "after 1.47 s"),
        (_motion(slip=0.0151), Cause.SLIPPED, "15 mm in the hand"),
        (_motion(collision="table and left_finger touch after 0.74 s"), Cause.COLLIDED, "table and left_finger"),
        (_motion(velocity=1.01), Cause.LIMITS, "101%"),
        (_motion(torque=1.0), Cause.LIMITS, "a drive at 100%"),
        (_motion(joint=-0.02), Cause.LIMITS, "-1.1 deg"),
        # Stops are soft.
        (_motion(joint=-0.005, velocity=1.0, torque=0.999), None, ""),
    ],
)
def test_a_bad_motion_fails_wherever_the_object_ends(
    config: RecordConfig, motion: Motion, cause: Cause | None, told: str
) -> None:
    outcome = _judge(config, motion=motion)
    assert outcome.cause is cause
    assert told in outcome.detail
    assert (outcome.dxy, outcome.dz) == (0.0, 0.02)
    assert outcome.margins == motion.margins
    # Of a person or a policy only the object's end is asked.
    free = judge(config.task, "contact", _poses(pose((0, 0, 0.02)), pose()), 0.0, motion, planned=False)
    assert (free.cause, free.margins) == (None, motion.margins)


def test_a_weld_neither_slips_nor_lets_go(config: RecordConfig) -> None:
    """The fingers only look as if they held it."""
    assert _judge(config, "weld", _motion(lost=1.0, slip=0.02)).success


def test_layout_leaves_room_for_the_fingers(config: RecordConfig) -> None:
    """The open fingers come down beside the banana, not onto the plate's rim."""
    grasp = config.task.object.grasp
    assert grasp is not None
    for layout in _layouts(config, 300):
        T_banana, T_plate = layout.T_in_world["banana"], layout.T_in_world["plate"]
        for x, y, radius in grasp.fingers(0.0375, 0.012):
            finger = (T_banana @ (x, y, 0, 1))[:2]
            assert np.linalg.norm(finger - T_plate[:2, 3]) - radius >= 0.1305 + config.task.sampling.clearance - 1e-9
