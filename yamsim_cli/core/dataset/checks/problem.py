"""Kinds of faults that checks can find in a dataset, and a collector for the faults found."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

_MAX_TEXT = 200  # characters of a value in a message; the rest is cut off


class Severity(StrEnum):
    """An error means that data is wrong or unreadable. A warning means that a person should inspect the data."""

    ERROR = "error"
    WARNING = "warning"


@dataclass(frozen=True)
class ProblemCode:
    """One kind of fault: `title` is a clause that values can follow, `advice` the remedy."""

    severity: Severity
    title: str
    advice: str


_ADVICE_RESUME = "run `yamsim record --resume` with the same config to repair it"
_ADVICE_RECORD_AGAIN = "delete the episode, then run `yamsim record --resume` to record it again"
_ADVICE_COPY_AGAIN = "copy it again from the original, or " + _ADVICE_RECORD_AGAIN
_ADVICE_RESTORE_COPY = "restore it from a copy; without it, yamsim cannot resume the recording"
_ADVICE_EXCLUDE_EPISODE = "leave the episode out of training"
_ADVICE_FIX_RECORDER = "correct the program that recorded it, and record again"

_ERRORS = {
    "config.damaged": ("the config cannot be read", _ADVICE_RESTORE_COPY),
    "manifest.damaged": ("the manifest cannot be read", "delete it; " + _ADVICE_RESUME),
    "manifest.differs": ("the manifest contradicts the episode", "delete the manifest; " + _ADVICE_RESUME),
    "ledger.missing": ("the ledger of attempts is missing", _ADVICE_RESUME),
    "ledger.damaged": ("a line of the ledger cannot be read", _ADVICE_RESUME),
    "ledger.gap": ("attempts are missing from the ledger", _ADVICE_RESUME),
    "ledger.differs": ("the ledger contradicts the episode", "find out which of the two was changed"),
    "episode.missing": ("the episode is missing", _ADVICE_RESUME),
    "episode.number": ("the number in episode.json is not that of the directory", "rename the directory"),
    "episode.duplicate": ("two episodes have the same data", "delete one of the two"),
    "episode.unchecked": ("every process that reads the episode ends", "leave it out; keep it for a bug report"),
    "episode.outcome": ("the stored outcome contradicts the last frame", _ADVICE_EXCLUDE_EPISODE),
    "record.missing": ("episode.json is missing", _ADVICE_RECORD_AGAIN),
    "record.damaged": ("episode.json cannot be read", _ADVICE_RECORD_AGAIN),
    "frames.none": ("the episode has no frames", _ADVICE_RECORD_AGAIN),
    "frames.count": ("the number of frames differs", _ADVICE_RECORD_AGAIN),
    "frames.gap": ("frames are missing between other frames", _ADVICE_COPY_AGAIN),
    "file.missing": ("a recorded file is missing", _ADVICE_COPY_AGAIN),
    "file.unreadable": ("a file cannot be read", _ADVICE_COPY_AGAIN),
    "file.hash": ("the content is not what was recorded", _ADVICE_COPY_AGAIN),
    "image.decode": ("a file is not a valid JPEG", _ADVICE_COPY_AGAIN),
    "image.size": ("an image has an unexpected size", _ADVICE_FIX_RECORDER),
    "image.colour": ("an image has no colours", _ADVICE_FIX_RECORDER),
    "image.black": ("an image is black", _ADVICE_EXCLUDE_EPISODE),
    "image.frozen": ("the image does not change while the arm moves", _ADVICE_EXCLUDE_EPISODE),
    "depth.decode": ("a file is not a valid depth image", _ADVICE_COPY_AGAIN),
    "depth.size": ("the size of a depth image is not that of its camera", _ADVICE_FIX_RECORDER),
    "segmentation.decode": ("a file is not a valid segmentation image", _ADVICE_COPY_AGAIN),
    "segmentation.size": ("the size of a segmentation image is not that of its camera", _ADVICE_FIX_RECORDER),
    "segmentation.label": (
        "a segmentation image has numbers that truth/labels.json does not name",
        _ADVICE_FIX_RECORDER,
    ),
    "truth.missing": ("ground truth that episode.json lists is missing", _ADVICE_RECORD_AGAIN),
    "truth.damaged": ("ground truth cannot be read", _ADVICE_COPY_AGAIN),
    "truth.cloth": ("truth/labels.json and episode.json name different cloths", _ADVICE_FIX_RECORDER),
    "truth.shape": ("arrays of ground truth contradict truth/labels.json", _ADVICE_FIX_RECORDER),
    "lowdim.damaged": ("a file is not a valid frame", _ADVICE_COPY_AGAIN),
    "lowdim.forbidden": ("a pickle contains more than data", "do not trust this file or its source; delete it"),
    "lowdim.missing": ("a key is missing", _ADVICE_FIX_RECORDER),
    "lowdim.shape": ("a value has an unexpected shape", _ADVICE_FIX_RECORDER),
    "lowdim.type": ("a value has an unexpected type", _ADVICE_FIX_RECORDER),
    "lowdim.finite": ("a value is not finite", _ADVICE_EXCLUDE_EPISODE),
    "lowdim.simulation": ("the simulation state of the frame is not valid", _ADVICE_FIX_RECORDER),
    "lowdim.content": ("the values are not what was recorded", _ADVICE_COPY_AGAIN),
    "time.order": ("the time does not increase", _ADVICE_EXCLUDE_EPISODE),
    "joints.limit": (
        "a joint is beyond its limit",
        "check units (rad) and calibration; otherwise " + _ADVICE_EXCLUDE_EPISODE,
    ),
    "joints.jump": ("a joint jumps", _ADVICE_EXCLUDE_EPISODE),
    "pose.rotation": ("the 3 x 3 part of a pose is not a rotation", _ADVICE_FIX_RECORDER),
    "pose.row": ("the last row of a pose is not 0 0 0 1", _ADVICE_FIX_RECORDER),
    "pose.far": ("a position is implausibly far away", "check units: positions are in metres"),
    "camera.intrinsics": ("a matrix is not a camera matrix", _ADVICE_FIX_RECORDER),
    "camera.fit": ("a camera matrix does not fit its images", "scale the matrix with the images"),
}

_WARNINGS = {
    "dataset.empty": ("the dataset has no episodes yet", "record some with `yamsim record`"),
    "dataset.plain": (
        "a plain recording: no config.yaml, no episode.json",
        "nothing to do; hashes, attempts and seeds cannot be checked",
    ),
    "dataset.mixed": ("episodes differ in how they were made", "check whether they belong in one training set"),
    "config.missing": ("config.yaml is missing", _ADVICE_RESTORE_COPY),
    "manifest.missing": ("the manifest is missing", _ADVICE_RESUME),
    "manifest.stale": ("episodes are not in the manifest", _ADVICE_RESUME),
    "ledger.cut": ("the ledger's last line is cut off", _ADVICE_RESUME),
    "ledger.unlogged": ("episodes are not in the ledger", _ADVICE_RESUME),
    "leftover.staging": (
        "a file or directory was not completely written",
        "if nothing is recording, " + _ADVICE_RESUME,
    ),
    "leftover.directory": ("the name of a directory is not that of an episode", "name it ep_NNNNNN, or move it out"),
    "episode.gap": ("episode numbers are missing", "make sure that your code does not assume consecutive numbers"),
    "episode.layout": ("two episodes have the same start", "check that their seeds differ"),
    "episode.failed": ("the episode is labelled a failure", _ADVICE_EXCLUDE_EPISODE),
    "file.unhashed": ("a file has no hash in episode.json", _ADVICE_RECORD_AGAIN),
    "file.unexpected": ("a file does not belong to the episode", "move it out"),
    "image.uniform": ("an image shows almost nothing", "look at it"),
    "lowdim.unexpected": ("a key is not part of the format", "do nothing if your own code added it"),
    "time.spacing": ("frames are unevenly spaced in time", "resample before training on it"),
    "joints.fast": ("a joint moves faster than its motor can", "plan slower motion: the real arm cannot follow"),
    "camera.view": ("a camera sees neither the arm's hand nor an object", "check extrinsics: they are T_cam_in_base"),
}

# `<subject>.<fault>` -> kind of fault. Keys are stable across versions.
PROBLEM_CODES: Mapping[str, ProblemCode] = {
    name: ProblemCode(severity, *texts)
    for severity, codes in ((Severity.ERROR, _ERRORS), (Severity.WARNING, _WARNINGS))
    for name, texts in codes.items()
}


@dataclass(frozen=True)
class DatasetProblem:
    """A fault found by a check.

    Attributes:
        code: key of `PROBLEM_CODES`.
        episode: its directory name; "" for the dataset.
        file: first file with the fault, relative to the episode or the dataset; "" for all files.
        value, valid: the value found; the valid value or range, "" if the title states it.
        count: number of files or frames of this episode with the fault.
    """

    code: str
    episode: str
    file: str
    value: str
    valid: str = ""
    count: int = 1

    @property
    def kind(self) -> ProblemCode:
        """Severity, title and advice."""
        return PROBLEM_CODES[self.code]

    @property
    def text(self) -> str:
        """The fault in one line, without the episode and file."""
        valid = f"; valid: {self.valid}" if self.valid else ""
        more = f" (in {self.count} frames)" if self.count > 1 else ""
        return f"{self.kind.title}: {self.value}{valid}{more}" if self.value else f"{self.kind.title}{more}"

    def to_json_data(self) -> dict[str, Any]:
        """Return the fault as JSON-ready data."""
        return {
            "code": self.code,
            "severity": str(self.kind.severity),
            "episode": self.episode,
            "file": self.file,
            "title": self.kind.title,
            "problem": self.text,
            "value": self.value,
            "valid": self.valid,
            "count": self.count,
            "advice": self.kind.advice,
        }


class ProblemCollector:
    """Collects the faults of one episode or of the dataset. The same fault in many frames is one `DatasetProblem`."""

    def __init__(self, episode: str = "") -> None:
        self._episode = episode
        self._found: dict[Hashable, DatasetProblem] = {}

    def add(self, code: str, file: str = "", value: object = "", valid: object = "", *, about: Hashable = None) -> None:
        """Add a fault. Faults with equal `code` and equal `about` (not None) are counted in one `DatasetProblem`."""
        assert code in PROBLEM_CODES, code
        key = (code, len(self._found)) if about is None else (code, "about", about)
        if earlier := self._found.get(key):
            self._found[key] = replace(earlier, count=earlier.count + 1)
        else:
            self._found[key] = DatasetProblem(
                code, printable_line(self._episode), printable_line(file), printable_line(value), printable_line(valid)
            )

    def all_problems(self) -> list[DatasetProblem]:
        """Return the faults in the order in which they were added."""
        return list(self._found.values())

    def __len__(self) -> int:
        return len(self._found)


def printable_line(value: object) -> str:
    """Return a value as one short line of printable characters, so that dataset content cannot control a terminal."""
    text = str(value)
    if len(text) > _MAX_TEXT:
        text = text[: _MAX_TEXT - 3] + "..."
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text)


def count_errors(problems: list[DatasetProblem]) -> int:
    """Return the number of problems that are errors."""
    return sum(problem.kind.severity is Severity.ERROR for problem in problems)
