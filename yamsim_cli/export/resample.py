"""Resample an episode to another frame rate by simulating its control ticks again."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from ..core.attempt_data import ActionSequence, Attempt, StepState
from ..core.dataset.lowdim import planned_joints, recorded_actions
from ..core.dataset.reader import StoredEpisode
from ..core.dataset.records import attempt_from_record
from ..core.episode.attempt_payload import frame_records, library_versions
from ..core.episode.episode_rules import REPLAY_RULES
from ..core.episode.execution import simulate_actions
from ..core.episode.simulator import Simulator
from ..core.errors import DatasetError
from ..core.geometry.se3 import Array
from ..core.scene.compiled import CompiledScene
from .export_source import ROUNDING_S

# m or rad, largest accepted deviation of replayed from recorded states; rounding on other machines can cause as much
_MAX_DEVIATION = 1e-4


@dataclass(frozen=True)
class ResampledEpisode:
    """An episode at another frame rate.

    Attributes:
        times: of the frames (n,), s.
        qpos: MuJoCo's positions (n, nq) at these times.
        frames: all values except images at these times.
    """

    attempt: Attempt
    times: Array
    qpos: Array
    frames: list[dict[str, Any]]


class StateSampler:
    """Stores MuJoCo `qpos` at given times while a simulation runs, as the `on_step` callback of `core.episode.Episode`.

    A sample at the time of a step is exact. Between steps, positions are interpolated.

    Attributes:
        qpos: positions (n, nq) at the times; NaN for times that the simulation has not reached.

    Args:
        times: (n,) in ascending order, s.
    """

    def __init__(self, model: mujoco.MjModel, times: Array) -> None:
        self._model = model
        self._times = times
        self._next = 0
        self._before = (0.0, np.zeros(model.nq))
        self.qpos = np.full((len(times), model.nq), np.nan)

    def __call__(self, data: mujoco.MjData) -> None:
        """Store all samples up to the current state."""
        while self._next < len(self._times) and self._times[self._next] <= data.time + ROUNDING_S:
            self.qpos[self._next] = self._qpos_at(self._times[self._next], data)
            self._next += 1
        self._before = (data.time, data.qpos.copy())

    def _qpos_at(self, time: float, data: mujoco.MjData) -> Array:
        then, qpos = self._before
        if abs(time - data.time) <= ROUNDING_S:
            present: Array = data.qpos.copy()
            return present
        if abs(time - then) <= ROUNDING_S:
            return qpos
        velocity, found = np.zeros(self._model.nv), qpos.copy()
        mujoco.mj_differentiatePos(self._model, velocity, 1.0, qpos, data.qpos)
        mujoco.mj_integratePos(self._model, found, velocity, (time - then) / (data.time - then))
        return found


def frame_times(frames: int, period: float, fps: float) -> Array:
    """Return the times k / fps (n,), s, within `frames` recorded frames that are `period` s apart."""
    times: Array = np.arange(math.floor(((frames - 1) * period + ROUNDING_S) * fps) + 1) / fps
    return times


def nearest_frames(times: Array, frames: int, period: float) -> list[int]:
    """Return the index of the nearest of `frames` recorded frames, `period` s apart, for each time, s."""
    return [min(round(time / period), frames - 1) for time in times]


def resample_episode(
    simulator: Simulator, episode: StoredEpisode, fps: float, first: int = 0, count: int | None = None
) -> ResampledEpisode:
    """Resample an episode to `fps` frames per second. States are simulated, not interpolated.

    Only the time of `count` recorded frames, by default all, from frame `first` on is resampled. The whole episode is
    simulated nevertheless, because the recorded state of a later frame has no velocities.

    `action_joints`, the planned joints one control tick ahead, was recorded once per frame. Between frames, it is the
    simulated joints plus the interpolated difference between plan and simulation. The finger opening is interpolated.
    """
    recorded, record = episode.frames(), episode.record
    scene = simulator.scene
    found = recorded_actions(recorded, scene.model.nq, scene.model.nu)
    if found is None:
        raise DatasetError(
            f"{episode.directory} holds no sim_qpos, sim_ctrl and sim_magnet, so no frames between its frames can be "
            "made: export it with --fps source"
        )
    start, actions = found
    period = record.frame_period_s
    tick = period / len(recorded[0]["sim_ctrl"])
    times = first * period + frame_times(len(recorded) if count is None else count, period, fps)
    stored = np.arange(float(len(recorded))) * period
    # One tick after a frame is the target time of its command.
    moments, places = np.unique(
        np.round(np.concatenate([times, times + tick, stored, stored + tick]), 12), return_inverse=True
    )
    seen = StateSampler(scene.model, moments)
    attempt = attempt_from_record(record, start)
    simulate_actions(simulator, attempt, actions, REPLAY_RULES, on_step=seen)
    here, ahead, then, commanded = np.split(seen.qpos[places], np.cumsum([len(times), len(times), len(stored)]))
    _require_reproduced_states(episode, recorded, then)
    planned = np.array([planned_joints(frame, len(scene.arms)) for frame in recorded])
    lead = planned - _joints_of_arms(scene, commanded)
    reference = _joints_of_arms(scene, ahead) + _interpolate(times, stored, lead)
    if scene.arms[0].fingers is not None:
        # The last value of each arm is its finger opening.
        reference[..., -1] = _interpolate(times, stored, planned[..., -1])
    acting = np.minimum(((times + ROUNDING_S) / tick).astype(int), len(actions.ctrl) - 1)
    states = [
        StepState(float(time), qpos, ActionSequence(actions.ctrl[k : k + 1], actions.magnet[k : k + 1], joints[None]))
        for time, qpos, joints, k in zip(times, here, reference, acting, strict=True)
    ]
    texts = {key: recorded[0][key] for key in ("language_task", "language_prompt")}
    return ResampledEpisode(
        attempt, times, here, [frame | texts for frame in frame_records(simulator, attempt, states)]
    )


def _joints_of_arms(scene: CompiledScene, qpos: Array) -> Array:
    joints: Array = qpos[:, [arm.recorded_qpos for arm in scene.arms]]
    return joints


def _interpolate(times: Array, nodes: Array, values: Array) -> Array:
    """Interpolate `values` (m, ...) at `nodes` (m,) linearly at `times` (n,). Return (n, ...)."""
    columns = values.reshape(len(values), -1).T
    found: Array = np.column_stack([np.interp(times, nodes, column) for column in columns])
    return found.reshape(len(times), *values.shape[1:])


def _require_reproduced_states(episode: StoredEpisode, recorded: Sequence[Mapping[str, Any]], found: Array) -> None:
    deviation = np.abs(found - np.array([frame["sim_qpos"] for frame in recorded])).max(axis=1)
    if np.nanmax(deviation, initial=0.0) > _MAX_DEVIATION or np.isnan(deviation).any():
        k = int(np.argmax(~(deviation <= _MAX_DEVIATION)))
        now, was = library_versions(), episode.record.versions
        changed = ", ".join(
            f"{name} {was[name]} then, {now[name]} now" for name in now if was.get(name, now[name]) != now[name]
        )
        raise DatasetError(
            f"{episode.directory}: simulating its control ticks again gives a state of frame {k} that is "
            f"{deviation[k]:.2g} m or rad away from the recorded one{f' ({changed})' if changed else ''}, so no "
            "frames between the recorded frames can be made: export it with --fps source, and see `yamsim verify`"
        )
