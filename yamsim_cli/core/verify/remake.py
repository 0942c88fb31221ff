"""Make a recorded episode again, and compare: from its seed, from its actions, and its images."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..attempt.engine import demonstrate, repeat
from ..attempt.frames import frames as made_frames
from ..attempt.payload import ENGINE, FIRST_ENGINE, FIRST_LOOKS, LOOKS, versions
from ..attempt.pictures import image_files
from ..attempt.sampling import sample
from ..attempt.simulator import Simulator
from ..attempt.simulators import Simulators
from ..closing import Closing
from ..dataset.actions import recorded_actions
from ..dataset.compare import Comparison, Difference, compare_frames, compare_values
from ..dataset.layout import CONFIG, EPISODE, TRUTH_FOLDERS, image_name, lowdim_name
from ..dataset.reader import StoredEpisode, open_episode
from ..dataset.records import EpisodeRecord, OutcomeRecord, recorded_attempt
from ..episode.rules import EXPERT_RULES, REPEATED_RULES
from ..errors import DatasetError
from ..images.jpeg import decode_jpeg
from ..scene.build import shown_meshes
from ..session import Session
from ..shown_meshes import differences, shown
from ..types import EpisodeJob

# The ways to make an episode again, in the order in which their differences are told.
SEED, ACTIONS, IMAGES = "seed", "actions", "images"
CHECKS = (SEED, ACTIONS, IMAGES)

Frames = Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class Limits:
    """How much may differ.

    Attributes:
        values: of a number, see `dataset.compare.Comparison`.
        images: mean difference of an image's pixels, of 255; at 0 the files have to be the same byte for byte. None
            leaves images out.
    """

    values: float
    images: float | None


@dataclass(frozen=True)
class Verdict:
    """What making one episode again gave.

    Attributes:
        episode: its number.
        checks: check -> how far stored and made lie apart.
        skipped: check -> why it could not be made.
        problems: file -> what is wrong with it, whatever its values are; "" for the whole episode.
        changed: name -> version when it was recorded, and now, where these are not the same.
    """

    episode: int
    checks: Mapping[str, Comparison] = field(default_factory=dict)
    skipped: Mapping[str, str] = field(default_factory=dict)
    problems: Mapping[str, str] = field(default_factory=dict)
    changed: Mapping[str, tuple[str, str]] = field(default_factory=dict)

    @property
    def agrees(self) -> bool:
        """Whether nothing is wrong with it."""
        return not self.problems and all(check.first is None for check in self.checks.values())


class EpisodeVerifier(Closing):
    """Makes episodes of one dataset again; a context manager, since it may own a renderer.

    Args:
        session: of the dataset's own config; its meshes matter to images alone.
    """

    def __init__(self, session: Session, limits: Limits) -> None:
        self._simulators = Simulators(session)
        self._said = session.config.meshes
        self._session = session
        self._limits = limits

    def run(self, job: tuple[int, Path]) -> Verdict:
        """Check one episode, given by its number and its directory."""
        number, directory = job
        problems: dict[str, str] = {}
        checks: dict[str, Comparison] = {}
        skipped: dict[str, str] = {}
        changed: dict[str, tuple[str, str]] = {}
        try:
            episode = open_episode(directory)
            if others := self._other_meshes(episode):
                problems[EPISODE] = f"it shows other meshes than {CONFIG} says: {'; '.join(others)}"
            changed = self._changed(episode)
            frames = _read_frames(episode, problems)
            if episode.record.source != "record":
                skipped[SEED] = f"it comes from {episode.record.source!r} and not from a seed"
            elif (engine := _engine(episode.record)) != ENGINE:
                version = episode.record.versions.get("yamsim", "unknown")
                skipped[SEED] = (
                    f"it was made by engine revision {engine} of yamsim {version}; this version's revision {ENGINE} "
                    "makes other episodes of the same seeds; its actions are repeated"
                )
                if self._limits.images is not None:
                    skipped[IMAGES] = skipped[SEED]
            else:
                checks |= self._from_seed(episode, frames, skipped)
            if repeated := repeat_actions(self._simulator(episode.record), episode, frames, self._limits.values):
                checks[ACTIONS] = repeated
            else:
                skipped[ACTIONS] = "its frames hold no sim_qpos, sim_ctrl and sim_magnet"
        except DatasetError as error:
            # Says more than that the file was altered.
            problems = {"": str(error)} | problems
        return Verdict(number, checks, skipped, problems, changed)

    def _from_seed(self, episode: StoredEpisode, frames: Frames, skipped: dict[str, str]) -> dict[str, Comparison]:
        """The whole attempt again, from its two numbers; `skipped` says why its images are not compared."""
        record, simulator = episode.record, self._simulator(episode.record)
        done = demonstrate(simulator, sample(simulator, EpisodeJob(record.seed, record.attempt)))
        made = made_frames(simulator, done.attempt, done.states)
        once = compare_values(
            {"outcome": _judgement(record.outcome), "start": _arrays(record.layout)}
            | {"randomized": asdict(record.randomized)},
            {"outcome": _judgement(OutcomeRecord.of(done.outcome)), "start": _arrays(done.attempt.places)}
            | {"randomized": asdict(done.attempt.variation)},
            self._limits.values,
        )
        checks = {SEED: _together(compare_frames(frames, made, self._limits.values), once)}
        if self._limits.images is None:
            return checks
        if (looks := _looks(record)) != LOOKS:
            skipped[IMAGES] = (
                f"its pictures are of looks revision {looks}, and this version draws revision {LOOKS}: they differ as "
                "intended, which is no damage"
            )
        elif done.states:
            images = image_files(simulator, done.attempt, [state.qpos for state in done.states])
            checks[IMAGES] = _compare_images(episode, images, self._limits.images)
        return checks

    def _simulator(self, record: EpisodeRecord) -> Simulator:
        return self._simulators.of(EpisodeJob(record.seed, record.attempt))

    def _changed(self, episode: StoredEpisode) -> dict[str, tuple[str, str]]:
        first = {"looks": FIRST_LOOKS, "engine": FIRST_ENGINE}
        then, now = first | episode.record.versions, versions()
        simulator = self._simulator(episode.record)
        if self._limits.images is not None:
            then["renderer"], now["renderer"] = episode.record.renderer, simulator.renderer.description
            for name, text in (episode.record.meshes or {}).items():
                then[f"meshes {name}"] = shown(text)
                now[f"meshes {name}"] = shown(self._shown.get(name))
        return {name: (then[name], now[name]) for name in then if name in now and then[name] != now[name]}

    @functools.cached_property
    def _shown(self) -> dict[str, str]:
        """What this machine shows of each mesh set."""
        return shown_meshes(self._session)

    def _other_meshes(self, episode: StoredEpisode) -> list[str]:
        said, own = self._said, episode.record.meshes
        return differences(own, said, ("here", "there")) if said is not None and own is not None else []

    def close(self) -> None:
        """Free the renderers."""
        self._simulators.close()


def repeat_actions(simulator: Simulator, episode: StoredEpisode, frames: Frames, tolerance: float) -> Comparison | None:
    """An episode's actions again in physics, from where it began, and how far that leads from what it holds.

    Args:
        simulator: of the config that the episode was recorded with.
        tolerance: see `dataset.compare`.

    Returns:
        None when the episode holds no actions that physics could repeat.

    Raises:
        DatasetError: the episode is of another scene.
    """
    model = simulator.scene.model
    recorded = recorded_actions(frames, model.nq, model.nu)
    if recorded is None:
        return None
    start, actions = recorded
    stored = episode.record.outcome
    attempt = recorded_attempt(episode.record, start)
    rules = EXPERT_RULES if episode.record.source == "record" else REPEATED_RULES
    done = repeat(simulator, attempt, actions, rules)
    # What an expert tried again, its actions cannot tell.
    judged = OutcomeRecord.of(done.outcome).model_copy(update={"recoveries": stored.recoveries})
    # Earlier engines judged and measured in other ways; where things ended does not depend on that.
    keys = None if _engine(episode.record) == ENGINE else {"dxy_m", "dz_m", "speed_mps"}
    once = compare_values({"outcome": _judgement(stored, keys)}, {"outcome": _judgement(judged, keys)}, tolerance)
    return _together(compare_frames(frames, made_frames(simulator, attempt, done.states), tolerance), once)


def _looks(record: EpisodeRecord) -> str:
    """Revision of looks that a recording's pictures were drawn with."""
    return record.versions.get("looks", FIRST_LOOKS)


def _engine(record: EpisodeRecord) -> str:
    """Return the revision of the engine in which a recording was made."""
    return record.versions.get("engine", FIRST_ENGINE)


def _read_frames(episode: StoredEpisode, problems: dict[str, str]) -> list[dict[str, Any]]:
    """All frames of an episode; what was altered is told, and compared all the same."""
    frames = []
    for k in range(episode.record.frames):
        data = episode.read(name := lowdim_name(k))
        if episode.altered(name, data):
            problems[name] = "its content is not what was recorded: sha256 differs from episode.json"
        frames.append(episode.frame(k, data))
    return frames


def _judgement(outcome: OutcomeRecord, keys: set[str] | None = None) -> dict[str, Any]:
    """Return an outcome's numbers and its verdict, or some of them; the text on them says nothing more."""
    return outcome.model_dump(include=keys, exclude={"detail"})


def _arrays(poses: Mapping[str, Sequence[float]]) -> dict[str, Any]:
    return {name: np.array(values) for name, values in poses.items()}


def _together(frames: Comparison, once: Comparison) -> Comparison:
    """One comparison of both; an attempt that was never simulated tells of itself by its outcome."""
    first = frames.first or once.first
    if frames.first and frames.first.frame is None:
        first = once.first or frames.first
    return Comparison(frames.largest | once.largest, first)


def _compare_images(episode: StoredEpisode, images: Mapping[str, bytes], limit: float) -> Comparison:
    """Recorded JPEGs against new ones: `largest` holds each camera's largest mean difference of pixels, of 255."""
    result = Comparison()
    record = episode.record
    for k in range(record.frames):
        for camera in record.cameras:
            name = image_name(camera, k)
            stored, made = episode.read(name), images.get(name, b"")
            apart = 0.0 if stored == made else _pixels_apart(stored, made)
            result.largest[camera] = max(result.largest.get(camera, 0.0), 255.0 if apart is None else apart)
            if stored != made and (apart is None or apart > limit or limit == 0.0) and result.first is None:
                shown = [f"{len(data)} bytes" for data in (stored, made)]
                result.first = Difference(k, k * record.frame_period_s, name, shown[0], shown[1], apart)
    if limit == 0.0 and result.first is None:
        result.first = _first_other_truth(episode, images)
    return result


def _first_other_truth(episode: StoredEpisode, images: Mapping[str, bytes]) -> Difference | None:
    """The first file of ground truth that is not the same byte for byte; None if all are."""
    for name in (name for name in episode.record.files if name.startswith(TRUTH_FOLDERS)):
        stored, made = episode.read(name), images.get(name, b"")
        if stored != made:
            return Difference(None, None, name, f"{len(stored)} bytes", f"{len(made)} bytes", None)
    return None


def _pixels_apart(stored: bytes, made: bytes) -> float | None:
    """Mean difference of two JPEGs' pixels, of 255; None when one is damaged or has another size."""
    one, other = decode_jpeg(stored), decode_jpeg(made)
    if one is None or other is None or one.shape != other.shape:
        return None
    return float(np.abs(one.astype(float) - other).mean())
