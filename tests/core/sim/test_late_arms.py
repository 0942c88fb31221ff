"""Arms with delay, wrong weight compensation and encoders: effects on physics and frames."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.robots.dynamics import JointDynamics, MeasuredArmDynamics
from yamsim_cli.core.scene.build import build_rig_scene
from yamsim_cli.core.scene.compiled import CompiledScene
from yamsim_cli.core.sim.encoder_readings import delayed_positions, encoder_readings

WHERE = Locations.from_environment({})
STEP = 0.002


def _scene(dynamics: MeasuredArmDynamics | None, timestep: float = STEP) -> CompiledScene:
    rig = load_config(RigConfig, "rigs", "single", WHERE)
    arm = rig.arms[0].model_copy(update={"dynamics": dynamics})
    scene = load_config(SceneConfig, "scenes", "studio", WHERE)
    return build_rig_scene(rig.model_copy(update={"arms": (arm,)}), scene, WHERE, timestep)


def _started(scene: CompiledScene) -> mujoco.MjData:
    data = mujoco.MjData(scene.model)
    qpos = scene.model.qpos0.copy()
    qpos[scene.first_arm.joint_qpos] = 0.0, 1.4, 1.5, -0.3, 0.0, 0.0
    scene.reset(data, qpos)
    return data


def _answers(scene: CompiledScene, steps: int = 40) -> np.ndarray:
    """Return joint 1 (steps,) after a command of 0.1 rad."""
    data = _started(scene)
    data.ctrl[scene.first_arm.arm_ctrl[0]] += 0.1
    places = []
    for _ in range(steps):
        scene.step(data)
        places.append(float(data.qpos[scene.first_arm.joint_qpos[0]]))
    return np.array(places)


@pytest.mark.parametrize("steps", [1, 12])
def test_a_command_acts_late_by_whole_steps_and_nothing_moves_before(steps: int) -> None:
    late = _answers(_scene(MeasuredArmDynamics(revision="late", base="i2rt_yam", command_delay_ms=1000 * STEP * steps)))

    assert np.allclose(late[steps:], _answers(_scene(None))[:-steps], atol=1e-5)
    assert np.abs(late[:steps]).max() < 1e-6


def test_between_two_steps_a_delay_is_between() -> None:
    found = [
        _answers(_scene(MeasuredArmDynamics(revision="late", base="i2rt_yam", command_delay_ms=delay)))[-1]
        for delay in (8.0, 9.0, 10.0)
    ]

    assert found[0] > found[1] > found[2]
    assert found[1] == pytest.approx((found[0] + found[2]) / 2, abs=2e-4)


def test_an_arm_sags_by_what_its_gravity_compensation_lacks() -> None:
    joints = {"joint2": JointDynamics(gravity_factor=0.8, frictionloss=0.0)}
    scene = _scene(MeasuredArmDynamics(revision="weak", base="i2rt_yam", joints=joints))
    data = _started(scene)
    start = data.qpos[scene.first_arm.joint_qpos[1]]

    scene.step(data, 1500)

    weight = data.qfrc_gravcomp[scene.first_arm.joint_dof[1]]
    sag = data.qpos[scene.first_arm.joint_qpos[1]] - start
    assert sag == pytest.approx(-0.2 * weight / scene.first_arm.position_gain[1], rel=0.02)
    assert abs(sag) > 0.01


def test_encoders_read_where_joints_were_and_begin_at_rest() -> None:
    scene = _scene(MeasuredArmDynamics(revision="late", base="i2rt_yam", sensor_delay_ms=6.0))
    data = _started(scene)
    data.ctrl[scene.first_arm.arm_ctrl[0]] += 0.1
    seen, were = [], [float(data.qpos[scene.first_arm.joint_qpos[0]])]
    for _ in range(30):
        scene.step(data)
        now = delayed_positions(scene, data)
        assert now is not None
        seen.append(now[0, 0])
        were.append(float(data.qpos[scene.first_arm.joint_qpos[0]]))

    assert np.allclose(seen[3:], were[1:-3], atol=1e-12)
    assert seen[0] == were[0]


def test_readings_are_off_by_offsets_come_in_steps_and_their_noise_is_the_attempts() -> None:
    dynamics = MeasuredArmDynamics(
        revision="read",
        base="i2rt_yam",
        joints={"joint2": JointDynamics(offset_rad=0.02)},
        encoder_step_rad=0.001,
    )
    scene = _scene(dynamics)
    true = np.array([[0.0, 1.4001, 1.5, -0.3, 0.0, 0.0, 0.03]])

    read = encoder_readings(scene, true, AttemptJob(0, 0), 0)

    assert np.allclose(read, [[0.0, 1.420, 1.5, -0.3, 0.0, 0.0, 0.03]], atol=1e-12)
    noisy = _scene(dynamics.model_copy(update={"sensor_noise_rad": 0.01, "encoder_step_rad": 0.0}))
    some = [encoder_readings(noisy, true, AttemptJob(seed, 0), tick) for seed, tick in ((0, 0), (0, 0), (0, 1), (1, 0))]
    assert np.array_equal(some[0], some[1])
    assert not np.allclose(some[0], some[2])
    assert not np.allclose(some[0], some[3])
    assert 0.003 < np.std((some[0] - true)[0, :6]) < 0.03


def test_an_arm_as_its_model_is_read_exactly_and_stepped_as_before() -> None:
    scene = _scene(None)
    data, plain = _started(scene), _started(scene)

    scene.step(data, 20)
    mujoco.mj_step(scene.model, plain, 20)

    assert delayed_positions(scene, data) is None
    assert np.array_equal(data.qpos, plain.qpos)
    true = np.zeros((1, 7))
    assert encoder_readings(scene, true, AttemptJob(0, 0), 0) is true
