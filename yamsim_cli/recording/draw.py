"""Draw a dataset: render its stored states again, with other images, and the same physics.

The workers, the order of writing and the treatment of faults are the same as in a recording, see `collect`. An attempt
keeps its number, so episode k shows the states of episode k.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..core.attempt_data import Attempt, AttemptJob, AttemptPayload, Outcome
from ..core.config.recording import RecordConfig
from ..core.config.session import Session
from ..core.config.variation import PHYSICS_PARTS, RandomizationSample
from ..core.dataset.dataset_paths import EPISODE_FILE, LEDGER_FILE, episode_name, lowdim_path
from ..core.dataset.lowdim import GRASP, content_hash, dump_frame, recorded_actions
from ..core.dataset.reader import StoredEpisode, open_episode
from ..core.dataset.records import AttemptRecord, EpisodeRecord, attempt_from_record, file_hashes
from ..core.dataset.writing.ledger import Ledger
from ..core.dataset.writing.staged_writer import EpisodeWriter
from ..core.episode.attempt_payload import camera_entries, encode_images, library_versions
from ..core.episode.runner import SessionRunner, require_stated_meshes
from ..core.episode.sampling import sample_variation
from ..core.episode.simulator import Simulator
from ..core.errors import DatasetError, PartialJobError
from ..core.files.writing import sha256_bytes
from ..core.geometry.se3 import Array
from ..core.scene.build import with_mesh_descriptions
from ..core.workers.executors import LostJobError
from ..core.workers.process_pool import ProcessPool
from ..core.workers.stop_request import StopRequest
from .collect import Collector, EpisodeExecutor, RecordCallbacks
from .recorder import RecordReport, fill_dataset
from .recording_output import RecordingOutput

_WRIST_KEY = "K_wrist"
_IMAGE_VERSIONS = ("looks", "opencv")  # versions of what affects only images


@dataclass(frozen=True)
class DrawSource:
    """The dataset to draw, and the records of its attempts. `keeps_variation`: without new samples of randomization."""

    path: Path
    attempts: Sequence[AttemptRecord]
    keeps_variation: bool

    @property
    def episodes(self) -> int:
        """Number of episodes."""
        return sum(attempt.episode is not None for attempt in self.attempts)

    def open(self, attempt: int) -> StoredEpisode:
        """Open the episode of a successful attempt. Raise DatasetError if it is missing or damaged."""
        return open_episode(self.path / episode_name(self.attempts[attempt].episode or 0))


def read_attempts(dataset: Path) -> list[AttemptRecord]:
    """Return the attempts of a dataset's ledger. Raise DatasetError if lines are missing or no attempt succeeded."""
    ledger = Ledger(dataset)
    attempts = list(ledger.known_attempts.values())
    if ledger.fault or [attempt.attempt for attempt in attempts] != list(range(len(attempts))):
        why = ledger.fault or "lines are missing"
        raise DatasetError(
            f"{dataset / LEDGER_FILE}: {why}; `yamsim record --resume --config {dataset}/config.yaml --out {dataset}` "
            "restores it"
        )
    if not any(attempt.episode is not None for attempt in attempts):
        raise DatasetError(f"{dataset} has no episodes to draw; record some with `yamsim record --out {dataset}`")
    return attempts


class EpisodeDrawer(SessionRunner):
    """Renders stored episodes again, in a worker. Raises ResourceError as `require_stated_meshes`."""

    def __init__(self, session: Session, source: DrawSource) -> None:
        require_stated_meshes(session)
        super().__init__(session)
        self._source = source

    def run(self, job: AttemptJob) -> AttemptPayload:
        """Return a success with the files of its episode, and a failure without files."""
        line = self._source.attempts[job.attempt]
        if line.episode is None:
            return AttemptPayload(Attempt(job), Outcome(False))
        episode, simulator = self._source.open(job.attempt), self._simulators.get(job)
        frames, model = episode.frames(), simulator.scene.model
        if recorded_actions(frames, model.nq, model.nu) is None:
            raise DatasetError(
                f"{episode.directory} holds no states (sim_qpos), so it cannot be drawn; record it again"
            )
        positions = [frame["sim_qpos"] for frame in frames]
        attempt = self._with_look(simulator, attempt_from_record(episode.record), positions)
        simulator.apply_randomization(attempt)
        drawn = [_with_cameras(simulator, frame) for frame in frames]
        files = {
            lowdim_path(k): episode.read(lowdim_path(k)) if new is old else dump_frame(new)
            for k, (old, new) in enumerate(zip(frames, drawn, strict=True))
        }
        files |= encode_images(simulator, attempt, positions)
        now = library_versions()
        versions = {name: now[name] for name in _IMAGE_VERSIONS} | {
            "drawn_by": f"yamsim {__version__}, mujoco {now['mujoco']}",
            "drawn_from": sha256_bytes(episode.read(EPISODE_FILE)),
        }
        renderer = simulator.renderer.description
        return AttemptPayload(attempt, Outcome(True), files, len(frames), content_hash(drawn), versions, renderer)

    def _with_look(self, simulator: Simulator, stored: Attempt, positions: Sequence[Array]) -> Attempt:
        """Return the attempt with the variation of the config's look; values that affect physics do not change."""
        if self._source.keeps_variation:
            return stored
        placer, variation = simulator.distractor_placer, sample_variation(simulator.config, stored.job)
        distractors = placer.sample_poses(stored.job, positions) if placer else {}
        return replace(stored, variation=with_physics_of(stored.variation, replace(variation, distractors=distractors)))


def with_physics_of(stored: RandomizationSample, look: RandomizationSample) -> RandomizationSample:
    """Return the samples of `look`, but the samples of `stored` that affect physics."""
    return replace(look, **{part: getattr(stored, part) for part in (*PHYSICS_PARTS, "pushes")})


def _with_cameras(simulator: Simulator, frame: dict[str, Any]) -> dict[str, Any]:
    """Return a frame with the poses and intrinsics of the simulator's cameras; the same object if nothing changes."""
    simulator.state_replay.set_state(frame["sim_qpos"])
    entries: dict[str, Any] = {
        key: {camera: np.ascontiguousarray(value, np.float32) for camera, value in values.items()}
        for key, values in camera_entries(simulator).items()
    }
    wrists = [arm.wrist_camera_name for arm in simulator.config.wrist_arms]
    if len(wrists) == 1:
        entries[_WRIST_KEY] = entries["intrinsics"][wrists[0]]
    if _equal_cameras(frame, entries):
        return frame
    before_wrist = GRASP if GRASP in frame else "language_prompt"
    changed: dict[str, Any] = {}
    for key, value in frame.items():
        if key != _WRIST_KEY:
            changed[key] = entries.get(key, value)
        if key == before_wrist and _WRIST_KEY in entries:
            changed[_WRIST_KEY] = entries[_WRIST_KEY]
    return changed


def _equal_cameras(frame: Mapping[str, Any], entries: Mapping[str, Any]) -> bool:
    if (_WRIST_KEY in frame) != (_WRIST_KEY in entries):
        return False
    return all(
        list(frame[key]) == list(entries[key])
        and all(np.array_equal(frame[key][name], value) for name, value in entries[key].items())
        for key in ("intrinsics", "extrinsics")
    )


class DrawCollector(Collector):
    """Writes drawn episodes with the records of their source; every attempt ends as it did there."""

    def __init__(
        self,
        config: RecordConfig,
        sink: EpisodeWriter,
        callbacks: RecordCallbacks,
        stop: StopRequest,
        source: DrawSource,
    ) -> None:
        super().__init__(config, sink, callbacks, stop, lambda cause, first: False)
        self._source = source

    def finish(self) -> None:
        """Log the failures after the last episode."""
        for attempt in self._source.attempts[len(self._sink.attempts) :]:
            self._sink.log_attempt(attempt)

    def check_retry_limit(self) -> None:
        """Do nothing: the number of attempts is known."""

    def _mark_lost(self, error: LostJobError) -> None:
        assert isinstance(error.job, AttemptJob)
        name = episode_name(self._source.attempts[error.job.attempt].episode or 0)
        raise PartialJobError(f"{name} cannot be drawn: {error}") from error

    def _attempt_record(self, payload: AttemptPayload, episode: int | None) -> AttemptRecord:
        line = self._source.attempts[payload.job.attempt]
        return line if episode is None else line.model_copy(update={"randomized": payload.attempt.variation})

    def _episode_record(self, payload: AttemptPayload, episode: int) -> EpisodeRecord:
        config, record = self._config, self._source.open(payload.job.attempt).record
        meshes = None if config.meshes is None else dict(config.meshes)
        cameras = dict.fromkeys(config.recorded_cameras, config.image.size_px)
        return record.model_copy(
            update={
                "rig": config.rig.name,
                "scene": config.scene.name,
                "cameras": cameras,
                "truth": config.truth,
                "randomized": payload.attempt.variation,
                "versions": {**record.versions, **payload.versions},
                "renderer": payload.renderer,
                "meshes": meshes,
                "content_sha256": payload.content_sha256,
                "files": file_hashes(payload.files),
            }
        )


def draw(
    session: Session,
    source: DrawSource,
    output: RecordingOutput,
    callbacks: RecordCallbacks,
    stop: StopRequest,
    job_seconds: float,
) -> RecordReport:
    """Render the episodes of a dataset again, with the session's config, into another dataset.

    Args:
        session: its config has the task and the seed of the source.
        job_seconds: longest time for an episode, s, after which its worker is replaced.
    """
    began = time.monotonic()

    def make_collector(config: RecordConfig, sink: EpisodeWriter) -> Collector:
        return DrawCollector(config, sink, callbacks, stop, source)

    def open_executor(session: Session, workers: int) -> EpisodeExecutor:
        return ProcessPool(functools.partial(EpisodeDrawer, session, source), workers, job_seconds)

    session = with_mesh_descriptions(session.with_values(episodes=source.episodes))
    return fill_dataset(session, output, open_executor, make_collector, callbacks, stop, began)
