"""Makes an episode's frames at other times than the recorded ones: its control ticks are simulated again."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..attempt.engine import repeat
from ..attempt.frames import frames
from ..attempt.payload import versions
from ..attempt.simulator import Simulator
from ..dataset.lowdim import planned_joints, recorded_actions
from ..dataset.reader import StoredEpisode
from ..dataset.records import recorded_attempt
from ..episode.rules import REPEATED_RULES
from ..errors import DatasetError
from ..geometry.se3 import Array
from ..scene.compiled import CompiledScene
from ..sim.moments import Moments
from ..types import Actions, Attempt, StepState

# How far repeated physics may lead from the recorded states, m or rad. Another machine's rounding leads as far.
_APART = 1e-4
# Times are compared with this tolerance, so that the last recorded frame counts, s.
_ROUNDING_S = 1e-9


@dataclass(frozen=True)
class Resampled:
    """An episode at another rate.

    Attributes:
        attempt: the episode's attempt.
        times: the frames' times (n,), s.
        qpos: MuJoCo's positions (n, nq) at these times.
        frames: the lowdim frames that would have been recorded then, see `dataset.lowdim`.
    """

    attempt: Attempt
    times: Array
    qpos: Array
    frames: list[dict[str, Any]]


def frame_times(frames: int, period: float, fps: float) -> Array:
    """The times k / fps (n,), s, from the first recorded frame to the last one.

    Args:
        frames: how many frames were recorded.
        period: time from one to the next, s.
    """
    times: Array = np.arange(math.floor(((frames - 1) * period + _ROUNDING_S) * fps) + 1) / fps
    return times


def nearest_frames(times: Array, frames: int, period: float) -> list[int]:
    """The recorded frame that is nearest to each of some times, s."""
    return [min(round(time / period), frames - 1) for time in times]


def resample(simulator: Simulator, episode: StoredEpisode, fps: float) -> Resampled:
    """An episode at `fps` frames a second. Each state is the simulation's own at its time, and none is interpolated.

    `action_joints` keeps its meaning: what the plan asks for one control tick ahead. It was recorded once per frame.
    Between frames it is the arm's position one tick ahead, plus the lead of the plan over the arm, which is
    interpolated between frames. The opening of the fingers is interpolated itself.

    Args:
        simulator: of the dataset's own config.

    Raises:
        DatasetError: the episode was not simulated, is damaged or of another scene, or physics no longer leads to its
            recorded states.
    """
    recorded, record = episode.frames(), episode.record
    scene = simulator.scene
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
    # States are needed at each frame's time, and one tick later, which is the time that its command is for.
    moments, places = np.unique(
        np.round(np.concatenate([times, times + tick, stored, stored + tick]), 12), return_inverse=True
    )
    see = Moments(scene.model, moments)
    attempt = recorded_attempt(record, start)
    repeat(simulator, attempt, actions, REPEATED_RULES, on_step=see)
    here, ahead, then, commanded = np.split(see.qpos[places], np.cumsum([len(times), len(times), len(stored)]))
    _require_same(episode, recorded, then)
    asked = np.array([planned_joints(frame, len(scene.arms)) for frame in recorded])
    lead = asked - _arms(scene, commanded)
    wanted = _arms(scene, ahead) + _between(times, stored, lead)
    if scene.arms[0].fingers is not None:
        # The last of each arm's numbers is its fingers' opening.
        wanted[..., -1] = _between(times, stored, asked[..., -1])
    acting = np.minimum(((times + _ROUNDING_S) / tick).astype(int), len(actions.ctrl) - 1)
    states = [
        StepState(float(time), qpos, Actions(actions.ctrl[k : k + 1], actions.magnet[k : k + 1], joints[None]))
        for time, qpos, joints, k in zip(times, here, wanted, acting, strict=True)
    ]
    said = {key: recorded[0][key] for key in ("language_task", "language_prompt")}
    return Resampled(attempt, times, here, [frame | said for frame in frames(simulator, attempt, states)])


def _arms(scene: CompiledScene, qpos: Array) -> Array:
    """Each arm's joints and finger (n, arms, drives), from MuJoCo's positions (n, nq)."""
    joints: Array = qpos[:, [arm.recorded_qpos for arm in scene.arms]]
    return joints


def _between(times: Array, nodes: Array, values: Array) -> Array:
    """Values (n, ...) at some times, interpolated linearly between values (m, ...) at the nodes (m,)."""
    columns = values.reshape(len(values), -1).T
    found: Array = np.column_stack([np.interp(times, nodes, column) for column in columns])
    return found.reshape(len(times), *values.shape[1:])


def _require_same(episode: StoredEpisode, recorded: Sequence[Mapping[str, Any]], found: Array) -> None:
    """Raise DatasetError unless physics led to the recorded positions (frames, nq)."""
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
