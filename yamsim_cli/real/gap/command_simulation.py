"""Simulate arms under recorded commands, to compare with the measured motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from yamsim_cli.core.errors import DatasetError, SimulationError, count_noun
from yamsim_cli.core.geometry.se3 import Array, invert_pose, pose
from yamsim_cli.core.recorded_motion import ArmMotion, RecordedMotion
from yamsim_cli.core.scene.compilation import physics_failure
from yamsim_cli.core.scene.compiled import ArmAddresses, CompiledScene

_STEPS_PER_CHECK = 200  # physics steps between checks for a breakdown
_START_FIT_SECONDS = 0.2  # s; errors in this time select the initial state
_MIN_IMPROVEMENT = 2.0  # factor by which another initial state must reduce the error of a start at rest
_START_VELOCITY_SAMPLES = 6  # samples for the initial velocity


def simulate_commands(scene: CompiledScene, motion: RecordedMotion) -> RecordedMotion:
    """Simulate the scene's arms under a motion's commands.

    A step uses the mean command during the step, so that a command between steps gives the same impulse. Equal steps
    make a simulated recording's commands reproduce it. The arms start at the first measured joints, because friction
    lets a joint rest some milliradians beside its command. They start at rest, or with the measured velocity if that
    fits the first 0.2 s much better. Before the first delayed command acts, drives already follow it, or hold the start
    if that fits much better.

    Args:
        scene: from `scene.build.build_rig_scene`, simulated with its own timestep.
        motion: with commands. Uncommanded fingers follow the measured openings.

    Returns:
        Encoder readings without noise and quantization at the same samples. The same inputs give the same bits.

    Raises:
        DatasetError: the motion has no commands, or its arms differ from the scene's.
        SimulationError: physics broke down.
    """
    check_arms(scene, motion)
    ctrl = _actuator_controls(scene, motion)
    start = _start_qpos(scene, motion)
    first = int(np.searchsorted(motion.times, _START_FIT_SECONDS, side="right"))
    steps = min(len(ctrl), int(np.ceil(_START_FIT_SECONDS / scene.model.opt.timestep)))
    rest, moving, before = np.zeros(scene.model.nv), _start_qvel(scene, motion), ctrl[0] if len(ctrl) else None
    starts: list[tuple[Array, Array | None]] = [(rest, before)]
    if any(arm.command_delay for arm in scene.arms):
        starts.append((rest, None))
    if moving.any():
        starts.append((moving, before))
    if len(starts) > 1 and first > 2:
        tried = (_simulate_controls(scene, motion.name, start, *one, ctrl[:steps]) for one in starts)
        misfits = [_error_after_start(scene, motion, run, first) for run in tried]
        best = int(np.argmin(misfits))
        starts = [starts[best if misfits[best] * _MIN_IMPROVEMENT < misfits[0] else 0]]
    run = _simulate_controls(scene, motion.name, start, *starts[0], ctrl)
    arms = tuple(
        _sample_arm_motion(arm, logged, run, motion.times) for arm, logged in zip(scene.arms, motion.arms, strict=True)
    )
    return RecordedMotion(motion.name, motion.times, arms)


def check_arms(scene: CompiledScene, motion: RecordedMotion) -> None:
    """Check that a scene's arms can follow a motion.

    Raises:
        DatasetError: the arms differ, or commands or measured joints are missing.
    """
    if len(motion.arms) != len(scene.arms):
        raise DatasetError(
            f"{motion.name} has {count_noun(len(motion.arms), 'arm')}, and the rig has {len(scene.arms)}; choose "
            "another --rig"
        )
    for arm, logged in zip(scene.arms, motion.arms, strict=True):
        whose = f"{motion.name}{f', {logged.side} arm' if logged.side else ''}"
        if logged.joints.shape[1] != arm.dof:
            raise DatasetError(
                f"{whose}: has {count_noun(logged.joints.shape[1], 'joint')}, and the rig's arm has {arm.dof}; choose "
                "another --rig"
            )
        if logged.commands is None or not np.isfinite(logged.commands).any(axis=0).all():
            raise DatasetError(f"{whose}: has no commands for its joints, which the simulation needs")
        if not np.isfinite(logged.joints).any(axis=0).all():
            raise DatasetError(f"{whose}: a joint was never measured, so the start of the arm is unknown")


@dataclass(frozen=True)
class _SimulatedRun:
    """Times (n,), s, and MuJoCo's positions (n, nq) and velocities (n, nv)."""

    times: Array
    qpos: Array
    qvel: Array


def _simulate_controls(
    scene: CompiledScene, name: str, start: Array, speeds: Array, before: Array | None, ctrl: Array
) -> _SimulatedRun:
    """Simulate a step per row of `ctrl` (n, nu), from `start` (nq,) and `speeds` (nv,).

    Until the first row acts, drives with a command delay execute `before` (nu,), or hold `start` if None.
    """
    model, data = scene.model, mujoco.MjData(scene.model)
    scene.reset(data, start, commanded=before)
    data.qvel[:] = speeds
    qpos, qvel = np.empty((len(ctrl) + 1, model.nq)), np.empty((len(ctrl) + 1, model.nv))
    qpos[0], qvel[0] = data.qpos, data.qvel
    for k, commands in enumerate(ctrl):
        data.ctrl[:] = commands
        scene.step(data)
        qpos[k + 1], qvel[k + 1] = data.qpos, data.qvel
        if (k % _STEPS_PER_CHECK == 0 or k == len(ctrl) - 1) and (text := physics_failure(data)):
            # MuJoCo has reset its own clock.
            raise SimulationError(f"{name}: physics broke down within {(k + 1) * model.opt.timestep:.3f} s: {text}")
    return _SimulatedRun(np.arange(len(ctrl) + 1) * model.opt.timestep, qpos, qvel)


def _actuator_controls(scene: CompiledScene, motion: RecordedMotion) -> Array:
    timestep = float(scene.model.opt.timestep)
    # Rounding may put a sample just after a step.
    steps = int(np.ceil(motion.duration / timestep - 1e-6))
    edges = np.arange(steps + 1, dtype=np.float64) * timestep
    ctrl = np.zeros((steps, scene.model.nu))
    for arm, logged in zip(scene.arms, motion.arms, strict=True):
        assert logged.commands is not None, "checked before"
        commands = forward_fill(logged.commands, logged.joints)
        ctrl[:, arm.arm_ctrl] = _interval_means(motion.times, np.clip(commands, *arm.ctrl_range.T), edges)
        if arm.fingers is not None:
            openings = np.clip(_commanded_openings(arm, logged), *arm.fingers.ctrl_range)
            ctrl[:, [arm.fingers.ctrl]] = _interval_means(motion.times, openings[:, None], edges)
    return ctrl


def _interval_means(times: Array, values: Array, edges: Array) -> Array:
    """Return means (n - 1, k) of `values` (m, k) between `edges` (n,). Each value holds from its time on."""
    sums = np.vstack([np.zeros(values.shape[1]), np.cumsum(values[:-1] * np.diff(times)[:, None], axis=0)])
    at = np.clip(np.searchsorted(times, edges, side="right") - 1, 0, None)
    integral = sums[at] + values[at] * (edges - times[at])[:, None]
    means: Array = np.diff(integral, axis=0) / np.diff(edges)[:, None]
    # A value that holds for a whole interval is used without rounding.
    alone = at[:-1] == np.clip(np.searchsorted(times, edges[1:], side="left") - 1, 0, None)
    means[alone] = values[at[:-1]][alone]
    return means


def forward_fill(values: Array, before: Array) -> Array:
    """Replace NaN in values (n, k) by the last finite value above, in the first row by the first of `before` (m, k)."""
    filled = values.copy()
    if np.isfinite(values).all():
        return filled
    for column, first in zip(filled.T, _first_finite_rows(before), strict=True):
        if not np.isfinite(column[0]):
            column[0] = first
        known = np.maximum.accumulate(np.where(np.isfinite(column), np.arange(len(column)), 0))
        column[:] = column[known]
    return filled


def _first_finite_rows(rows: Array) -> Array:
    finite = np.isfinite(rows)
    values: Array = np.where(finite.any(axis=0), rows[finite.argmax(axis=0), np.arange(rows.shape[1])], np.nan)
    return values


def _commanded_openings(arm: ArmAddresses, logged: ArmMotion) -> Array:
    assert arm.fingers is not None, "asked of arms with fingers"
    closed = np.full((len(logged.joints), 1), arm.fingers.opening_limits[0])
    for openings in (logged.commanded_openings, logged.openings):
        if openings is not None and np.isfinite(openings).any():
            seen = closed if logged.openings is None else logged.openings[:, None]
            before = np.where(np.isfinite(_first_finite_rows(seen)), seen, openings[:, None])
            return forward_fill(openings[:, None], before)[:, 0]
    return closed[:, 0]


def _start_qpos(scene: CompiledScene, motion: RecordedMotion) -> Array:
    qpos: Array = scene.model.qpos0.copy()
    for arm, logged in zip(scene.arms, motion.arms, strict=True):
        qpos[arm.joint_qpos] = _first_finite_rows(logged.joints) - arm.encoder_offset
        if arm.fingers is not None:
            measured = None if logged.openings is None else _first_finite_rows(logged.openings[:, None])[0]
            opening = (
                measured if measured is not None and np.isfinite(measured) else _commanded_openings(arm, logged)[0]
            )
            qpos[arm.fingers.qpos] = np.clip(opening, *arm.fingers.opening_limits) * arm.fingers.sign
    return qpos


def _start_qvel(scene: CompiledScene, motion: RecordedMotion) -> Array:
    speeds = np.zeros(scene.model.nv)
    for arm, logged in zip(scene.arms, motion.arms, strict=True):
        if logged.velocities is not None and np.isfinite(logged.velocities[0]).all():
            speeds[arm.joint_dof] = logged.velocities[0]
            continue
        rows = np.flatnonzero(np.isfinite(logged.joints).all(axis=1))[:_START_VELOCITY_SAMPLES]
        if len(rows) >= 3 and motion.times[rows[-1]] <= _START_FIT_SECONDS:
            # A parabola separates velocity from acceleration.
            speeds[arm.joint_dof] = np.polyfit(motion.times[rows], logged.joints[rows], 2)[1]
    return speeds


def _error_after_start(scene: CompiledScene, motion: RecordedMotion, run: _SimulatedRun, first: int) -> float:
    times = motion.times[:first]
    off = [
        _delayed_rows(arm, run, run.qpos[:, arm.joint_qpos], times) + arm.encoder_offset - logged.joints[:first]
        for arm, logged in zip(scene.arms, motion.arms, strict=True)
    ]
    known = np.concatenate([rows[np.isfinite(rows)] for rows in off])
    return float(np.sqrt(np.mean(np.square(known)))) if len(known) else 0.0


def _delayed_rows(arm: ArmAddresses, run: _SimulatedRun, rows: Array, times: Array) -> Array:
    """Return rows (n, k) interpolated at times (m,), s, minus the sensor delay."""
    return np.column_stack([np.interp(times - arm.sensor_delay, run.times, column) for column in rows.T])


def _sample_arm_motion(arm: ArmAddresses, logged: ArmMotion, run: _SimulatedRun, times: Array) -> ArmMotion:
    openings = None
    if arm.fingers is not None:
        openings = _delayed_rows(arm, run, run.qpos[:, arm.fingers.qpos[:1]] * arm.fingers.sign[0], times)[:, 0]
    return replace(
        logged,
        joints=_delayed_rows(arm, run, run.qpos[:, arm.joint_qpos], times) + arm.encoder_offset,
        openings=openings,
        velocities=_delayed_rows(arm, run, run.qvel[:, arm.joint_dof], times),
    )


def hand_poses(scene: CompiledScene, number: int, joints: Array) -> Array:
    """Return poses (n, 4, 4) of `grasp_site` in the base of arm `number`, at joints (n, dof), rad; NaN gives NaN."""
    arm, data = scene.arms[number], mujoco.MjData(scene.model)
    site, T_world_in_base = data.site(f"{arm.prefix}grasp_site"), invert_pose(arm.T_base_in_world)
    poses = np.full((len(joints), 4, 4), np.nan)
    for row in np.flatnonzero(np.isfinite(joints).all(axis=1)):
        data.qpos[arm.joint_qpos] = joints[row] - arm.encoder_offset
        mujoco.mj_kinematics(scene.model, data)
        poses[row] = T_world_in_base @ pose(site.xpos, site.xmat.reshape(3, 3))
    return poses
