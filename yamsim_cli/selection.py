"""A person's decisions on the episodes of a dataset: `selection.yaml`, and what remains of the dataset.

The file is YAML with a few keys and one line for each episode:

format: yamsim-selection
format_version: 1
dataset: kitchen_monday
undecided: keep
episodes:
- {"episode": 3, "decision": "drop", "sha256": "5d41...", "note": "the cup tips over"}

`sha256` is the hash of the episode's `episode.json`, which holds the hashes of all its files. A decision therefore
belongs to one content of an episode, and `apply_selection` refuses it for any other.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar, get_args

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator

from .core.dataset.dataset_paths import EPISODE_FILE, episode_directories, episode_name
from .core.dataset.reader import RecordedEpisode, StoredEpisode, StoredEpisodes, open_episode, open_recorded_episode
from .core.dataset.records import EpisodeRecord
from .core.errors import ConfigError, DatasetError, UsageError, count_noun
from .core.files.documents.yaml_document import parse_yaml
from .core.files.writing import sha256_file, write_file
from .correction_record import Actor

SELECTION_FILE = "selection.yaml"  # name of the file beside the episodes
SELECTION_FORMAT = "yamsim-selection"  # value of `format`
SELECTION_VERSION = 1  # value of `format_version`

_MAX_FILE_BYTES = 200_000_000  # bytes; 100,000 episodes with the longest notes need less
_MAX_NOTE = 1000  # characters of a note
_MAX_NAME = 60  # characters of a tag and of a reviewer
_LINE_START = "- "  # of the line of an episode

E = TypeVar("E", bound=RecordedEpisode)
M = TypeVar("M", bound=BaseModel)
Decision = Literal["keep", "drop", "undecided"]


def _require_one_line(text: str) -> str:
    if not text.isprintable():
        raise ValueError("it must be one line of printable characters")
    return text


Line = Annotated[str, AfterValidator(_require_one_line)]
Label = Annotated[str, Field(min_length=1, max_length=_MAX_NAME), AfterValidator(_require_one_line)]


class EpisodeDecision(BaseModel):
    """The decision on one episode: one line of a selection.

    Attributes:
        episode: number of the episode.
        sha256: hash of the episode's `episode.json` when a person decided.
        first_frame, last_frame: recorded frames at which the kept part begins and ends; None if not trimmed there.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    episode: Annotated[int, Field(ge=0)]
    decision: Decision
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    first_frame: Annotated[int, Field(ge=0)] | None = None
    last_frame: Annotated[int, Field(ge=0)] | None = None
    tags: tuple[Label, ...] = ()
    note: Annotated[Line, Field(max_length=_MAX_NOTE)] = ""
    reviewer: Annotated[Line, Field(max_length=4 * _MAX_NAME)] = ""

    @model_validator(mode="after")
    def _require_order(self) -> Self:
        if self.first_frame is not None and self.last_frame is not None and self.first_frame > self.last_frame:
            raise ValueError(f"first_frame {self.first_frame} must not be above last_frame {self.last_frame}")
        return self

    @property
    def is_trimmed(self) -> bool:
        """Whether frames are cut off."""
        return self.first_frame is not None or self.last_frame is not None

    @property
    def is_empty(self) -> bool:
        """Whether the line contains no decision, tag, note or trim."""
        return self.decision == "undecided" and not (self.is_trimmed or self.tags or self.note)

    def to_line(self) -> str:
        """Return the decision as one line of JSON, which is YAML too."""
        return json.dumps(self.model_dump(mode="json", exclude_defaults=True), ensure_ascii=False)


class _Header(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    format: Literal["yamsim-selection"]
    format_version: Literal[1]
    dataset: Line = ""
    undecided: Literal["keep", "drop"] = "keep"


@dataclass(frozen=True)
class Selection:
    """Decisions on the episodes of one dataset.

    Attributes:
        dataset: name of the dataset's directory, for people.
        undecided: what to do with episodes without a decision.
        decisions: episode number -> decision.
    """

    dataset: str
    undecided: Literal["keep", "drop"]
    decisions: Mapping[int, EpisodeDecision]

    def is_kept(self, number: int) -> bool:
        """Return whether an episode stays in the dataset."""
        decision = self.decision_of(number)
        return (self.undecided if decision == "undecided" else decision) == "keep"

    def decision_of(self, number: int) -> Decision:
        """Return the decision on an episode; `undecided` without a line."""
        found = self.decisions.get(number)
        return found.decision if found else "undecided"


def selection_text(selection: Selection) -> str:
    """Return the content of a selection file. Equal selections give equal text."""
    header = {"format": SELECTION_FORMAT, "format_version": SELECTION_VERSION, "dataset": selection.dataset}
    lines = [f"{key}: {json.dumps(value, ensure_ascii=False)}" for key, value in header.items()]
    lines.append(f"undecided: {selection.undecided}")
    lines.append("episodes:" if selection.decisions else "episodes: []")
    lines += [_LINE_START + selection.decisions[number].to_line() for number in sorted(selection.decisions)]
    return "\n".join(lines) + "\n"


def write_selection(path: Path, selection: Selection) -> None:
    """Replace or create a selection file completely, or leave it unchanged. Raises OSError."""
    write_file(path, selection_text(selection).encode())


def read_selection(path: Path) -> Selection:
    """Read a selection file. Raise ConfigError, with the line, if it is unreadable, truncated or invalid."""
    lines = _read_lines(path)
    start = next((k for k, line in enumerate(lines) if line.rstrip() in ("episodes:", "episodes: []")), None)
    if start is None:
        raise ConfigError(f"{path}: it has no line `episodes:`; give a file that `yamsim review` wrote")
    header = _parse(_Header, parse_yaml("\n".join(lines[:start]) or "{}", str(path)).data, str(path))
    decisions: dict[int, EpisodeDecision] = {}
    for number, line in enumerate(lines[start + 1 :], start=start + 2):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        place = f"{path}:{number}"
        decision = _parse_decision(line.strip(), place)
        if decision.episode in decisions:
            raise ConfigError(f"{place}: episode {decision.episode} has an earlier line too; remove one of them")
        decisions[decision.episode] = decision
    return Selection(header.dataset, header.undecided, decisions)


def _read_lines(path: Path) -> list[str]:
    try:
        if path.stat().st_size > _MAX_FILE_BYTES:
            raise ConfigError(f"{path}: {path.stat().st_size} bytes is too large for a selection")
        data = path.read_bytes()
        text = data.decode()
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot be read: {error.strerror}; give a file that `yamsim review` wrote"
        ) from error
    except UnicodeDecodeError as error:
        raise ConfigError(f"{path}: it is not UTF-8; give a file that `yamsim review` wrote") from error
    if text and not text.endswith("\n"):
        raise ConfigError(f"{path}: its last line is cut off; copy the file again, or end the line")
    return text.split("\n")


def _parse_decision(line: str, place: str) -> EpisodeDecision:
    if not line.startswith(_LINE_START):
        raise ConfigError(f"{place}: a line of an episode must begin with `- {{`")
    text = line.removeprefix(_LINE_START)
    try:
        data = json.loads(text)
    except (ValueError, RecursionError):
        # A person may have written YAML without quotation marks.
        data = parse_yaml(text, place).data
    return _parse(EpisodeDecision, data, place)


def _parse(model: type[M], data: Any, place: str) -> M:
    try:
        return model.model_validate(data)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        given = f" (it is {str(first['input'])[:60]!r})" if where and first["type"] != "missing" else ""
        valid = f"; valid: {', '.join(model.model_fields)}" if first["type"] == "extra_forbidden" else ""
        raise ConfigError(f"{place}: {where + ': ' if where else ''}{first['msg']}{given}{valid}") from error


@dataclass(frozen=True)
class AppliedSelection:
    """A selection that fits the episodes of a dataset.

    Attributes:
        path: the selection file; None if only `who` selects.
        sha256: hash of that file.
        kept: numbers of the episodes that stay.
        decisions: episode number -> decision.
        trims: episode number -> first and last recorded frame that stay, for trimmed kept episodes.
        dropped: number of episodes that a person dropped.
        undecided: number of episodes without a decision that are left out.
        who: the actor whose frames stay, see `select_actor`; None for all.
    """

    path: Path | None
    sha256: str | None
    kept: frozenset[int]
    decisions: Mapping[int, EpisodeDecision]
    trims: Mapping[int, tuple[int, int]]
    dropped: int
    undecided: int
    who: Actor | None = None

    def report(self) -> dict[str, Any]:
        """Return what the selection keeps and leaves out, as JSON data."""
        return ({"who": self.who} if self.who else {}) | {
            "file": str(self.path) if self.path else None,
            "sha256": self.sha256,
            "kept": len(self.kept),
            "dropped": self.dropped,
            "undecided_left_out": self.undecided,
            "trimmed": len(self.trims),
        }

    def summary(self) -> str:
        """Return what the selection leaves out, as one sentence."""
        total = len(self.kept) + self.dropped + self.undecided
        return (
            f"{self.path}: {len(self.kept)} of {count_noun(total, 'episode')} kept, {self.dropped} dropped, "
            f"{self.undecided} undecided and left out, {len(self.trims)} trimmed"
        )

    def trim(self, episode: E) -> E:
        """Return an episode without the frames that a person cut off."""
        found = self.trims.get(episode.record.episode)
        return episode.trimmed(*found) if found else episode

    def open_episode(self, directory: Path) -> StoredEpisode:
        """Open a simulated episode without the frames that a person cut off."""
        return self.trim(open_episode(directory))


def apply_selection(dataset: Path, path: Path) -> AppliedSelection:
    """Read a selection, and compare it with the episodes of a dataset.

    Raises:
        ConfigError: the file is unreadable or invalid.
        DatasetError: a decision is about an episode that is missing or has another content, a trim lies outside its
            episode, or no episode remains.
    """
    selection = read_selection(path)
    if not dataset.is_dir():
        raise DatasetError(f"{dataset} is not a directory; give the directory that `yamsim record` wrote")
    directories = dict(episode_directories(dataset))
    require_current(selection, dataset, directories, path)
    kept = frozenset(number for number in directories if selection.is_kept(number))
    if not kept:
        raise DatasetError(f"{path}: it keeps no episode of {dataset}; decide `keep` for some of them")
    dropped = sum(selection.decision_of(number) == "drop" for number in directories)
    trims = {
        number: _frame_range(selection.decisions[number], directories[number], path)
        for number in sorted(kept & selection.decisions.keys())
        if selection.decisions[number].is_trimmed
    }
    undecided = len(directories) - len(kept) - dropped
    return AppliedSelection(path, sha256_file(path), kept, selection.decisions, trims, dropped, undecided)


def select_actor(dataset: Path, who: Actor, selection: AppliedSelection | None = None) -> AppliedSelection:
    """Return a selection of only the frames in which the expert or the policy acts.

    In an episode of `yamsim correct`, the policy acts before the takeover, and the expert from there on. In all other
    episodes, every frame is a demonstration and counts as the expert's. Episodes of which no frame is left are left
    out.

    Args:
        selection: decisions of a person, which apply too.

    Raises:
        DatasetError: the dataset has recordings of real arms, or no frame is left.
        UsageError: `who` is no actor.
    """
    if who not in get_args(Actor):
        raise UsageError(f"who={who!r} is not valid: give {' or '.join(get_args(Actor))}")
    kept, trims = set[int](), dict[int, tuple[int, int]]()
    for number, directory in episode_directories(dataset) if dataset.is_dir() else ():
        if selection and number not in selection.kept:
            continue
        record = open_recorded_episode(directory).record
        if not isinstance(record, EpisodeRecord):
            raise DatasetError(f"{dataset} holds recordings of real arms, which do not say who acted; leave `who` out")
        taken = record.correction.frame if record.correction else 0
        first, last = (taken, record.frames - 1) if who == "expert" else (0, taken - 1)
        cut = selection.trims.get(number) if selection else None
        if cut:
            first, last = max(first, cut[0]), min(last, cut[1])
        if first <= last:
            kept.add(number)
            trims[number] = first, last
    if not kept:
        raise DatasetError(f"{dataset} has no frame in which the {who} acts; give another dataset, or leave `who` out")
    chosen = selection or AppliedSelection(None, None, frozenset(), {}, {}, 0, 0)
    return replace(chosen, kept=frozenset(kept), trims=trims, who=who)


def require_current(selection: Selection, dataset: Path, directories: Mapping[int, Path], path: Path) -> None:
    """Raise DatasetError if a decision is about an episode that is missing, or whose content has changed since."""
    for number, decision in sorted(selection.decisions.items()):
        directory = directories.get(number)
        if directory is None:
            raise DatasetError(
                f"{path}: {episode_name(number)} is not in {dataset}; remove its line, or give the dataset that was "
                f"reviewed ({selection.dataset or 'unnamed'})"
            )
        if (found := episode_hash(directory)) != decision.sha256:
            raise DatasetError(
                f"{path}: the decision on {episode_name(number)} is stale: {directory / EPISODE_FILE} has sha256 "
                f"{found[:12]}..., not {decision.sha256[:12]}...; review the episode again, or give the dataset that "
                f"was reviewed ({selection.dataset or 'unnamed'})"
            )


def episode_hash(directory: Path) -> str:
    """Return the hash that a decision stores: the SHA-256 of `episode.json`. Raise DatasetError if it is unreadable."""
    try:
        return sha256_file(directory / EPISODE_FILE)
    except OSError as error:
        raise DatasetError(f"{directory / EPISODE_FILE} cannot be read: {error.strerror or error}") from error


def _frame_range(decision: EpisodeDecision, directory: Path, path: Path) -> tuple[int, int]:
    frames = open_recorded_episode(directory).record.frames
    first = decision.first_frame or 0
    last = frames - 1 if decision.last_frame is None else decision.last_frame
    if not first <= last < frames:
        raise DatasetError(
            f"{path}: {directory.name} has frames 0 to {frames - 1}, and is trimmed to {first} to {last}; review it "
            "again"
        )
    return first, last


def open_selected(episodes: StoredEpisodes, selection: AppliedSelection) -> StoredEpisodes:
    """Return the episodes of a simulated dataset that a selection keeps, without the frames that it cuts off."""
    directories = [path for number, path in episode_directories(episodes.path) if number in selection.kept]
    return StoredEpisodes(episodes.path, directories, selection.open_episode)


@dataclass(frozen=True)
class MergeConflict:
    """Two reviewers who disagree on an episode; each text describes one's decision."""

    episode: int
    first: str
    second: str


def merge_selections(first: Selection, second: Selection) -> tuple[Selection, list[MergeConflict]]:
    """Merge the decisions of two reviewers of the same dataset.

    An undecided episode takes the other reviewer's decision. Tags, notes and reviewers are joined. Where both decided,
    and their decisions or trims differ, the merged episode is undecided, and the disagreement is listed.

    Raises:
        DatasetError: the reviewers saw different contents of an episode.
        ConfigError: the reviewers treat undecided episodes differently.
    """
    if first.undecided != second.undecided:
        raise ConfigError(
            f"undecided: {first.undecided} in one selection, {second.undecided} in the other; make them equal"
        )
    merged: dict[int, EpisodeDecision] = {}
    conflicts: list[MergeConflict] = []
    for number in sorted(first.decisions.keys() | second.decisions.keys()):
        one, other = first.decisions.get(number), second.decisions.get(number)
        if one is None or other is None:
            merged[number] = one or other  # type: ignore[assignment]  # one of them exists
            continue
        if one.sha256 != other.sha256:
            raise DatasetError(
                f"{episode_name(number)}: the reviewers saw different contents (sha256 {one.sha256[:12]}... and "
                f"{other.sha256[:12]}...); review it again"
            )
        merged[number], conflict = _merge_decisions(one, other)
        conflicts += [conflict] if conflict else []
    return Selection(first.dataset or second.dataset, first.undecided, merged), conflicts


def _merge_decisions(one: EpisodeDecision, other: EpisodeDecision) -> tuple[EpisodeDecision, MergeConflict | None]:
    joined = {
        "tags": tuple(dict.fromkeys([*one.tags, *other.tags])),
        "note": "; ".join(dict.fromkeys(filter(None, (one.note, other.note))))[:_MAX_NOTE],
        "reviewer": ", ".join(dict.fromkeys(filter(None, (one.reviewer, other.reviewer))))[: 4 * _MAX_NAME],
    }
    decided = [decision for decision in (one, other) if decision.decision != "undecided"]
    if len({_choice(decision) for decision in decided}) == 2:
        cleared = {"decision": "undecided", "first_frame": None, "last_frame": None}
        conflict = MergeConflict(
            one.episode, *(f"{_choice(d)}{f' ({d.reviewer})' * bool(d.reviewer)}" for d in decided)
        )
        return one.model_copy(update=joined | cleared), conflict
    return (decided or [one])[0].model_copy(update=joined), None


def _choice(decision: EpisodeDecision) -> str:
    if not decision.is_trimmed or decision.decision == "drop":
        return decision.decision
    last = "last" if decision.last_frame is None else decision.last_frame
    return f"{decision.decision} frames {decision.first_frame or 0} to {last}"
