"""Brings recordings of real arms into a dataset of our format."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..attempt.payload import versions
from ..config.real import RealConfig
from ..config.rig import RigConfig
from ..dataset.disk_faults import reason
from ..dataset.layout import CONFIG, EPISODE, STAGING, episode_directories, episode_name, image_name, lowdim_name
from ..dataset.lowdim import content_hash, dump_frame
from ..dataset.real import ImportedFrom, RealRecord, real_config
from ..dataset.records import to_json
from ..dataset.writing.opening import OpenMode, claim
from ..documents.document import dump_yaml
from ..errors import ConfigError, DatasetError, ResourceError
from ..files import publish_directory, sha256_bytes, write_file
from ..geometry.se3 import Array
from ..images.jpeg import jpeg_header
from ..motion import Motion
from ..progress import Progress
from ..recordings.faults import Problem, find_faults, find_gaps
from ..recordings.formats import format_of, reader_of
from ..recordings.recording import Recording, Samples
from ..resources import Locations
from .corrections import Corrections, corrected, require_right


@dataclass(frozen=True)
class ImportRequest:
    """What to import, and how.

    Attributes:
        sources: files and folders.
        format: of all of them; None finds out for each.
        mapping: how their columns are called; None finds out.
        corrections: what the user says of them.
        out, mode: the dataset's directory, and what to do if it holds something.
    """

    sources: Sequence[Path]
    rig: RigConfig
    format: str | None = None
    mapping: str | None = None
    corrections: Corrections = field(default_factory=Corrections)
    out: Path = Path("real")
    mode: OpenMode = OpenMode.NEW


@dataclass
class ImportReport:
    """What was imported.

    Attributes:
        episodes, frames: how many were written.
        kept: how many were there already.
        problems: episode's name -> what was found wrong with it.
        moved_aside: where an older dataset went.
    """

    path: Path
    episodes: int = 0
    frames: int = 0
    kept: int = 0
    problems: dict[str, list[str]] = field(default_factory=dict)
    moved_aside: Path | None = None

    def plain(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "path": str(self.path),
            "source": "real",
            "episodes": self.episodes,
            "frames": self.frames,
            "kept": self.kept,
            "problems": self.problems,
            "moved_aside": str(self.moved_aside) if self.moved_aside else None,
        }


def import_recordings(request: ImportRequest, locations: Locations, progress: Progress) -> ImportReport:
    """The report on the recordings, after they became episodes of a dataset, one after the other.

    Every step leaves a whole dataset behind: an episode is there at once, and those that are there stay when resuming.

    Raises:
        DatasetError: a recording cannot be read, or is not what it seems.
        UsageError: the directory is not empty, and the mode does not say what to do.
        ConfigError: resuming a dataset of another rig, format or unit.
        ResourceError: something cannot be written, or a library is not installed.
    """
    read = [(name, recording) for path in request.sources for name, recording in _recordings(path, request, locations)]
    config = _config(request, read)
    try:
        held = claim(request.out, request.mode, locks_reach_others=True)
    except OSError as error:
        raise _unwritable(request.out, error) from error
    report = ImportReport(request.out, moved_aside=held.moved_aside)
    try:
        if held.occupied:
            _require_same(request.out, config, locations)
        else:
            write_file(request.out / CONFIG, dump_yaml(config.model_dump(mode="json")).encode())
        there = dict(episode_directories(request.out))
        for number, (name, recording) in enumerate(read):
            progress(number, len(read))
            if number in there:
                report.kept += 1
                continue
            _publish(number, name, recording, request, report)
        progress(len(read), len(read))
    except OSError as error:
        raise _unwritable(request.out, error) from error
    finally:
        held.lock.release()
    return report


def _recordings(path: Path, request: ImportRequest, locations: Locations) -> Iterator[tuple[str, Recording]]:
    """The format and the recordings of a file or a folder, as the user says that they are, found to be right."""
    name = request.format or format_of(path)
    for recording in reader_of(name)(path, request.rig, request.mapping, locations):
        made = corrected(recording, request.corrections, request.rig)
        require_right(recording.motion.name, find_faults(made.in_metres(request.rig), request.rig))
        yield name, made


def _config(request: ImportRequest, read: Sequence[tuple[str, Recording]]) -> RealConfig:
    kinds = {(name, recording.gripper) for name, recording in read}
    if len(kinds) != 1:
        found = ", ".join(sorted({name for name, _ in kinds}))
        raise DatasetError(
            f"the recordings are of several kinds ({found}, grippers in "
            f"{', '.join(sorted({unit for _, unit in kinds}))}): import each kind into a dataset of its own"
            if kinds
            else "there is no recording to import"
        )
    name, unit = kinds.pop()
    return RealConfig(source="real", rig=request.rig, imported=name, gripper=unit)


def _require_same(out: Path, config: RealConfig, locations: Locations) -> None:
    there = real_config(out, locations)
    for key in ("rig", "imported", "gripper"):
        if getattr(there, key) != getattr(config, key):
            raise ConfigError(
                f"{out / CONFIG}: {key} is another one than that of what is to be imported; choose another --out"
            )


def _publish(number: int, name: str, recording: Recording, request: ImportRequest, report: ImportReport) -> None:
    motion = recording.in_metres(request.rig)
    samples = _frames_of(motion, recording)
    frames = [_frame(motion, recording, int(sample)) for sample in samples]
    problems = [*recording.problems, *(problem.text for problem in _problems(motion, recording, request.rig))]
    files = {lowdim_name(k): dump_frame(frame) for k, frame in enumerate(frames)}
    sizes: dict[str, tuple[int, int]] = {}
    for camera in recording.pictures:
        for k, data in enumerate(_pictures(recording, camera, samples)):
            header = jpeg_header(data)
            if header is None or sizes.setdefault(camera, (header.width, header.height)) != (
                header.width,
                header.height,
            ):
                raise DatasetError(f"{motion.name}: picture {k} of {camera} is no JPEG of {sizes.get(camera)} px")
            files[image_name(camera, k)] = data
    times = motion.times[samples]
    record = RealRecord(
        episode=number,
        imported=ImportedFrom(format=name, name=motion.name),
        rig=request.rig.name,
        frames=len(frames),
        frame_period_s=float(np.median(np.diff(times))) if len(times) > 1 else 1.0,
        cameras=sizes,
        arms=len(motion.arms),
        drives=len(frames[0]["joints"]) // len(motion.arms),
        prompt=recording.prompt,
        problems=tuple(problems),
        versions=versions(),
        content_sha256=content_hash(frames),
        files={name: sha256_bytes(data) for name, data in sorted(files.items())},
    )
    publish_directory(request.out / episode_name(number), {**files, EPISODE: to_json(record)}, request.out / STAGING)
    report.episodes += 1
    report.frames += len(frames)
    if problems:
        report.problems[episode_name(number)] = problems


def _problems(motion: Motion, recording: Recording, rig: RigConfig) -> Iterator[Problem]:
    """What is wrong with the motion, and where a camera saw nothing while it went on."""
    yield from find_faults(motion, rig)
    if any(find_gaps(motion.times)):
        # They are told already.
        return
    for camera, pictures in recording.pictures.items():
        yield from find_gaps(motion.times[pictures.samples], f"{camera} saw nothing")


def _frames_of(motion: Motion, recording: Recording) -> Samples:
    """The samples that become frames: those of the camera that saw most, or all."""
    seen = [pictures.samples for pictures in recording.pictures.values()]
    return max(seen, key=len) if seen else np.arange(len(motion.times), dtype=np.int64)


def _pictures(recording: Recording, camera: str, samples: Samples) -> Iterator[bytes]:
    """A camera's picture for each of some samples: what it saw last."""
    pictures = recording.pictures[camera]
    shown = np.clip(np.searchsorted(pictures.samples, samples, side="right") - 1, 0, None)
    made, at, data = pictures.read(), -1, b""
    for wanted in shown:
        data, at = (
            next(itertools.islice(made, wanted - at - 1, None), data) if wanted > at else data,
            max(at, int(wanted)),
        )
        if not data:
            raise DatasetError(f"{recording.motion.name}: {camera} has fewer pictures than it says")
        yield data


def _frame(motion: Motion, recording: Recording, sample: int) -> dict[str, Any]:
    """What was recorded at a sample; keys that nobody recorded are not there."""
    frame: dict[str, Any] = {"joints": _row([(arm.joints, arm.openings) for arm in motion.arms], sample)}
    frame["timestamp"] = float(motion.times[sample])
    if all(arm.commands is not None for arm in motion.arms):
        told = [(arm.commands, arm.commanded_openings if arm.openings is not None else None) for arm in motion.arms]
        # Of a gripper that nobody told anything, the command is not known; so there is none for the whole row.
        if all(
            opening is not None or arm.openings is None for (_, opening), arm in zip(told, motion.arms, strict=True)
        ):
            frame["ctrl"] = _row(told, sample)
    if all(arm.velocities is not None for arm in motion.arms):
        frame["joint_velocities"] = _row([(arm.velocities, None) for arm in motion.arms], sample)
    if lenses := {camera: _f32(K) for camera, K in recording.intrinsics.items() if camera in recording.pictures}:
        frame["intrinsics"] = lenses
    if places := {
        camera: _f32(T[sample]) for camera, T in recording.extrinsics.items() if camera in recording.pictures
    }:
        frame["extrinsics"] = places
    if recording.prompt:
        frame["language_prompt"] = recording.prompt
    return frame


def _row(parts: Sequence[tuple[Array | None, Array | None]], sample: int) -> NDArray[np.float32]:
    values = [
        np.append(joints[sample], [] if openings is None else openings[sample])
        for joints, openings in parts
        if joints is not None
    ]
    return _f32(np.concatenate(values))


def _f32(values: Array) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, dtype=np.float32)


def _unwritable(out: Path, error: OSError) -> ResourceError:
    return ResourceError(f"{out} cannot be written: {reason(error, out)}; choose another --out")
