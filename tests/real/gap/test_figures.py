"""The gap of a motion: zero for a perfect model, and the planted difference for any other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.rig_scenes import later, new_scene, plant, rig_scene, swings
from tests.unrendered import write_dataset
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.dataset.reader import open_episode
from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.recorded_motion import RecordedMotion
from yamsim_cli.core.robots.dynamics import MeasuredArmDynamics
from yamsim_cli.core.scene.build import build_rig_scene
from yamsim_cli.real.gap.gap_figures import MotionGap, measure_gap
from yamsim_cli.real.recordings.motion_reading import read_motions

TIMES = np.arange(0, 6.0, 0.004)
PERFECT = 1e-4


@pytest.fixture(scope="module")
def made() -> RecordedMotion:
    return plant(rig_scene(), TIMES, [swings(TIMES)])


@pytest.fixture(scope="module")
def perfect(made: RecordedMotion) -> MotionGap:
    return measure_gap(rig_scene(), made)


def measured(motion: RecordedMotion, joints: Array) -> RecordedMotion:
    return replace(motion, arms=(replace(motion.arms[0], joints=joints),))


def test_a_perfect_model_has_no_gap(perfect: MotionGap) -> None:
    assert perfect.error.max < PERFECT
    assert all(joint.error.max < PERFECT for joint in perfect.joints)
    assert all(joint.measured_vs_simulated.delay == pytest.approx(0, abs=1e-4) for joint in perfect.joints)
    (hand,) = perfect.hands
    assert hand.position.max < 1e-4 and hand.rotation.max < 1e-3 and hand.opening is not None
    assert hand.opening.max < 1e-4
    assert [joint.name for joint in perfect.joints] == [f"joint{k}" for k in range(1, 7)]


def test_the_measured_arm_follows_commands_as_late_as_the_simulation(perfect: MotionGap) -> None:
    for joint in perfect.joints:
        assert joint.measured.delay == pytest.approx(joint.simulated.delay, abs=1e-6)
        assert joint.measured.delay is not None and 0.02 < joint.measured.delay < 0.2


def test_a_delay_is_found_to_two_milliseconds(made: RecordedMotion, perfect: MotionGap) -> None:
    found = measure_gap(rig_scene(), later(made, 6))
    assert found.error.rms > 0.005
    for joint, before in zip(found.joints, perfect.joints, strict=True):
        assert joint.measured_vs_simulated.delay == pytest.approx(0.024, abs=0.002)
        assert joint.error.rms > 10 * before.error.rms
        assert joint.measured.delay is not None and before.measured.delay is not None
        assert joint.measured.delay - before.measured.delay == pytest.approx(0.024, abs=0.002)
    assert found.hands[0].delay == pytest.approx(0.024, abs=0.002)


def test_friction_makes_a_gap_that_grows_with_it() -> None:
    sizes = []
    for factor in (1.2, 2.0):
        rough = new_scene()
        rough.model.dof_frictionloss[rough.first_arm.joint_dof] *= factor
        found = measure_gap(rig_scene(), plant(rough, TIMES, [swings(TIMES)]))
        sizes.append([joint.error.rms for joint in found.joints])
    assert (np.array(sizes[0]) > 4 * PERFECT).all()
    assert (np.array(sizes[1]) > 2 * np.array(sizes[0])).all()


def test_uncompensated_weight_shows_as_sag_at_rest() -> None:
    times = np.arange(0, 4.0, 0.004)
    still = swings(times, amplitude=0.0)
    # The simulation starts at the measured joints, and settles within a second.
    found = measure_gap(rig_scene(), plant(rig_scene(), times, [still], gravity=0.8), begin=1.5)
    turning, lifting = found.joints[0], found.joints[1]
    assert turning.measured_vs_simulated.sag == pytest.approx(0, abs=1e-4)
    assert lifting.measured_vs_simulated.sag is not None and abs(lifting.measured_vs_simulated.sag) > 0.005
    assert lifting.measured_vs_simulated.sag == pytest.approx(lifting.measured.sag, abs=2e-3)
    assert lifting.simulated.sag == pytest.approx(0, abs=2e-3)
    assert set(found.phases) == {"still"}
    # An arm at rest has no delays and no stops.
    assert {joint.measured_vs_simulated.delay for joint in found.joints} == {None}
    assert {joint.measured_vs_simulated.overshoot for joint in found.joints} == {None}


def test_an_overshoot_that_the_simulation_lacks_is_measured() -> None:
    times = np.arange(0, 4.0, 0.004)
    share = np.clip(times - 1, 0, 1)[:, None]
    still = swings(times, amplitude=0.0)
    bump = 0.02 * np.exp(-(((times - 2.25) / 0.05) ** 2))[:, None]
    for sign in (1.0, -1.0):
        made = plant(rig_scene(), times, [still + sign * 0.4 * share**3 * (10 - 15 * share + 6 * share**2)])
        found = measure_gap(rig_scene(), measured(made, made.arms[0].joints + sign * bump))
        for joint in found.joints[2:]:
            assert joint.simulated.overshoot == pytest.approx(0, abs=2e-3)
            # The bump comes before the joint has reached its end.
            assert (
                joint.measured_vs_simulated.overshoot is not None
                and 0.01 < joint.measured_vs_simulated.overshoot < 0.02
            )
            assert joint.measured.overshoot is not None
            assert joint.measured.overshoot - joint.measured_vs_simulated.overshoot == pytest.approx(
                joint.simulated.overshoot
            )


def test_the_worst_frame_counts_measured_samples(made: RecordedMotion) -> None:
    joints = made.arms[0].joints.copy()
    joints[1000, 3] += 0.2
    joints[np.arange(len(joints)) % 4 != 0] = np.nan
    worst = measure_gap(rig_scene(), measured(made, joints)).worst
    assert (worst.frame, worst.joint, worst.arm) == (250, "joint4", "")
    assert worst.time == pytest.approx(4.0) and worst.error == pytest.approx(0.2, abs=1e-3)


def test_a_hands_gap_follows_from_its_joints_gap(made: RecordedMotion) -> None:
    joints = made.arms[0].joints.copy()
    joints[:, 0] += 0.01
    (hand,) = measure_gap(rig_scene(), measured(made, joints)).hands
    # The simulation starts at the measured joints, and returns to the command within some tenths of a second.
    assert np.degrees(hand.rotation.p95) == pytest.approx(np.degrees(0.01), rel=0.1)
    assert 0.001 < hand.position.p95 < 0.01


def test_only_samples_from_begin_to_end_are_compared(made: RecordedMotion) -> None:
    joints = made.arms[0].joints.copy()
    joints[:500] += 0.1
    off = measured(made, joints)
    assert measure_gap(rig_scene(), off).error.max > 0.09
    found = measure_gap(rig_scene(), off, begin=3.0, end=5.0)
    assert found.error.max < 2e-3
    assert found.seconds == pytest.approx(2.0, abs=0.01)
    assert 3.0 <= found.worst.time <= 5.0


@pytest.mark.parametrize(("begin", "end"), [(7.0, np.inf), (0.0, 0.02)])
def test_too_few_samples_say_so(made: RecordedMotion, begin: float, end: float) -> None:
    with pytest.raises(DatasetError, match=r"measured samples from .* s to .* s; a gap needs 10"):
        measure_gap(rig_scene(), made, begin, end)


def test_every_phase_of_a_motion_has_its_errors(perfect: MotionGap) -> None:
    assert list(perfect.phases) == ["still", "accelerating", "cruising", "braking"]
    assert sum(size.samples for size in perfect.phases.values()) == 6 * len(TIMES)


@pytest.mark.parametrize(
    ("rig", "task"), [("single", "pickplace"), pytest.param("russet", "handover", marks=pytest.mark.slow)]
)
def test_an_episode_has_no_gap_until_something_is_held(
    rig: str, task: str, locations: Locations, make_config: Callable[..., RecordConfig], tmp_path: Path
) -> None:
    config = make_config({("rig",): rig, ("task",): task})
    write_dataset(tmp_path / "dataset", config, locations, 1)
    (motion,) = read_motions([tmp_path / "dataset"], config.rig, locations)
    frames = open_episode(Path(motion.name)).frames()
    held = next(frame["timestamp"] for frame in frames if np.any(frame["magnet"]))
    scene = rig_scene(rig)
    before, after = (measure_gap(scene, motion, *part) for part in ((0.0, held), (held, np.inf)))
    # Frames hold joints as float32.
    assert before.error.max < 1e-6
    assert len(before.joints) == 6 * len(config.rig.arms)
    # The rig alone lacks the held object's weight.
    assert after.error.max > 1e-3
    assert frames[before.worst.frame]["timestamp"] == pytest.approx(before.worst.time, abs=1e-6)


def test_an_arm_that_acts_late_begins_as_its_episode_did(
    locations: Locations, config: RecordConfig, tmp_path: Path
) -> None:
    """An episode's drives hold the start until the first command acts."""
    dynamics = MeasuredArmDynamics(revision="late", base="i2rt_yam", command_delay_ms=23.8, sensor_delay_ms=4.0)
    arm = config.rig.arms[0].model_copy(update={"dynamics": dynamics})
    rig = config.rig.model_copy(update={"arms": (arm,)})
    write_dataset(tmp_path / "dataset", config.model_copy(update={"rig": rig}), locations, 1)
    (motion,) = read_motions([tmp_path / "dataset"], rig, locations)

    frames = open_episode(Path(motion.name)).frames()
    held = next(frame["timestamp"] for frame in frames if np.any(frame["magnet"]))
    gap = measure_gap(build_rig_scene(rig, config.scene, locations), motion, 0.0, held)

    # float32 of frames.
    assert gap.error.max < 1e-5
