"""The values of each episode of a dataset, for the overview of the review page."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..core.dataset.checks.context import find_episodes
from ..core.dataset.dataset_paths import MANIFEST_FILE
from ..core.dataset.imported_records import RealEpisodeRecord, is_imported_dataset
from ..core.dataset.reader import open_recorded_episode
from ..core.dataset.records import AttemptRecord, EpisodeRecord, Manifest, from_json
from ..core.dataset.writing.ledger import Ledger
from ..core.errors import ConfigError, DatasetError

_MAX_REPORT_BYTES = 500_000_000  # bytes of a report of `yamsim summarize --json`

# Names of columns for people; other names are shown unchanged.
COLUMN_NAMES = {
    "episode": "number",
    "frames": "frames",
    "bytes": "size, bytes",
    "success": "success",
    "distance_mm": "distance, mm",
    "margin": "goal margin",
    "cause": "cause of failure",
    "recoveries": "recoveries",
    "phrase": "phrase",
    "objects": "objects",
    "x_m": "start x, m",
    "y_m": "start y, m",
    "origin": "file",
    "format": "format",
    "seed": "seed",
    "attempt": "attempt",
    "duration_s": "duration, s",
    "jerk": "jerk, rad/s\N{SUPERSCRIPT THREE}",
    "path_rad": "path of all joints, rad",
    "gap_mrad": "gap to simulation, mrad",
    "problems": "problems",
    "look": "review priority",
}


@dataclass(frozen=True)
class EpisodeRow:
    """An episode in the overview. Values that a dataset does not hold are None, "" or empty.

    Attributes:
        frames: number of frames.
        bytes: size of all files; None if the dataset has no manifest.
        distance_mm: distance of the object from the centre of its target at the end.
        margin: smallest margin of the goal's predicates, in the unit of that predicate.
        cause: why the attempt failed.
        recoveries: number of skills that were tried again.
        phrase: instruction of the episode.
        objects: objects and the names of their configs.
        x_m, y_m: position of the first object in `world` at the start, m.
        origin, format: file of an imported recording, and its format.
        seed, attempt: seed of the recording, and number of the attempt, which together give the start.
        problems: codes of the problems that `yamsim summarize` found.
    """

    episode: int
    frames: int
    bytes: int | None = None
    success: bool | None = None
    distance_mm: float | None = None
    margin: float | None = None
    cause: str = ""
    recoveries: int = 0
    phrase: str = ""
    objects: str = ""
    x_m: float | None = None
    y_m: float | None = None
    origin: str = ""
    format: str = ""
    seed: int | None = None
    attempt: int | None = None
    problems: tuple[str, ...] = ()


def read_rows(dataset: Path, more: Mapping[int, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return the rows of all episodes as JSON data, in order, with columns that some episode fills.

    Manifest and ledger answer for recorded datasets, so that 10,000 episodes need two files. Episodes that one of them
    lacks, and all episodes of other datasets, are opened.

    Args:
        more: episode number -> further values, such as those of `read_reports` and `read_motion`.

    Raises:
        DatasetError: `dataset` is no dataset of yamsim, or a record is damaged.
    """
    directories, recorded = find_episodes(dataset)
    if not recorded and not is_imported_dataset(dataset):
        raise DatasetError(
            f"{dataset} is a recording without hashes, so decisions on it could not be kept; import it with "
            "`yamsim import`"
        )
    frames = {entry.episode: (entry.frames, entry.bytes) for entry in _read_manifest(dataset)}
    attempts = _read_attempts(dataset)
    rows = []
    for directory in directories:
        number = directory.number
        assert number is not None, "yamsim names the episodes of its datasets"
        if number in frames and number in attempts:
            row = _row(number, *frames[number], attempts[number])
        else:
            record = open_recorded_episode(directory.path).record
            row = _row_of_record(number, record, frames.get(number, (0, None))[1])
        rows.append({**vars(row), **more.get(number, {})})
    names = dict.fromkeys(key for row in rows for key in row)
    filled = [key for key in names if any(row.get(key) not in (None, "", ()) for row in rows)]
    return [{key: row.get(key) for key in filled} for row in rows]


def _read_manifest(dataset: Path) -> list[Any]:
    try:
        return from_json(Manifest, (dataset / MANIFEST_FILE).read_bytes(), dataset / MANIFEST_FILE).episodes
    except (OSError, DatasetError):
        return []  # the episodes are opened instead


def _read_attempts(dataset: Path) -> dict[int, AttemptRecord]:
    """Return episode number -> attempt, without lines that cannot be read."""
    try:
        attempts = Ledger(dataset).known_attempts.values()
    except OSError:
        return {}
    return {attempt.episode: attempt for attempt in attempts if attempt.episode is not None}


def _row_of_record(number: int, record: EpisodeRecord | RealEpisodeRecord, size: int | None) -> EpisodeRow:
    if isinstance(record, RealEpisodeRecord):
        return EpisodeRow(
            number,
            record.frames,
            size,
            phrase=record.prompt,
            origin=record.imported.name,
            format=record.imported.format,
        )
    return _row(number, record.frames, size, record)


def _row(number: int, frames: int, size: int | None, source: AttemptRecord | EpisodeRecord) -> EpisodeRow:
    outcome, kinds = source.outcome, source.cast.kinds if source.cast else {}
    place = next(iter(source.layout.values()), None)
    return EpisodeRow(
        number,
        frames,
        size,
        success=outcome.success,
        distance_mm=None if outcome.dxy_m is None else round(1000 * outcome.dxy_m, 2),
        margin=min((round(measure.margin, 5) for measure in outcome.measures), default=None),
        cause=outcome.cause or "",
        recoveries=len(outcome.recoveries),
        phrase=source.phrasing,
        objects=", ".join(name if kinds.get(name, name) == name else f"{name} {kinds[name]}" for name in source.layout),
        x_m=None if place is None else round(place[0], 4),
        y_m=None if place is None else round(place[1], 4),
        seed=source.seed,
        attempt=source.attempt,
    )


def read_reports(reports: Sequence[Path]) -> dict[int, dict[str, Any]]:
    """Return episode number -> values from reports of `yamsim summarize --json` and `yamsim gap --json`.

    `problems` has the codes of an episode's problems, and `gap_mrad` its RMS error in simulation, mrad.

    Raises:
        ConfigError: a file is unreadable or no such report.
    """
    found: dict[int, dict[str, Any]] = {}
    for report in reports:
        data = _read_report(report)
        try:
            for number, values in _report_values(data):
                known = found.setdefault(number, {})
                values["problems"] = tuple(dict.fromkeys((*known.get("problems", ()), *values.get("problems", ()))))
                known |= values
        except (KeyError, TypeError, ValueError) as error:
            raise _not_a_report(report) from error
    return found


def _read_report(report: Path) -> Mapping[str, Any]:
    try:
        if report.stat().st_size > _MAX_REPORT_BYTES:
            raise ConfigError(f"--report {report}: {report.stat().st_size} bytes is too large for a report")
        data = json.loads(report.read_bytes())
    except OSError as error:
        raise ConfigError(f"--report {report}: cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise _not_a_report(report) from error
    if not isinstance(data, dict) or not ("problems" in data or "recordings" in data):
        raise _not_a_report(report)
    return data


def _report_values(data: Mapping[str, Any]) -> Iterator[tuple[int, dict[str, Any]]]:
    if "recordings" in data:
        for recording in data["recordings"]:
            if (number := _number_of(Path(str(recording["name"])).name)) is not None:
                rms = recording["rms_rad"]
                yield number, {} if rms is None else {"gap_mrad": round(1000 * float(rms), 3)}
        return
    for problem in data["problems"]:
        if (number := _number_of(str(problem["episode"]))) is not None:
            yield number, {"problems": (str(problem["code"]),)}


def _number_of(name: str) -> int | None:
    return int(name[3:]) if name.startswith("ep_") and name[3:].isdecimal() else None


def _not_a_report(report: Path) -> ConfigError:
    return ConfigError(
        f"--report {report}: it is no report of `yamsim summarize DATASET --json` or `yamsim gap DATASET --json`"
    )
