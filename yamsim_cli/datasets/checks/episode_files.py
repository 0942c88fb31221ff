"""List, check and read the files of an episode, which may be huge or irregular."""

from __future__ import annotations

import itertools
import os
import re
import stat
from dataclasses import dataclass, field
from pathlib import Path

from yamsim_cli.core.dataset.checks.problem import ProblemCollector
from yamsim_cli.core.dataset.dataset_paths import EPISODE_FILE, depth_path, image_path, lowdim_path, segmentation_path
from yamsim_cli.core.dataset.records import EpisodeRecord

_MAX_DEPTH = 4  # folder levels: a link may form a loop
# File extension -> largest file that is read, bytes.
_MAX_BYTES = {".pkl": 2**20, ".jpg": 2**26, ".jpeg": 2**26, ".json": 2**26, ".png": 2**26, ".npz": 2**27}
_MAX_OTHER_BYTES = 2**28  # bytes, largest read file with another extension

_IMAGE_NAME = re.compile(r"rgb/([^/]+)/([0-9]{1,12})\.jpe?g")
_LOWDIM_NAME = re.compile(r"lowdim/([0-9]{1,12})\.pkl")
_TRUTH_NAME = re.compile(r"(depth|segmentation)/([^/]+)/([0-9]{1,12})\.(?:npz|png)")
_TRUTH_NAME_FUNCTIONS = {"depth": depth_path, "segmentation": segmentation_path}


@dataclass
class EpisodeFiles:
    """Files of an episode by kind, with paths relative to the episode.

    Attributes:
        sizes: path of every regular file -> bytes.
        truth: "depth" or "segmentation" -> camera -> frame number -> path; only in yamsim's recordings.
    """

    sizes: dict[str, int] = field(default_factory=dict)
    lowdim: dict[int, str] = field(default_factory=dict)
    images: dict[str, dict[int, str]] = field(default_factory=dict)
    truth: dict[str, dict[str, dict[int, str]]] = field(
        default_factory=lambda: {kind: {} for kind in _TRUTH_NAME_FUNCTIONS}
    )
    others: list[str] = field(default_factory=list)


def list_files(directory: Path, recorded: bool, problems: ProblemCollector) -> EpisodeFiles:
    """Return all files below an episode directory, and report entries that are neither files nor folders.

    `recorded` states that yamsim recorded the episode, so that frame numbers have at least six digits.
    """
    files = EpisodeFiles()
    for name in _list_folder(directory, directory, 0, files, problems):
        image, lowdim, truth = _IMAGE_NAME.fullmatch(name), _LOWDIM_NAME.fullmatch(name), _TRUTH_NAME.fullmatch(name)
        if lowdim and (not recorded or name == lowdim_path(int(lowdim[1]))):
            stream, number = files.lowdim, int(lowdim[1])
        elif image and (not recorded or name == image_path(image[1], int(image[2]))):
            stream, number = files.images.setdefault(image[1], {}), int(image[2])
        elif truth and recorded and name == _TRUTH_NAME_FUNCTIONS[truth[1]](truth[2], int(truth[3])):
            stream, number = files.truth[truth[1]].setdefault(truth[2], {}), int(truth[3])
        else:
            stream, number = {}, 0
            if name != EPISODE_FILE:
                files.others.append(name)
        if number in stream:
            problems.add("file.unexpected", name, f"frame {number} is also {stream[number]}")
        else:
            stream[number] = name
    return files


def _list_folder(top: Path, folder: Path, depth: int, files: EpisodeFiles, problems: ProblemCollector) -> list[str]:
    found: list[str] = []
    try:
        entries = sorted(os.scandir(folder), key=lambda entry: entry.name)
    except OSError as error:
        problems.add("file.unreadable", folder.relative_to(top).as_posix(), error.strerror)
        return found
    for entry in entries:
        name = Path(entry.path).relative_to(top).as_posix()
        try:
            if entry.is_dir():
                if depth < _MAX_DEPTH:
                    found += _list_folder(top, Path(entry.path), depth + 1, files, problems)
                continue
            status = entry.stat()
        except OSError as error:
            # List the file, so that it does not count as missing too.
            found.append(name)
            problems.add("file.unreadable", name, error.strerror)
            continue
        found.append(name)
        if stat.S_ISREG(status.st_mode):
            files.sizes[name] = status.st_size
        else:
            problems.add("file.unreadable", name, "it is not a regular file")
    return found


def read_file(directory: Path, name: str, files: EpisodeFiles, problems: ProblemCollector) -> bytes | None:
    """Return the content of a file; report one that is unreadable or too large."""
    if name not in files.sizes:
        return None
    limit = _MAX_BYTES.get(Path(name).suffix, _MAX_OTHER_BYTES)
    if files.sizes[name] > limit:
        problems.add("file.unreadable", name, f"{files.sizes[name]} bytes", f"at most {limit}")
        return None
    try:
        return (directory / name).read_bytes()
    except OSError as error:
        problems.add("file.unreadable", name, error.strerror)
        return None


def check_missing_files(files: EpisodeFiles, record: EpisodeRecord | None, problems: ProblemCollector) -> int:
    """Report missing and unexpected files, and return the expected number of frames."""
    if record:
        _drop_unrecorded_truth(files, record)
        for name in files.others:
            if name not in record.files:
                problems.add("file.unexpected", name)
        for name in record.files:
            if name not in files.sizes and not _is_numbered(name, record):
                problems.add("file.missing", name)
        for camera in files.images.keys() - record.cameras.keys():
            problems.add("file.unexpected", f"rgb/{camera}", f"camera {camera}", ", ".join(record.cameras))
            del files.images[camera]
        streams = {"lowdim": files.lowdim} | {f"rgb/{name}": files.images.get(name, {}) for name in record.cameras}
        for kind in _TRUTH_NAME_FUNCTIONS if record.truth else ():
            streams |= {f"{kind}/{name}": files.truth[kind].get(name, {}) for name in record.cameras}
    else:
        streams = {"lowdim": files.lowdim} | {f"rgb/{name}": numbers for name, numbers in files.images.items()}
    counts = {name: max(numbers, default=-1) + 1 for name, numbers in streams.items()}
    if not any(counts.values()):
        problems.add("frames.none")
        return 0
    expected = record.frames if record else counts["lowdim"] or max(counts.values())
    for name, count in counts.items():
        if count != expected:
            source = EPISODE_FILE if record else "lowdim" if counts["lowdim"] else "another camera"
            problems.add("frames.count", name, f"{count} in {name}", f"{expected}, as in {source}")
        # Frame numbers of plain recordings may begin at 1.
        present = sorted(streams[name])
        before = -1 if record or (present and present[0] != 1) else 0
        for low, high in itertools.pairwise([before, *present]):
            if high - low > 1:
                missing = f"{low + 1}" if high - low == 2 else f"{low + 1} to {high - 1}"
                problems.add("frames.gap", _frame_name(name, low + 1), missing, f"0 to {count - 1}")
    return expected


def _is_numbered(name: str, record: EpisodeRecord) -> bool:
    """Whether a file belongs to a sequence of frames, whose gaps are reported separately."""
    return bool(
        _IMAGE_NAME.fullmatch(name) or _LOWDIM_NAME.fullmatch(name) or (record.truth and _TRUTH_NAME.fullmatch(name))
    )


def _drop_unrecorded_truth(files: EpisodeFiles, record: EpisodeRecord) -> None:
    """Move depth and segmentation that the record does not list to `files.others`."""
    for cameras in files.truth.values():
        for camera in [name for name in cameras if not record.truth or name not in record.cameras]:
            files.others += cameras.pop(camera).values()


def _frame_name(stream: str, number: int) -> str:
    kind, _, camera = stream.partition("/")
    if kind == "lowdim":
        return lowdim_path(number)
    return _TRUTH_NAME_FUNCTIONS.get(kind, image_path)(camera, number)
