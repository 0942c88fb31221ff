"""Verify a dataset: worker processes reproduce its episodes and compare them with the stored data.

An episode is simulated from its seed (`SEED`) and from its recorded actions (`ACTIONS`), and its images are rendered
(`IMAGES`).
"""

from __future__ import annotations

import functools
import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..core.attempt_data import AttemptJob
from ..core.closable import Closable
from ..core.config.mesh_provenance import describe_mesh_content, mesh_differences
from ..core.config.session import Session
from ..core.dataset.dataset_paths import CONFIG_FILE, EPISODE_FILE, TRUTH_FOLDERS, image_path, lowdim_path
from ..core.dataset.lowdim import ACTION, recorded_actions
from ..core.dataset.reader import StoredEpisode, open_episode
from ..core.dataset.records import EpisodeRecord, OutcomeRecord, attempt_from_record
from ..core.episode.attempt_payload import (
    APPEARANCE_REVISION,
    SIMULATION_REVISION,
    encode_images,
    library_versions,
)
from ..core.episode.attempt_payload import frame_records as made_frames
from ..core.episode.episode_rules import EXPERT_RULES, REPLAY_RULES
from ..core.episode.execution import simulate_actions, simulate_expert
from ..core.episode.sampling import sample_attempt
from ..core.episode.simulator import Simulator, SimulatorCache, make_simulator
from ..core.errors import DatasetError, InterruptedJobError, join_ranges
from ..core.images.jpeg import decode_jpeg
from ..core.progress import Progress
from ..core.scene.build import describe_meshes
from ..core.workers.executors import run_all
from ..core.workers.process_pool import ProcessPool
from ..correction_record import with_who
from .compare import EpisodeComparison, ValueDifference, compare_frames, compare_values

# Checks, in the order in which their differences are reported.
SEED, ACTIONS, IMAGES = "seed", "actions", "images"
CHECK_NAMES = (SEED, ACTIONS, IMAGES)

_CAMERA_KEYS = ("intrinsics", "extrinsics", "K_wrist")  # of frames; cameras may be on the arm

RecordedFrames = Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class Tolerances:
    """Largest accepted differences.

    Attributes:
        values: of a number: absolute in rad and m, relative for values above 1.
        images: mean pixel difference, 0 to 255. At 0, files must be equal byte for byte. None skips images.
    """

    values: float
    images: float | None


@dataclass(frozen=True)
class EpisodeVerdict:
    """Result of verifying one episode.

    Attributes:
        skipped: check -> why it was not possible.
        problems: file -> fault other than a difference of values; "" for the whole episode.
        changed_versions: library or component -> version at recording time and now, if they differ.
    """

    episode: int
    checks: Mapping[str, EpisodeComparison] = field(default_factory=dict)
    skipped: Mapping[str, str] = field(default_factory=dict)
    problems: Mapping[str, str] = field(default_factory=dict)
    changed_versions: Mapping[str, tuple[str, str]] = field(default_factory=dict)

    @property
    def is_reproduced(self) -> bool:
        """Whether the episode has no fault and no difference."""
        return not self.problems and all(check.first_difference is None for check in self.checks.values())


class EpisodeVerifier(Closable):
    """Verifies episodes of one dataset, and may own a renderer.

    Args:
        session: session of the dataset's config. Its meshes affect only images.
    """

    def __init__(self, session: Session, tolerances: Tolerances) -> None:
        self._simulators = SimulatorCache(session)
        self._session = session
        drawn = session.config.drawn
        self._drawn = drawn is not None
        self._physics, self._other_rig = self._simulators, drawn is not None and drawn.rig is not None
        if drawn is not None and drawn.rig is not None:
            # The images show another rig than the states.
            source = session.with_values(rig=drawn.rig, cameras=None, camera_effects=())
            self._physics = SimulatorCache(source.without_meshes())
        self._tolerances = tolerances

    def run(self, job: tuple[int, Path]) -> EpisodeVerdict:
        """Verify one episode; `job` is its number and its directory."""
        number, directory = job
        problems: dict[str, str] = {}
        checks: dict[str, EpisodeComparison] = {}
        skipped: dict[str, str] = {}
        changed: dict[str, tuple[str, str]] = {}
        try:
            episode = open_episode(directory)
            if others := self._mesh_differences(episode):
                problems[EPISODE_FILE] = f"it shows other meshes than {CONFIG_FILE} says: {'; '.join(others)}"
            changed = self._changed_versions(episode)
            frames = _read_frames(episode, problems)
            if episode.record.source != "record":
                skipped[SEED] = f"it comes from {episode.record.source!r}, not from a seed"
            elif (engine := episode.record.versions["engine"]) != SIMULATION_REVISION:
                version = episode.record.versions.get("yamsim", "unknown")
                skipped[SEED] = (
                    f"it was made by engine revision {engine} of yamsim {version}; this version's revision "
                    f"{SIMULATION_REVISION} makes other episodes from the same seeds; only its actions are repeated"
                )
                if self._tolerances.images is not None and not self._drawn:
                    skipped[IMAGES] = skipped[SEED]
            else:
                checks |= self._verify_from_seed(episode, frames, skipped)
            if self._drawn and self._tolerances.images is not None:
                checks |= self._verify_drawing(episode, frames, skipped)
            physics = self._physics.get(AttemptJob(episode.record.seed, episode.record.attempt))
            if repeated := reproduce_frames(physics, episode, self._physical(frames), self._tolerances.values):
                checks[ACTIONS] = repeated
            else:
                skipped[ACTIONS] = "its frames hold no sim_qpos, sim_ctrl and sim_magnet"
        except DatasetError as error:
            # The error comes first: it is more specific than the report of an altered file.
            problems = {"": str(error)} | problems
        return EpisodeVerdict(number, checks, skipped, problems, changed)

    def _verify_from_seed(
        self, episode: StoredEpisode, frames: RecordedFrames, skipped: dict[str, str]
    ) -> dict[str, EpisodeComparison]:
        """Simulate the attempt from its seed. Add to `skipped` why images are not compared."""
        record = episode.record
        simulator = self._physics.get(job := AttemptJob(record.seed, record.attempt))
        done = simulate_expert(simulator, sample_attempt(simulator, job))
        made = self._physical(made_frames(simulator, done.attempt, done.recorded_states))
        once = compare_values(
            {"outcome": _outcome_numbers(record.outcome), "start": _pose_arrays(record.layout)}
            | {"randomized": asdict(record.randomized)},
            {
                "outcome": _outcome_numbers(OutcomeRecord.from_outcome(done.outcome)),
                "start": _pose_arrays(done.attempt.object_places),
            }
            | {"randomized": asdict(done.attempt.variation)},
            self._tolerances.values,
        )
        compared = compare_frames(self._physical(frames), made, self._tolerances.values)
        checks = {SEED: _merge_comparisons(compared, once)}
        if self._tolerances.images is None or self._drawn or self._has_other_looks(record, skipped):
            return checks
        if done.recorded_states:
            images = encode_images(simulator, done.attempt, [state.qpos for state in done.recorded_states])
            checks[IMAGES] = _compare_images(episode, images, self._tolerances.images)
        return checks

    def _verify_drawing(
        self, episode: StoredEpisode, frames: RecordedFrames, skipped: dict[str, str]
    ) -> dict[str, EpisodeComparison]:
        """Render the stored states again, as `yamsim draw` did. Add to `skipped` why images are not compared."""
        assert self._tolerances.images is not None
        if self._has_other_looks(episode.record, skipped):
            return {}
        positions = [frame["sim_qpos"] for frame in frames]
        simulator = self._simulator_of(episode.record)
        images = encode_images(simulator, attempt_from_record(episode.record), positions)
        return {IMAGES: _compare_images(episode, images, self._tolerances.images)}

    @staticmethod
    def _has_other_looks(record: EpisodeRecord, skipped: dict[str, str]) -> bool:
        """Return whether there are no images of this appearance revision, and then report it in `skipped`."""
        if not record.cameras:
            skipped[IMAGES] = "it was recorded without images"
            return True
        if (looks := record.versions["looks"]) == APPEARANCE_REVISION:
            return False
        skipped[IMAGES] = (
            f"its images have appearance revision {looks}, but this version renders revision "
            f"{APPEARANCE_REVISION}: they differ as intended and are not damaged"
        )
        return True

    def _physical(self, frames: RecordedFrames) -> RecordedFrames:
        """Return frames without the values of cameras, if the images show another rig than physics has."""
        return _without_keys(frames, _CAMERA_KEYS) if self._other_rig else frames

    def _simulator_of(self, record: EpisodeRecord) -> Simulator:
        return self._simulators.get(AttemptJob(record.seed, record.attempt))

    def _changed_versions(self, episode: StoredEpisode) -> dict[str, tuple[str, str]]:
        then, now = dict(episode.record.versions), library_versions()
        simulator = self._simulator_of(episode.record)
        if self._tolerances.images is not None and episode.record.cameras:
            then["renderer"], now["renderer"] = episode.record.renderer, simulator.renderer.description
            for name, text in (episode.record.meshes or {}).items():
                then[f"meshes {name}"] = describe_mesh_content(text)
                now[f"meshes {name}"] = describe_mesh_content(self._shown_meshes.get(name))
        return {name: (then[name], now[name]) for name in then if name in now and then[name] != now[name]}

    @functools.cached_property
    def _shown_meshes(self) -> dict[str, str]:
        return describe_meshes(self._session)

    def _mesh_differences(self, episode: StoredEpisode) -> list[str]:
        stated, own = self._session.config.meshes, episode.record.meshes
        return mesh_differences(own, stated, ("here", "there")) if stated is not None and own is not None else []

    def close(self) -> None:
        """Free the renderers."""
        self._simulators.close()
        self._physics.close()


def reproduce_frames(
    simulator: Simulator, episode: StoredEpisode, frames: RecordedFrames, tolerance: float
) -> EpisodeComparison | None:
    """Replay an episode's actions in physics from its recorded start, and compare with the stored frames.

    Return None without actions that physics can replay. `tolerance` is as in `Tolerances.values`.
    """
    model = simulator.scene.model
    recorded = recorded_actions(frames, model.nq, model.nu)
    if recorded is None:
        return None
    start, actions = recorded
    stored = episode.record.outcome
    attempt = attempt_from_record(episode.record, start)
    rules = EXPERT_RULES if episode.record.source == "record" else REPLAY_RULES
    done = simulate_actions(simulator, attempt, actions, rules)
    # Actions do not show which skills the expert tried again.
    judged = OutcomeRecord.from_outcome(done.outcome).model_copy(update={"recoveries": stored.recoveries})
    # Earlier engines judged and measured differently. Final positions and speeds do not depend on that.
    keys = None if episode.record.versions["engine"] == SIMULATION_REVISION else {"dxy_m", "dz_m", "speed_mps"}
    once = compare_values(
        {"outcome": _outcome_numbers(stored, keys)}, {"outcome": _outcome_numbers(judged, keys)}, tolerance
    )
    made: RecordedFrames = with_who(made_frames(simulator, attempt, done.recorded_states), episode.record.correction)
    if simulator.config.disturb is not None:
        # Replayed actions are the disturbed `sim_ctrl`; the expert's own commands cannot be computed from them.
        frames, made = (_without_keys(each, ("ctrl", ACTION)) for each in (frames, made))
    if "extrinsics" not in frames[0]:
        made = _without_keys(made, _CAMERA_KEYS)
    return _merge_comparisons(compare_frames(frames, made, tolerance), once)


def reproduce_episode(episode: StoredEpisode, session: Session) -> EpisodeComparison | None:
    """Replay an episode's actions in physics, and compare exactly; None without replayable actions."""
    job = AttemptJob(episode.record.seed, episode.record.attempt)
    with make_simulator(session.without_meshes(), job) as simulator:
        return reproduce_frames(simulator, episode, episode.frames(), tolerance=0.0)


def _without_keys(frames: RecordedFrames, keys: Collection[str]) -> list[dict[str, Any]]:
    return [{key: value for key, value in frame.items() if key not in keys} for frame in frames]


def _read_frames(episode: StoredEpisode, problems: dict[str, str]) -> list[dict[str, Any]]:
    frames = []
    for k in range(episode.record.frames):
        data = episode.read(name := lowdim_path(k))
        if episode.is_altered(name, data):
            problems[name] = "its content is not what was recorded: its sha256 differs from episode.json"
        frames.append(episode.decode_frame_data(k, data))
    return frames


def _outcome_numbers(outcome: OutcomeRecord, keys: set[str] | None = None) -> dict[str, Any]:
    return outcome.model_dump(include=keys, exclude={"detail"})


def _pose_arrays(poses: Mapping[str, Sequence[float]]) -> dict[str, Any]:
    return {name: np.array(values) for name, values in poses.items()}


def _merge_comparisons(frames: EpisodeComparison, once: EpisodeComparison) -> EpisodeComparison:
    """Merge frames with `once`, the comparison of whole-episode values, which precedes a wrong frame count."""
    first = frames.first_difference or once.first_difference
    if frames.first_difference and frames.first_difference.frame is None:
        first = once.first_difference or frames.first_difference
    return EpisodeComparison(frames.largest | once.largest, first)


def _compare_images(episode: StoredEpisode, images: Mapping[str, bytes], limit: float) -> EpisodeComparison:
    """Compare recorded with rendered JPEGs: camera -> largest mean difference, 0 to 255."""
    result = EpisodeComparison()
    record = episode.record
    for k in range(record.frames):
        for camera in record.cameras:
            name = image_path(camera, k)
            stored, made = episode.read(name), images.get(name, b"")
            apart = 0.0 if stored == made else _mean_pixel_difference(stored, made)
            result.largest[camera] = max(result.largest.get(camera, 0.0), 255.0 if apart is None else apart)
            if stored != made and (apart is None or apart > limit or limit == 0.0) and result.first_difference is None:
                shown = [f"{len(data)} bytes" for data in (stored, made)]
                result.first_difference = ValueDifference(k, k * record.frame_period_s, name, shown[0], shown[1], apart)
    if limit == 0.0 and result.first_difference is None:
        result.first_difference = _first_truth_difference(episode, images)
    return result


def _first_truth_difference(episode: StoredEpisode, images: Mapping[str, bytes]) -> ValueDifference | None:
    for name in (name for name in episode.record.files if name.startswith(TRUTH_FOLDERS)):
        stored, made = episode.read(name), images.get(name, b"")
        if stored != made:
            return ValueDifference(None, None, name, f"{len(stored)} bytes", f"{len(made)} bytes", None)
    return None


def _mean_pixel_difference(stored: bytes, made: bytes) -> float | None:
    """Return the mean pixel difference of two JPEGs, 0 to 255; None if one is damaged or the sizes differ."""
    one, other = decode_jpeg(stored), decode_jpeg(made)
    if one is None or other is None or one.shape != other.shape:
        return None
    return float(np.abs(one.astype(float) - other).mean())


def verify(
    episodes: Sequence[tuple[int, Path]], session: Session, tolerances: Tolerances, workers: int, progress: Progress
) -> dict[str, Any]:
    """Verify episodes of one dataset, and return a report as JSON data. The session's meshes affect only images."""
    began = time.monotonic()
    factory = functools.partial(EpisodeVerifier, session, tolerances)
    verdicts: list[EpisodeVerdict] = []
    try:
        with ProcessPool[tuple[int, Path], EpisodeVerdict](factory, min(workers, len(episodes))) as pool:
            for _, verdict in run_all(pool, episodes):
                verdicts.append(verdict)
                progress(len(verdicts), len(episodes))
    except KeyboardInterrupt:
        raise InterruptedJobError(
            f"interrupted after {len(verdicts)} of {len(episodes)} episodes, "
            f"{sum(verdict.is_reproduced for verdict in verdicts)} of which agree"
        ) from None
    verdicts.sort(key=lambda verdict: verdict.episode)
    return _verification_report(verdicts, tolerances) | {"seconds": round(time.monotonic() - began, 3)}


def _verification_report(verdicts: Sequence[EpisodeVerdict], tolerances: Tolerances) -> dict[str, Any]:
    divergences = [
        {"episode": verdict.episode, "check": check, **asdict(comparison.first_difference)}
        for verdict in verdicts
        for check in CHECK_NAMES
        if (comparison := verdict.checks.get(check)) and comparison.first_difference
    ]
    checks = {check: _check_report(verdicts, check) for check in CHECK_NAMES}
    remade = [found["max_error"] for check in (SEED, ACTIONS) if (found := checks[check])]
    return {
        "episodes": len(verdicts),
        "agree": sum(verdict.is_reproduced for verdict in verdicts),
        # Images are excluded: their differences have another unit.
        "max_error": max(remade, default=0.0),
        "first_divergence": divergences[0] if divergences else None,
        "divergences": divergences,
        "problems": [
            {"episode": verdict.episode, "file": file, "problem": problem}
            for verdict in verdicts
            for file, problem in verdict.problems.items()
        ],
        "checks": checks,
        "versions_changed": _changed_versions_report(verdicts),
        "tolerance": tolerances.values,
        "image_tolerance": tolerances.images,
    }


def _check_report(verdicts: Sequence[EpisodeVerdict], check: str) -> dict[str, Any] | None:
    found = [verdict.checks[check] for verdict in verdicts if check in verdict.checks]
    reasons = sorted({verdict.skipped[check] for verdict in verdicts if check in verdict.skipped})
    if not found and not reasons:
        return None
    largest: dict[str, float] = {}
    for comparison in found:
        for quantity, apart in comparison.largest.items():
            largest[quantity] = max(largest.get(quantity, 0.0), apart)
    return {
        "episodes": len(found),
        "agree": sum(comparison.first_difference is None for comparison in found),
        "max_error": max(largest.values(), default=0.0),
        "largest": largest,
        "skipped": reasons,
    }


def _changed_versions_report(verdicts: Sequence[EpisodeVerdict]) -> list[dict[str, Any]]:
    concerned: dict[tuple[str, str, str], list[int]] = {}
    for verdict in verdicts:
        for name, (then, now) in verdict.changed_versions.items():
            concerned.setdefault((name, then, now), []).append(verdict.episode)
    return [
        {"name": name, "recorded": then, "now": now, "episodes": join_ranges(numbers)}
        for (name, then, now), numbers in sorted(concerned.items())
    ]
