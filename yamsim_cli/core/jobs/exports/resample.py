"""An episode's frames at other times than its own: its recorded control ticks act again, and states are taken there."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...dataset.actions import recorded_actions
from ...dataset.reader import StoredEpisode
from ...errors import DatasetError
from ...geometry.se3 import Array
from ...scene.compiled import CompiledScene
from ...sim.moments import Moments
from ...types import Actions, StepState
from ..episode import EpisodeRunner, versions
from ..remake import vary

# How far repeated physics may lead from what was recorded, m or rad: as far as another machine's rounding does.
_APART = 1e-4
# A recorded time at the end still counts, s.
_ROUNDING_S = 1e-9


@dataclass(frozen=True)
class Resampled:
    """An episode at a rate of its own.

    Attributes:
        times: of each frame, s.
        qpos: MuJoCo's positions (n, nq) then.
        frames: what would have been recorded then, see `dataset.lowdim`.
    """

    times: Array
    qpos: Array
    frames: list[dict[str, Any]]


def frame_times(frames: int, period: float, fps: float) -> Array:
    """The times k / fps, s, from the first recorded frame's to the last one's.

    Args:
        frames: how many were recorded.
        period: from one to the next, s.
    """
    times: Array = np.arange(math.floor(((frames - 1) * period + _ROUNDING_S) * fps) + 1) / fps
    return times


def nearest_frames(times: Array, frames: int, period: float) -> list[int]:
    """The recorded frame that is nearest to each of some times, s."""
    return [min(round(time / period), frames - 1) for time in times]


def resample(runner: EpisodeRunner, episode: StoredEpisode, fps: float) -> Resampled:
    """An episode at fps frames a second. Nothing is held: each state is the simulation's own at that time.

    `action_joints` stays what it is in a recording: what the plan asks for one control tick ahead. It was recorded once
    a frame. In between it is where the arm is one tick ahead, and on top by how much the plan leads it there, which
    changes evenly from frame to frame. The opening of the fingers changes evenly itself.

    Args:
        runner: of the dataset's configuration; afterwards its scene is varied as the episode's.

    Raises:
        DatasetError: it was not simulated, is damaged or of another scene, or physics leads elsewhere today.
    """
    recorded, record = episode.frames(), episode.record
    scene = runner.scene
    found = recorded_actions(recorded, scene.model.nq, scene.model.nu)
    if found is None:
        raise DatasetError(
            f"{episode.directory} holds no sim_qpos, sim_ctrl and sim_magnet, so nothing between its frames can be "
            "made: export it with --fps source"
        )
    start, actions = found
    period = record.frame_period_s
    tick = period / len(recorded[0]["sim_ctrl"])
    times = frame_times(len(recorded), period, fps)
    stored = np.arange(float(len(recorded))) * period
    # Of a frame, and of what its command is for.
    moments, places = np.unique(
        np.round(np.concatenate([times, times + tick, stored, stored + tick]), 12), return_inverse=True
    )
    see = Moments(scene.model, moments)
    vary(runner, episode)
    runner.repeat(start, actions, 0.0, 0.0, planned=record.source == "record", see=see)
    here, ahead, then, commanded = np.split(see.qpos[places], np.cumsum([len(times), len(times), len(stored)]))
    _require_same(episode, recorded, then)
    asked: Array = np.array([np.asarray(frame["action_joints"], dtype=float) for frame in recorded])
    lead = asked - _arms(scene, commanded)
    wanted = _arms(scene, ahead) + _between(times, stored, lead)
    fingers = slice(6, None, 7)
    wanted[:, fingers] = _between(times, stored, asked[:, fingers])
    acting = np.minimum(((times + _ROUNDING_S) / tick).astype(int), len(actions.ctrl) - 1)
    states = [
        StepState(float(time), qpos, Actions(actions.ctrl[k : k + 1], actions.magnet[k : k + 1], joints[None]))
        for time, qpos, joints, k in zip(times, here, wanted, acting, strict=True)
    ]
    said = {key: recorded[0][key] for key in ("language_task", "language_prompt")}
    return Resampled(times, here, [frame | said for frame in runner.frames(states)])


def _arms(scene: CompiledScene, qpos: Array) -> Array:
    """Each arm's six joints and finger (n, 7 or 14), of MuJoCo's positions (n, nq)."""
    columns = [part for arm in scene.arms for part in (arm.joint_qpos, arm.gripper_qpos[:1])]
    joints: Array = qpos[:, np.concatenate(columns)]
    return joints


def _between(times: Array, nodes: Array, values: Array) -> Array:
    """Values (n, k) at some times, on straight lines between those (m, k) at the nodes (m,)."""
    found: Array = np.column_stack([np.interp(times, nodes, column) for column in values.T])
    return found


def _require_same(episode: StoredEpisode, recorded: Sequence[Mapping[str, Any]], found: Array) -> None:
    """Raise DatasetError unless physics led to the positions (frames, nq) that were recorded."""
    apart = np.abs(found - np.array([frame["sim_qpos"] for frame in recorded])).max(axis=1)
    if np.nanmax(apart, initial=0.0) > _APART or np.isnan(apart).any():
        k = int(np.argmax(~(apart <= _APART)))
        now, was = versions(), episode.record.versions
        changed = ", ".join(
            f"{name} {was[name]} then, {now[name]} now" for name in now if was.get(name, now[name]) != now[name]
        )
        raise DatasetError(
            f"{episode.directory}: its control ticks, repeated in physics, lead {apart[k]:.2g} m or rad away by frame "
            f"{k}{f' ({changed})' if changed else ''}, so nothing between its frames can be made: export it with "
            "--fps source, and see `yamsim verify`"
        )
