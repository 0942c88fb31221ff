"""Whether an episode on the disk is what was recorded: every file is opened."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import DatasetError
from ..files import sha256_bytes
from .layout import EPISODE, image_name, lowdim_name
from .lowdim import content_hash, frame_faults, load_frame
from .records import EpisodeRecord, from_json

# Decodes a JPEG to (height, width, channels), or None when it is damaged. Passed in: this floor knows no OpenCV.
Decoder = Callable[[bytes], Any]


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong: the episode's directory name, the file in it ("" for the episode), and what."""

    episode: str
    file: str
    problem: str


def check_episode(
    directory: Path, number: int, decode_image: Decoder
) -> tuple[EpisodeRecord | None, list[Problem], int]:
    """Open every file of an episode.

    Returns:
        Its record, or None when that cannot be read; what is wrong; and its size in bytes.
    """
    problems: list[Problem] = []

    def report(file: str, problem: str) -> None:
        problems.append(Problem(directory.name, file, problem))

    try:
        text = (directory / EPISODE).read_bytes()
        record = from_json(EpisodeRecord, text, EPISODE)
    except OSError as error:
        report(EPISODE, f"cannot be read: {error.strerror}")
        return None, problems, 0
    except DatasetError as error:
        report(EPISODE, str(error).removeprefix(f"{EPISODE}: "))
        return None, problems, len(text)
    if record.episode != number:
        report(EPISODE, f"says episode {record.episode}")

    size = len(text)
    frames: list[dict[str, Any]] = []
    present = {path.relative_to(directory).as_posix() for path in directory.rglob("*") if not path.is_dir()} - {EPISODE}
    expected = _expected(record)
    for name in sorted(present - expected):
        report(name, "does not belong to the episode")
    for name in sorted(expected):
        if name not in present:
            report(name, "missing")
            continue
        try:
            data = (directory / name).read_bytes()
        except OSError as error:
            report(name, f"cannot be read: {error.strerror}")
            continue
        size += len(data)
        fault = _content_fault(name, data, record, frames, decode_image)
        if fault:
            report(name, fault)
        elif name not in record.files:
            report(name, f"has no hash in {EPISODE}")
        elif sha256_bytes(data) != record.files[name]:
            report(name, f"its content is not what was recorded: sha256 differs from {EPISODE}")
    times = [frame["timestamp"] for frame in frames if isinstance(frame.get("timestamp"), float)]
    if any(later <= earlier for earlier, later in itertools.pairwise(times)):
        report("", "timestamps do not increase")
    if not problems and content_hash(frames) != record.content_sha256:
        report("", "the decoded lowdim values are not what was recorded: content_sha256 differs")
    return record, problems, size


def _expected(record: EpisodeRecord) -> set[str]:
    frames = range(record.frames)
    return {lowdim_name(k) for k in frames} | {image_name(camera, k) for camera in record.cameras for k in frames}


def _content_fault(
    name: str, data: bytes, record: EpisodeRecord, frames: list[dict[str, Any]], decode_image: Decoder
) -> str | None:
    """What is wrong with one file's content; a good lowdim frame is appended to `frames`."""
    if name.startswith("lowdim/"):
        try:
            frame = load_frame(data)
        except DatasetError as error:
            return str(error)
        faults = frame_faults(frame, record.objects, record.cameras)
        frames.append(frame)
        return "; ".join(faults) or None
    image = decode_image(data)
    if image is None:
        return f"not a whole JPEG ({len(data)} bytes)"
    width, height = record.cameras[name.split("/")[1]]
    if image.shape[:2] != (height, width):
        return f"is {image.shape[1]}x{image.shape[0]}, not {width}x{height}"
    return None
