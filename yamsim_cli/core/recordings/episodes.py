"""Motions in episodes of ours, of the simulation or imported."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..config.rig import RigConfig
from ..dataset.reader import RecordedEpisode
from ..errors import DatasetError
from ..geometry.se3 import Array
from ..motion import ArmMotion, Motion
from .columns import sides


def read_episode(episode: RecordedEpisode, rig: RigConfig) -> Motion:
    """The motion of an episode.

    Commands are what the drives were told on each control tick; joints were measured at frames alone, and are NaN at
    the ticks between. Where nobody recorded ticks there is a sample for each frame.

    Raises:
        DatasetError: it is damaged, or of another rig.
    """
    record, name = episode.record, str(episode.directory)
    drives = record.drives
    if record.arms != len(rig.arms) or drives not in (rig.drives, min(arm.robot.dof for arm in rig.arms)):
        raise DatasetError(
            f"{name}: has {record.arms} arms of {drives} drives, and rig {rig.name!r} has {len(rig.arms)} of "
            f"{rig.drives}; give --rig {record.rig}"
        )
    frames = episode.frames()
    if len(frames) < 2:
        raise DatasetError(f"{name}: has {len(frames)} frames; a motion needs two at least")
    times = np.array([frame["timestamp"] for frame in frames], dtype=np.float64)
    if np.any(np.diff(times) <= 0):
        raise DatasetError(f"{name}: timestamps do not increase; check it with yamsim summarize --strict")
    joints = _rows(frames, "joints", record.arms, drives)
    commands = _rows(frames, "ctrl", record.arms, drives) if "ctrl" in frames[0] else None
    times -= times[0]
    if "sim_ctrl" in frames[0]:
        times, joints, commands = _by_ticks(times, joints, frames, rig)
    return Motion(name, times, tuple(_arm(side, k, joints, commands, rig) for k, side in enumerate(sides(rig))))


def _rows(frames: list[dict[str, Any]], key: str, arms: int, drives: int) -> Array:
    """One row of all drives a frame (n, arms, drives)."""
    rows = np.array([np.asarray(frame[key], dtype=np.float64).ravel() for frame in frames])
    return rows.reshape(len(frames), arms, drives)


def _by_ticks(times: Array, joints: Array, frames: list[dict[str, Any]], rig: RigConfig) -> tuple[Array, Array, Array]:
    """The motion with a sample for each control tick: times, measured joints and commands (n, arms, drives)."""
    told = [np.asarray(frame["sim_ctrl"], dtype=np.float64) for frame in frames]
    order = np.concatenate([np.arange(rig.drives) + arm * rig.drives for arm in rig.recorded])
    starts, commands, measured = [], [], []
    for k, ticks in enumerate(told):
        # The last frame may have fewer ticks than those before it; they are as long.
        if k + 1 < len(times):
            tick = (times[k + 1] - times[k]) / len(ticks)
        starts += list(times[k] + tick * np.arange(len(ticks)))
        commands += list(ticks[:, order].reshape(len(ticks), len(rig.arms), rig.drives))
        measured += [joints[k], *np.full((len(ticks) - 1, *joints[k].shape), np.nan)]
    return np.array(starts), np.array(measured), np.array(commands)


def _arm(side: str, k: int, joints: Array, commands: Array | None, rig: RigConfig) -> ArmMotion:
    robot = rig.arms[rig.recorded[k]].robot
    dof = robot.dof
    with_fingers = robot.fingers is not None and joints.shape[2] > dof
    return ArmMotion(
        side,
        joints[:, k, :dof],
        None if commands is None else commands[:, k, :dof],
        joints[:, k, dof] if with_fingers else None,
        commands[:, k, dof] if with_fingers and commands is not None else None,
    )
