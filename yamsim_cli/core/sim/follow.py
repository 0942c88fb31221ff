"""Arms that follow recorded commands in physics: what the model does where the real arm did what was measured."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np

from ..errors import DatasetError, SimulationError, counted
from ..geometry.se3 import Array, inverse, pose
from ..motion import ArmMotion, Motion
from ..scene.compiled import CompiledScene, SceneArm
from ..scene.compiling import breakdown

# How often it is looked whether physics broke down, in steps.
_LOOK_STEPS = 200
# A motion starts at rest unless what was measured first, over so many seconds, says otherwise, s.
_FIRST = 0.2
# Another start has to explain what was measured first this many times better than rest under the first command.
_BETTER = 2.0
# Samples that the speed at the start is taken from.
_SLOPE_SAMPLES = 6


def follow(scene: CompiledScene, motion: Motion) -> Motion:
    """A motion's commands as the scene's arms follow them, from where its joints were measured first.

    A command acts from its time on, wherever that lies between two steps: a step gets the mean of what was told while
    it lasts, which gives a drive the same impulse. So steps are all alike, and those that simulate a recording's own
    commands are that recording's own. Between steps, joints are interpolated.

    The arms start where they were measured, and not where they would come to rest at the first command: friction lets
    a joint stand anywhere within some milliradians, so that only the measurement says where. They start at rest, or at
    the speed that was measured if that explains the first tenths of a second much better. Where commands act late, what
    acts before the first one is the first one too, or to hold the start if that explains these much better.

    Args:
        scene: as `scene.build.build_rig_scene` makes it; its own time step is used.
        motion: with commands. Where openings were not told, fingers are told what was measured.

    Returns:
        The same samples with the joints, openings and velocities of the simulation, as the arms' encoders would read
        them without their noise and steps. The same inputs give the same bits.

    Raises:
        DatasetError: the motion has no commands, or other arms than the scene.
        SimulationError: physics broke down.
    """
    check_arms(scene, motion)
    ctrl = _controls(scene, motion)
    start = _start(scene, motion)
    first = int(np.searchsorted(motion.times, _FIRST, side="right"))
    steps = min(len(ctrl), int(np.ceil(_FIRST / scene.model.opt.timestep)))
    rest, moving, before = np.zeros(scene.model.nv), _speeds(scene, motion), ctrl[0] if len(ctrl) else None
    begins: list[tuple[Array, Array | None]] = [(rest, before)]
    if any(arm.command_delay for arm in scene.arms):
        begins.append((rest, None))
    if moving.any():
        begins.append((moving, before))
    if len(begins) > 1 and first > 2:
        tried = (_run(scene, motion.name, start, *one, ctrl[:steps]) for one in begins)
        misfits = [_misfit(scene, motion, run, first) for run in tried]
        best = int(np.argmin(misfits))
        begins = [begins[best if misfits[best] * _BETTER < misfits[0] else 0]]
    run = _run(scene, motion.name, start, *begins[0], ctrl)
    arms = tuple(_sampled(arm, told, run, motion.times) for arm, told in zip(scene.arms, motion.arms, strict=True))
    return Motion(motion.name, motion.times, arms)


def check_arms(scene: CompiledScene, motion: Motion) -> None:
    """Hold a motion to the arms that are to follow it.

    Raises:
        DatasetError: it has other arms, no commands, or no measured joints.
    """
    if len(motion.arms) != len(scene.arms):
        raise DatasetError(
            f"{motion.name} has {counted(len(motion.arms), 'arm')}, and the rig {len(scene.arms)}; choose another --rig"
        )
    for arm, told in zip(scene.arms, motion.arms, strict=True):
        whose = f"{motion.name}{f', {told.side} arm' if told.side else ''}"
        if told.joints.shape[1] != arm.dof:
            raise DatasetError(
                f"{whose}: has {counted(told.joints.shape[1], 'joint')}, and the rig's arm {arm.dof}; choose another "
                "--rig"
            )
        if told.commands is None or not np.isfinite(told.commands).any(axis=0).all():
            raise DatasetError(f"{whose}: holds no commands for its joints, and without them nothing can be followed")
        if not np.isfinite(told.joints).any(axis=0).all():
            raise DatasetError(f"{whose}: a joint was never measured, so it is not known where the arm began")


@dataclass(frozen=True)
class _Run:
    """What physics did: times (n,) of the states, s, MuJoCo's positions (n, nq) and velocities (n, nv)."""

    times: Array
    qpos: Array
    qvel: Array


def _run(scene: CompiledScene, name: str, start: Array, speeds: Array, before: Array | None, ctrl: Array) -> _Run:
    """Step once for each row of `ctrl` (n, nu); `before` it drives were told that (nu,), or to hold the start."""
    model, data = scene.model, mujoco.MjData(scene.model)
    scene.reset(data, start, commanded=before)
    data.qvel[:] = speeds
    qpos, qvel = np.empty((len(ctrl) + 1, model.nq)), np.empty((len(ctrl) + 1, model.nv))
    qpos[0], qvel[0] = data.qpos, data.qvel
    for k, told in enumerate(ctrl):
        data.ctrl[:] = told
        scene.step(data)
        qpos[k + 1], qvel[k + 1] = data.qpos, data.qvel
        if (k % _LOOK_STEPS == 0 or k == len(ctrl) - 1) and (text := breakdown(data)):
            # The time is counted in steps, since MuJoCo has reset its own clock.
            raise SimulationError(f"{name}: physics broke down within {(k + 1) * model.opt.timestep:.3f} s: {text}")
    return _Run(np.arange(len(ctrl) + 1) * model.opt.timestep, qpos, qvel)


def _controls(scene: CompiledScene, motion: Motion) -> Array:
    """What MuJoCo is told at each step (n, nu)."""
    timestep = float(scene.model.opt.timestep)
    # A sample that rounding puts just behind a step needs no further one.
    steps = int(np.ceil(motion.duration / timestep - 1e-6))
    edges = np.arange(steps + 1, dtype=np.float64) * timestep
    ctrl = np.zeros((steps, scene.model.nu))
    for arm, told in zip(scene.arms, motion.arms, strict=True):
        assert told.commands is not None, "checked before"
        commands = held(told.commands, told.joints)
        ctrl[:, arm.arm_ctrl] = _means(motion.times, np.clip(commands, *arm.ctrl_range.T), edges)
        if arm.fingers is not None:
            openings = np.clip(_asked_openings(arm, told), *arm.fingers.ctrl_range)
            ctrl[:, [arm.fingers.ctrl]] = _means(motion.times, openings[:, None], edges)
    return ctrl


def _means(times: Array, values: Array, edges: Array) -> Array:
    """The mean (n - 1, k) between each two of `edges` (n,) of what each of `values` (m, k) is from its time on."""
    sums = np.vstack([np.zeros(values.shape[1]), np.cumsum(values[:-1] * np.diff(times)[:, None], axis=0)])
    at = np.clip(np.searchsorted(times, edges, side="right") - 1, 0, None)
    integral = sums[at] + values[at] * (edges - times[at])[:, None]
    means: Array = np.diff(integral, axis=0) / np.diff(edges)[:, None]
    # Where one value lasts for the whole step, it is that value to the last bit.
    alone = at[:-1] == np.clip(np.searchsorted(times, edges[1:], side="left") - 1, 0, None)
    means[alone] = values[at[:-1]][alone]
    return means


def held(values: Array, before: Array) -> Array:
    """Values (n, k) with the last known one in place of each NaN; before the first, the first known of `before`."""
    filled = values.copy()
    if np.isfinite(values).all():
        return filled
    for column, first in zip(filled.T, _first_known(before), strict=True):
        if not np.isfinite(column[0]):
            column[0] = first
        known = np.maximum.accumulate(np.where(np.isfinite(column), np.arange(len(column)), 0))
        column[:] = column[known]
    return filled


def _first_known(rows: Array) -> Array:
    """The first finite value of each column (k,); NaN where there is none."""
    finite = np.isfinite(rows)
    values: Array = np.where(finite.any(axis=0), rows[finite.argmax(axis=0), np.arange(rows.shape[1])], np.nan)
    return values


def _asked_openings(arm: SceneArm, told: ArmMotion) -> Array:
    """What an arm's fingers are told (n,): closed where nobody recorded anything of them."""
    assert arm.fingers is not None, "asked of arms with fingers"
    closed = np.full((len(told.joints), 1), arm.fingers.stops[0])
    for openings in (told.commanded_openings, told.openings):
        if openings is not None and np.isfinite(openings).any():
            seen = closed if told.openings is None else told.openings[:, None]
            before = np.where(np.isfinite(_first_known(seen)), seen, openings[:, None])
            return held(openings[:, None], before)[:, 0]
    return closed[:, 0]


def _start(scene: CompiledScene, motion: Motion) -> Array:
    """MuJoCo's positions (nq,) where everything was measured first."""
    qpos: Array = scene.model.qpos0.copy()
    for arm, told in zip(scene.arms, motion.arms, strict=True):
        qpos[arm.joint_qpos] = _first_known(told.joints) - arm.offset
        if arm.fingers is not None:
            measured = None if told.openings is None else _first_known(told.openings[:, None])[0]
            opening = measured if measured is not None and np.isfinite(measured) else _asked_openings(arm, told)[0]
            qpos[arm.fingers.qpos] = np.clip(opening, *arm.fingers.stops) * arm.fingers.sign
    return qpos


def _speeds(scene: CompiledScene, motion: Motion) -> Array:
    """MuJoCo's velocities (nv,) at the start, as they were measured or follow from the first samples."""
    speeds = np.zeros(scene.model.nv)
    for arm, told in zip(scene.arms, motion.arms, strict=True):
        if told.velocities is not None and np.isfinite(told.velocities[0]).all():
            speeds[arm.joint_dof] = told.velocities[0]
            continue
        rows = np.flatnonzero(np.isfinite(told.joints).all(axis=1))[:_SLOPE_SAMPLES]
        if len(rows) >= 3 and motion.times[rows[-1]] <= _FIRST:
            # A parabola, so that the acceleration does not count as speed.
            speeds[arm.joint_dof] = np.polyfit(motion.times[rows], told.joints[rows], 2)[1]
    return speeds


def _misfit(scene: CompiledScene, motion: Motion, run: _Run, first: int) -> float:
    """RMS distance of a run from the first samples that were measured, rad."""
    times = motion.times[:first]
    off = [
        _read(arm, run, run.qpos[:, arm.joint_qpos], times) + arm.offset - told.joints[:first]
        for arm, told in zip(scene.arms, motion.arms, strict=True)
    ]
    known = np.concatenate([rows[np.isfinite(rows)] for rows in off])
    return float(np.sqrt(np.mean(np.square(known)))) if len(known) else 0.0


def _read(arm: SceneArm, run: _Run, rows: Array, times: Array) -> Array:
    """Rows (n, k) of a run as an arm's encoders read them at other times (m,), (m, k): late, where they are."""
    return np.column_stack([np.interp(times - arm.sensor_delay, run.times, column) for column in rows.T])


def _sampled(arm: SceneArm, told: ArmMotion, run: _Run, times: Array) -> ArmMotion:
    openings = None
    if arm.fingers is not None:
        openings = _read(arm, run, run.qpos[:, arm.fingers.qpos[:1]] * arm.fingers.sign[0], times)[:, 0]
    return replace(
        told,
        joints=_read(arm, run, run.qpos[:, arm.joint_qpos], times) + arm.offset,
        openings=openings,
        velocities=_read(arm, run, run.qvel[:, arm.joint_dof], times),
    )


def hand_poses(scene: CompiledScene, number: int, joints: Array) -> Array:
    """Pose (n, 4, 4) of an arm's `grasp_site` in its base, for joints as they are read (n, dof); NaN where one is.

    Args:
        number: of the arm in `scene.arms`.
    """
    arm, data = scene.arms[number], mujoco.MjData(scene.model)
    site, T_world_in_base = data.site(f"{arm.prefix}grasp_site"), inverse(arm.T_base_in_world)
    poses = np.full((len(joints), 4, 4), np.nan)
    for row in np.flatnonzero(np.isfinite(joints).all(axis=1)):
        data.qpos[arm.joint_qpos] = joints[row] - arm.offset
        mujoco.mj_kinematics(scene.model, data)
        poses[row] = T_world_in_base @ pose(site.xpos, site.xmat.reshape(3, 3))
    return poses
