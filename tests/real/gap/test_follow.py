"""Physics with recorded commands reproduces the recorded motion, at any command times."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from tests.rig_scenes import STEP, plant, rig_scene, swings
from yamsim_cli.core.errors import DatasetError, SimulationError
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.recorded_motion import ArmMotion, RecordedMotion
from yamsim_cli.real.gap.command_simulation import hand_poses, simulate_commands

TIMES = np.arange(0, 3.0, 0.01)


def _off(one: RecordedMotion, other: RecordedMotion) -> float:
    """Largest distance of any joint, rad."""
    return max(float(np.nanmax(np.abs(a.joints - b.joints))) for a, b in zip(one.arms, other.arms, strict=True))


def _changed(motion: RecordedMotion, **values: object) -> RecordedMotion:
    return replace(motion, arms=tuple(replace(arm, **values) for arm in motion.arms))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def made() -> RecordedMotion:
    return plant(rig_scene(), TIMES, [swings(TIMES)])


def test_a_perfect_model_does_the_same_to_the_last_bit(made: RecordedMotion) -> None:
    again = simulate_commands(rig_scene(), made)
    assert _off(made, again) < 1e-12
    assert np.array_equal(again.arms[0].joints, simulate_commands(rig_scene(), made).arms[0].joints)


def test_two_arms_follow_each_its_own_commands() -> None:
    commands = [swings(TIMES), swings(TIMES, seed=1)]
    made = plant(rig_scene("bimanual"), TIMES, commands)
    assert _off(made, simulate_commands(rig_scene("bimanual"), made)) < 1e-12


def test_commands_act_at_their_exact_times() -> None:
    """Half a step later, everything is half a step later."""
    times = np.arange(0, 3.0, STEP * 5)
    made = plant(rig_scene(), times, [swings(times)])
    later = replace(made, times=np.concatenate([[0.0], times[1:] + STEP / 2]))
    speed = np.abs(np.diff(made.arms[0].joints, axis=0)).max() / (STEP * 5)
    assert speed * STEP / 2 > 1e-3
    assert _off(made, simulate_commands(rig_scene(), later)) < 1e-4


def test_jittered_times_that_are_steps_ends_are_followed_to_the_last_bit() -> None:
    rng = np.random.default_rng(3)
    times = np.concatenate([[0.0], np.cumsum(rng.integers(2, 7, 300))]) * STEP
    made = plant(rig_scene(), times, [swings(times)])
    # With the rounding of a file.
    written = replace(made, times=np.round(times, 6))
    assert _off(made, simulate_commands(rig_scene(), written)) < 1e-9


def test_a_sample_between_two_steps_is_interpolated(made: RecordedMotion) -> None:
    times = np.arange(0, 3.0, 0.0033)
    held = np.searchsorted(made.times, times, side="right") - 1
    commands = made.arms[0].commands
    assert commands is not None
    odd = RecordedMotion(
        "odd", times, (ArmMotion("", np.tile(made.arms[0].joints[0], (len(times), 1)), commands[held]),)
    )
    seen = simulate_commands(rig_scene(), odd).arms[0].joints
    whole = np.column_stack([np.interp(times, made.times, column) for column in made.arms[0].joints.T])
    # Commands come up to 3.3 ms later, and nothing turns faster than 2 rad/s.
    assert np.abs(seen - whole).max() < 0.0033 * 2


def test_joints_known_at_some_samples_only_are_enough(made: RecordedMotion) -> None:
    sparse = made.arms[0].joints.copy()
    sparse[np.arange(len(sparse)) % 6 != 0] = np.nan
    assert _off(made, simulate_commands(rig_scene(), _changed(made, joints=sparse))) < 1e-12


def test_a_command_holds_until_the_next_one(made: RecordedMotion) -> None:
    commands = made.arms[0].commands
    assert commands is not None
    every = commands[np.arange(len(commands)) // 3 * 3]
    said = every.copy()
    said[np.arange(len(said)) % 3 != 0] = np.nan
    one, other = (simulate_commands(rig_scene(), _changed(made, commands=rows)) for rows in (every, said))
    assert np.array_equal(one.arms[0].joints, other.arms[0].joints)


def _cut(motion: RecordedMotion, begin: int) -> RecordedMotion:
    def rows(values: Array | None) -> Array | None:
        return None if values is None else values[begin:]

    arms = tuple(
        ArmMotion(arm.side, arm.joints[begin:], rows(arm.commands), rows(arm.openings), rows(arm.commanded_openings))
        for arm in motion.arms
    )
    return RecordedMotion(motion.name, motion.times[begin:] - motion.times[begin], arms)


def test_a_recording_that_begins_in_motion_is_followed_in_motion(made: RecordedMotion) -> None:
    begin = int(np.argmax(np.abs(np.diff(made.arms[0].joints, axis=0)).sum(axis=1)))
    cut = _cut(made, begin)
    off = np.abs(simulate_commands(rig_scene(), cut).arms[0].joints - cut.arms[0].joints)
    speed = np.abs(np.diff(cut.arms[0].joints[:2], axis=0)).max() / 0.01
    assert speed > 0.5
    # From rest, it would lag by its speed times a time constant of some 60 ms.
    assert off.max() < 0.005
    assert off[100:].max() < 1e-4


def test_a_jump_at_the_first_sample_is_no_motion_before_it() -> None:
    commands = swings(TIMES, amplitude=0.0) + 0.1 * (TIMES > 0.005)[:, None]
    made = plant(rig_scene(), TIMES, [commands])
    assert _off(made, simulate_commands(rig_scene(), made)) < 1e-12


def test_drives_that_act_late_begin_with_the_first_command(made: RecordedMotion) -> None:
    scene = rig_scene()
    spec = mujoco.MjSpec.from_string(
        """<mujoco>
        <worldbody><body><joint name="j" type="slide" damping="1"/><geom size=".1" mass="1"/></body></worldbody>
        <actuator><position joint="j" kp="100" kv="10" delay="0.024" nsample="14"/></actuator></mujoco>"""
    )
    late = replace(
        scene,
        model=spec.compile(),
        arms=(
            replace(
                scene.first_arm,
                joint_qpos=np.array([0]),
                joint_dof=np.array([0]),
                arm_ctrl=np.array([0]),
                ctrl_range=np.array([[-9.0, 9.0]]),
                fingers=None,
            ),
        ),
    )
    late.model.opt.gravity[:] = 0
    held = np.where(TIMES < 1, 0.5, 0.6)[:, None]
    still = RecordedMotion("held", TIMES, (ArmMotion("", np.full((len(TIMES), 1), 0.5), held),))
    seen = simulate_commands(late, still).arms[0].joints[:, 0]
    assert np.abs(seen[TIMES <= 1.02] - 0.5).max() < 1e-12
    assert seen[-1] == pytest.approx(0.6, abs=1e-3)


def test_hands_are_where_their_joints_put_them(made: RecordedMotion) -> None:
    poses = hand_poses(rig_scene(), 0, np.vstack([np.zeros(6), np.full(6, np.nan), made.arms[0].joints[:1]]))
    assert np.isnan(poses[1]).all() and np.isfinite(poses[[0, 2]]).all()
    assert np.linalg.norm(poses[2, :3, 3] - poses[0, :3, 3]) > 0.1


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"commands": None}, "plant: has no commands for its joints"),
        ({"joints": np.full((len(TIMES), 6), np.nan)}, "plant: a joint was never measured"),
        (
            {"joints": np.zeros((len(TIMES), 7)), "commands": np.zeros((len(TIMES), 7)), "velocities": None},
            "plant: has 7 joints, and the rig's arm has 6; choose another --rig",
        ),
    ],
)
def test_motions_that_cannot_be_simulated_are_refused_with_the_reason(
    made: RecordedMotion, values: dict[str, object], said: str
) -> None:
    with pytest.raises(DatasetError, match=said):
        simulate_commands(rig_scene(), _changed(made, **values))


def test_a_rig_with_another_number_of_arms_is_refused(made: RecordedMotion) -> None:
    with pytest.raises(DatasetError, match="plant has 1 arm, and the rig has 2"):
        simulate_commands(rig_scene("bimanual"), made)


def test_physics_that_breaks_down_says_so(made: RecordedMotion) -> None:
    scene = rig_scene("single", 0.003)
    stiff = scene.model.actuator_gainprm.copy()
    scene.model.actuator_gainprm[:, 0] = 1e12
    scene.model.actuator_forcerange[:] = [-1e15, 1e15]
    scene.model.actuator_forcelimited[:] = 0
    try:
        with pytest.raises(SimulationError, match="plant: physics broke down within"):
            simulate_commands(scene, made)
    finally:
        scene.model.actuator_gainprm[:] = stiff
