"""Saves recordings during teleoperation, so that recordings of a killed session can be judged later."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from yamsim_cli.core.attempt_data import Attempt, AttemptJob
from yamsim_cli.core.dataset.dataset_paths import RECORDINGS_FOLDER
from yamsim_cli.core.geometry.se3 import Array

_STOP_MARK = "stop"


@dataclass(frozen=True)
class CommandTick:
    """The commands to all arms in one control tick.

    Attributes:
        ctrl: commands to the drives (arms, drives), rad and m.
        reference: joints and openings (arms, drives), rad and m, at which the commands aim.
    """

    ctrl: Array
    magnet: tuple[bool, ...]
    reference: Array


@dataclass(frozen=True)
class UnfinishedRecording:
    """The recording of a killed session.

    Attributes:
        start: MuJoCo `qpos` (nq,) at the beginning.
        stopped: ticks before the user stopped the recording; None if the session was killed before.
    """

    path: Path
    job: AttemptJob
    start: Array
    ticks: tuple[CommandTick, ...]
    stopped: int | None


class RecordingJournal:
    """Writes each recording, tick by tick, to a file in the directory of the dataset.

    The file exists until the attempt is written into the dataset, or discarded. A written tick survives the end of this
    process. A power failure may lose the last second.
    """

    def __init__(self, dataset: Path) -> None:
        self._folder = dataset / RECORDINGS_FOLDER
        self._file: BinaryIO | None = None
        self._attempt = -1

    def open_recording(self, attempt: Attempt) -> None:
        """Open the file of a recording. Raise OSError if it cannot be written."""
        self.close_recording()
        self._folder.mkdir(exist_ok=True)
        assert attempt.start is not None, "a driven attempt has a start"
        self._attempt = attempt.job.attempt
        # Unbuffered, since a crash of this process would lose a buffer.
        self._file = self._recording_file(self._attempt).open("wb", buffering=0)
        self._write_line(
            {
                "seed": attempt.job.seed,
                "attempt": attempt.job.attempt,
                "layout": {name: list(place) for name, place in attempt.object_places.items()},
                "start": attempt.start.tolist(),
            }
        )

    def add_tick(self, tick: CommandTick) -> None:
        """Write a tick, if a recording is open."""
        if self._file is not None:
            ctrl, reference = tick.ctrl.ravel().tolist(), tick.reference.ravel().tolist()
            self._write_line({"ctrl": ctrl, "magnet": list(tick.magnet), "asked": reference})

    def mark_stop(self) -> None:
        """Mark that the user stopped the recording. In the ticks that follow, the scene comes to rest."""
        self._write_line({"event": _STOP_MARK})

    def close_recording(self) -> None:
        """Close the file, which stays on the disk."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def discard_recording(self) -> None:
        """Close the file and remove it."""
        self.close_recording()
        self.delete_recording(self._attempt)

    def delete_recording(self, attempt: int) -> None:
        """Remove the file of an attempt."""
        self._recording_file(attempt).unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            self._folder.rmdir()

    def unfinished_recordings(self) -> list[UnfinishedRecording]:
        """Return the recordings of killed sessions, and remove files without a complete first line."""
        found = []
        for path in sorted(self._folder.glob("*.jsonl")):
            recording = _read_recording(path)
            if recording is None:
                path.unlink()
            else:
                found.append(recording)
        return found

    def _recording_file(self, attempt: int) -> Path:
        return self._folder / f"{attempt:06d}.jsonl"

    def _write_line(self, line: Mapping[str, Any]) -> None:
        assert self._file is not None, "begin comes first"
        self._file.write(json.dumps(line, separators=(",", ":")).encode() + b"\n")


def _read_recording(path: Path) -> UnfinishedRecording | None:
    """Read up to the last complete line; None if the first line is not valid."""
    lines: list[dict[str, Any]] = []
    for line in path.read_bytes().split(b"\n"):
        try:
            lines.append(json.loads(line))
        except ValueError:
            # Only the last line can be incomplete.
            break
    try:
        job, start = AttemptJob(int(lines[0]["seed"]), int(lines[0]["attempt"])), np.array(lines[0]["start"], float)
        ticks = tuple(_parse_tick(line) for line in lines[1:] if "ctrl" in line)
    except (IndexError, KeyError, TypeError, ValueError):
        return None
    stops = [k for k, line in enumerate(lines[1:]) if line.get("event") == _STOP_MARK]
    return UnfinishedRecording(path, job, start, ticks, stops[0] if stops else None)


def _parse_tick(line: Mapping[str, Any]) -> CommandTick:
    magnet = tuple(bool(on) for on in line["magnet"])
    ctrl, reference = (np.array(line[key], float).reshape(len(magnet), -1) for key in ("ctrl", "asked"))
    return CommandTick(ctrl, magnet, reference)
