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


_RESUME = "`yamsim record --resume` with the same config mends it"
_REMAKE = "delete the episode and let `yamsim record --resume` make it again"
_TRANSFER = "copy it again from where it was recorded, or " + _REMAKE
_LEAVE_OUT = "leave the episode out of training"
_RECORDER = "mend the recorder that wrote it, and record anew"

_ERRORS = {
    "config.damaged": ("the config cannot be read", "restore it from a copy; without it nothing can be resumed"),
    "manifest.damaged": ("the manifest cannot be read", "delete it; " + _RESUME),
    "manifest.differs": ("the manifest says something else than the episode", "delete the manifest; " + _RESUME),
    "ledger.missing": ("the ledger of attempts is missing", _RESUME),
    "ledger.damaged": ("a line of the ledger cannot be read", _RESUME),
    "ledger.gap": ("attempts are missing from the ledger", _RESUME),
    "ledger.differs": ("the ledger says something else than the episode", "find out which of the two was changed"),
    "episode.missing": ("the episode is missing", _RESUME),
    "episode.number": ("the episode bears another number inside", "give the directory its own number back"),
    "episode.duplicate": ("the same data is there twice", "delete one of the two"),
    "episode.unchecked": (
        "it ends every process that looks into it",
        "leave the episode out, and keep it for a bug report",
    ),
    "episode.outcome": ("the stored outcome is not what the last frame shows", _LEAVE_OUT),
    "record.missing": ("episode.json is missing", _REMAKE),
    "record.damaged": ("episode.json cannot be read", _REMAKE),
    "frames.none": ("there is not one frame", _REMAKE),
    "frames.count": ("the number of frames differs", _REMAKE),
    "frames.gap": ("frames are missing between others", _TRANSFER),
    "file.missing": ("a recorded file is missing", _TRANSFER),
    "file.unreadable": ("a file cannot be read", _TRANSFER),
    "file.hash": ("the content is not what was recorded", _TRANSFER),
    "image.decode": ("not a whole JPEG", _TRANSFER),
    "image.size": ("an image has another size", _RECORDER),
    "image.colour": ("an image has no colours", _RECORDER),
    "image.black": ("an image is black", _LEAVE_OUT),
    "image.frozen": ("the picture stands still while the arm moves", _LEAVE_OUT),
    "depth.decode": ("not a whole depth image", _TRANSFER),
    "depth.size": ("a depth image has another size than its camera's", _RECORDER),
    "segmentation.decode": ("not a whole segmentation image", _TRANSFER),
    "segmentation.size": ("a segmentation image has another size than its camera's", _RECORDER),
    "segmentation.label": ("a segmentation image has numbers that truth/labels.json does not name", _RECORDER),
    "truth.missing": ("ground truth is missing that episode.json speaks of", _REMAKE),
    "truth.damaged": ("ground truth cannot be read", _TRANSFER),
    "truth.cloth": ("truth/labels.json and episode.json name other cloths", _RECORDER),
    "truth.shape": ("arrays of ground truth are not as truth/labels.json says", _RECORDER),
    "lowdim.damaged": ("not a whole frame", _TRANSFER),
    "lowdim.forbidden": (
        "a pickle asks for more than data",
        "trust neither this file nor where it came from; delete it",
    ),
    "lowdim.missing": ("a key is missing", _RECORDER),
    "lowdim.shape": ("a value has another shape", _RECORDER),
    "lowdim.type": ("a value has another type", _RECORDER),
    "lowdim.finite": ("a value is not finite", _LEAVE_OUT),
    "lowdim.simulation": ("what physics needs to repeat the frame is not right", _RECORDER),
    "lowdim.content": ("the values are not what was recorded", _TRANSFER),
    "time.order": ("time does not go on", _LEAVE_OUT),
    "joints.limit": ("a joint is beyond its stop", "check units (rad) and calibration; otherwise " + _LEAVE_OUT),
    "joints.jump": ("a joint jumps", _LEAVE_OUT),
    "pose.rotation": ("a pose's 3 x 3 part is no rotation", _RECORDER),
    "pose.row": ("a pose's last row is not 0 0 0 1", _RECORDER),
    "pose.far": ("a position is out of the room", "check units: positions are in metres"),
    "camera.intrinsics": ("a matrix is no camera's", _RECORDER),
    "camera.fit": ("a camera matrix does not fit its images", "scale the matrix with the images"),
}

_WARNINGS = {
    "dataset.empty": ("there is no episode yet", "`yamsim record` makes some"),
    "dataset.plain": (
        "a plain recording: no config.yaml, no episode.json",
        "nothing to do; hashes, attempts and seeds cannot be checked",
    ),
    "dataset.mixed": ("episodes differ in how they were made", "train on one kind, or on all of them knowingly"),
    "config.missing": ("config.yaml is missing", "restore it from a copy; without it nothing can be resumed"),
    "manifest.missing": ("the manifest is missing", _RESUME),
    "manifest.stale": ("episodes are not in the manifest", _RESUME),
    "ledger.cut": ("the ledger's last line is cut off", _RESUME),
    "ledger.unlogged": ("episodes are not in the ledger", _RESUME),
    "leftover.staging": ("something is half-written", "if nothing is recording, " + _RESUME),
    "leftover.directory": ("a directory is no episode by its name", "name it ep_NNNNNN, or move it out"),
    "episode.gap": ("numbers are left out", "make sure that nothing pairs episodes by their place"),
    "episode.layout": ("two episodes start alike", "check that their seeds differ"),
    "episode.failed": ("the episode is labelled a failure", _LEAVE_OUT),
    "file.unhashed": ("a file has no hash in episode.json", _REMAKE),
    "file.unexpected": ("a file does not belong to the episode", "move it out"),
    "image.uniform": ("an image shows next to nothing", "look at it"),
    "lowdim.unexpected": ("a key is not part of the format", "nothing, if your own code put it there"),
    "time.spacing": ("frames are unevenly spaced in time", "resample before training on it"),
    "joints.fast": ("a joint moves faster than its motor can", "plan slower motion: the real arm cannot follow"),
    "camera.view": ("a camera sees neither the arm's hand nor an object", "check extrinsics: they are T_cam_in_base"),
}

# `<subject>.<fault>` -> kind of fault. Keys are stable across versions.
CODES: Mapping[str, ProblemCode] = {
    name: ProblemCode(severity, *texts)
    for severity, codes in ((Severity.ERROR, _ERRORS), (Severity.WARNING, _WARNINGS))
    for name, texts in codes.items()
}


@dataclass(frozen=True)
class DatasetProblem:
    """A fault found by a check.

    Attributes:
        code: key of `CODES`.
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
        return CODES[self.code]

    @property
    def text(self) -> str:
        """The fault in one line, without the episode and file."""
        valid = f"; valid: {self.valid}" if self.valid else ""
        more = f" (in {self.count} frames)" if self.count > 1 else ""
        return f"{self.kind.title}: {self.value}{valid}{more}" if self.value else f"{self.kind.title}{more}"

    @property
    def place(self) -> str:
        """The episode and file with the fault."""
        return "/".join(part for part in (self.episode, self.file) if part) or "dataset"

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
        assert code in CODES, code
        key = (code, len(self._found)) if about is None else (code, "about", about)
        if earlier := self._found.get(key):
            self._found[key] = replace(earlier, count=earlier.count + 1)
        else:
            self._found[key] = DatasetProblem(
                code, printable(self._episode), printable(file), printable(value), printable(valid)
            )

    def has_code_prefix(self, prefix: str) -> bool:
        """Return whether the code of any fault begins with `prefix`."""
        return any(problem.code.startswith(prefix) for problem in self._found.values())

    def list(self) -> list[DatasetProblem]:
        """Return the faults in the order in which they were added."""
        return list(self._found.values())

    def __len__(self) -> int:
        return len(self._found)


def printable(value: object) -> str:
    """Return a value as one short line of printable characters, so that dataset content cannot control a terminal."""
    text = str(value)
    if len(text) > _MAX_TEXT:
        text = text[: _MAX_TEXT - 3] + "..."
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text)


def count_errors(problems: list[DatasetProblem]) -> int:
    """Return the number of problems that are errors."""
    return sum(problem.kind.severity is Severity.ERROR for problem in problems)
