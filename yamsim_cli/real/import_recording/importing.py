"""Import recordings of real arms into a dataset, with the user's corrections."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from yamsim_cli.core.config.real_recordings import GripperUnit, RealConfig
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.dataset.dataset_paths import (
    CONFIG_FILE,
    EPISODE_FILE,
    STAGING_FOLDER,
    episode_directories,
    episode_name,
    image_path,
    lowdim_path,
)
from yamsim_cli.core.dataset.disk_errors import describe_disk_error
from yamsim_cli.core.dataset.imported_records import ImportedFrom, RealEpisodeRecord, read_imported_config
from yamsim_cli.core.dataset.lowdim import content_hash, dump_frame
from yamsim_cli.core.dataset.records import to_json
from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode, claim_directory
from yamsim_cli.core.episode.attempt_payload import library_versions
from yamsim_cli.core.errors import ConfigError, DatasetError, ResourceError, UsageError
from yamsim_cli.core.files.documents.yaml_document import dump_yaml
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.files.writing import publish_directory, sha256_bytes, write_file
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.images.jpeg import jpeg_header
from yamsim_cli.core.progress import Progress
from yamsim_cli.core.recorded_motion import ArmMotion, RecordedMotion

from ..recordings.motion_faults import MotionFault, MotionProblem, find_faults, find_gaps
from ..recordings.motion_reading import detect_format, format_reader
from ..recordings.recording import Recording, SampleIndices

# Fault that refuses an import -> flag that corrects it. An episode's record lists other faults.
_FLAG_CORRECTING_FAULT = {
    MotionFault.DEGREES: "--degrees",
    MotionFault.SWAPPED_ARMS: "--swap-arms",
    MotionFault.GRIPPER_SHARE: "--gripper share",
    MotionFault.GRIPPER_UPSIDE_DOWN: "--mirror-gripper measured or --mirror-gripper commanded",
}


@dataclass(frozen=True)
class Corrections:
    """Corrections of missing or wrong metadata.

    Attributes:
        degrees: joints are in degrees.
        swap_arms: the two arms' measurements are swapped.
        gripper: unit of openings; None for the format's usual unit.
        mirrored: openings recorded as 0 for open.
    """

    degrees: bool = False
    swap_arms: bool = False
    gripper: GripperUnit | None = None
    mirrored: Literal["measured", "commanded", "both"] | None = None


@dataclass(frozen=True)
class KnownCamera:
    """A camera by a calibration: matrix `K` (3, 3), px, of pictures of `size` (width, height), and pose in the base.

    `T_cam_in_base` (4, 4) is in the left or only arm's base. `distorted`: its lens needs more than `K`.
    """

    K: Array
    size: tuple[int, int]
    T_cam_in_base: Array
    distorted: bool


@dataclass(frozen=True)
class ImportRequest:
    """Parameters of an import.

    Attributes:
        sources: files and folders.
        format: None detects it.
        mapping: config or YAML file of columns; None selects one that fits.
        out: directory of the dataset.
        mode: whether a non-empty directory is an error, is continued, or is replaced.
        cameras: name -> calibration, which replaces the recorded intrinsics and extrinsics.
    """

    sources: Sequence[Path]
    rig: RigConfig
    format: str | None = None
    mapping: str | None = None
    corrections: Corrections = field(default_factory=Corrections)
    out: Path = Path("real")
    mode: ExistingDatasetMode = ExistingDatasetMode.NEW
    cameras: Mapping[str, KnownCamera] = field(default_factory=dict)


@dataclass
class ImportReport:
    """Result of an import.

    Attributes:
        path: of the dataset.
        episodes, frames: written.
        kept_episodes: episodes that existed before.
        moved_aside: path of a moved older dataset.
    """

    path: Path
    episodes: int = 0
    frames: int = 0
    kept_episodes: int = 0
    problems: dict[str, list[str]] = field(default_factory=dict)
    moved_aside: Path | None = None

    def to_json_data(self) -> dict[str, Any]:
        """Return JSON data."""
        return {
            "path": str(self.path),
            "source": "real",
            "episodes": self.episodes,
            "frames": self.frames,
            "kept": self.kept_episodes,
            "problems": self.problems,
            "moved_aside": str(self.moved_aside) if self.moved_aside else None,
        }


def import_recordings(request: ImportRequest, locations: Locations, progress: Progress) -> ImportReport:
    """Write recordings as episodes of a dataset.

    Episode directories are published atomically. A resumed import keeps existing episodes.

    Raises:
        DatasetError: a recording cannot be read, or has a fault that a flag corrects.
        UsageError: the mode does not allow a non-empty directory, or `swap_arms` is set for a single arm.
        ConfigError: the dataset to resume has another rig, format or unit.
        ResourceError: a file cannot be written, or a library is not installed.
    """
    read = [
        (name, recording)
        for path in request.sources
        for name, recording in _corrected_recordings(path, request, locations)
    ]
    config = _dataset_config(request, read)
    try:
        held = claim_directory(request.out, request.mode, locks_reach_others=True)
    except OSError as error:
        raise _unwritable_error(request.out, error) from error
    report = ImportReport(request.out, moved_aside=held.moved_aside)
    try:
        if held.occupied:
            _require_same_config(request.out, config, locations)
        else:
            write_file(request.out / CONFIG_FILE, dump_yaml(config.model_dump(mode="json")).encode())
        existing = dict(episode_directories(request.out))
        for number, (name, recording) in enumerate(read):
            progress(number, len(read))
            if number in existing:
                report.kept_episodes += 1
            else:
                _publish_episode(number, name, recording, request, report)
        progress(len(read), len(read))
    except OSError as error:
        raise _unwritable_error(request.out, error) from error
    finally:
        held.lock.release()
    return report


def _corrected_recordings(path: Path, request: ImportRequest, locations: Locations) -> Iterator[tuple[str, Recording]]:
    name = request.format or detect_format(path)
    for recording in format_reader(name)(path, request.rig, request.mapping, locations):
        made = _apply_corrections(recording, request.corrections, request.rig)
        for problem in find_faults(made.motion_in_metres(request.rig), request.rig):
            if (flag := _FLAG_CORRECTING_FAULT.get(problem.fault)) is not None:
                raise DatasetError(f"{recording.motion.name}: {problem.text} If so, add {flag}")
        yield name, _with_known_cameras(made, request.cameras)


def _with_known_cameras(recording: Recording, cameras: Mapping[str, KnownCamera]) -> Recording:
    """Return a recording with the calibrations of its cameras. Raise UsageError if none of them is calibrated."""
    known = {name: one for name, one in cameras.items() if name in recording.pictures}
    if cameras and not known:
        raise UsageError(
            f"{recording.motion.name}: the calibration has cameras {', '.join(cameras)}, and the recording "
            f"{', '.join(recording.pictures) or 'none'}; calibrate with these recordings"
        )
    count = len(recording.motion.times)
    notes = tuple(
        f"{name}: stored with its camera matrix only; its lens distortion is in the calibration file"
        for name, one in known.items()
        if one.distorted
    )
    return replace(
        recording,
        intrinsics={**recording.intrinsics, **{name: one.K for name, one in known.items()}},
        extrinsics={
            **recording.extrinsics,
            **{name: np.repeat(one.T_cam_in_base[None], count, axis=0) for name, one in known.items()},
        },
        problems=(*recording.problems, *notes),
    )


def _apply_corrections(recording: Recording, corrections: Corrections, rig: RigConfig) -> Recording:
    arms = recording.motion.arms
    if corrections.swap_arms:
        if len(arms) != 2:
            raise UsageError("--swap-arms: the rig has one arm; give a --rig with two, or leave it out")
        arms = tuple(
            replace(arm, joints=other.joints, openings=other.openings, velocities=other.velocities)
            for arm, other in zip(arms, reversed(arms), strict=True)
        )
    if corrections.degrees:
        arms = tuple(
            replace(
                arm,
                joints=np.deg2rad(arm.joints),
                commands=None if arm.commands is None else np.deg2rad(arm.commands),
                velocities=None if arm.velocities is None else np.deg2rad(arm.velocities),
            )
            for arm in arms
        )
    unit = corrections.gripper or recording.gripper
    if corrections.mirrored is not None:
        numbered = zip(arms, rig.recording_order, strict=True)
        arms = tuple(_mirror_openings(arm, _full_opening(rig, k, unit), corrections.mirrored) for arm, k in numbered)
    return replace(recording, motion=replace(recording.motion, arms=arms), gripper=unit)


def _full_opening(rig: RigConfig, arm: int, unit: GripperUnit) -> float:
    fingers = rig.arms[arm].robot.fingers
    return fingers.full_opening if fingers and unit == "metres" else 1.0


def _mirror_openings(arm: ArmMotion, full: float, which: str) -> ArmMotion:
    measured, commanded = arm.openings, arm.commanded_openings
    if measured is not None and which != "commanded":
        measured = full - measured
    if commanded is not None and which != "measured":
        commanded = full - commanded
    return replace(arm, openings=measured, commanded_openings=commanded)


def _dataset_config(request: ImportRequest, read: Sequence[tuple[str, Recording]]) -> RealConfig:
    kinds = {(name, recording.gripper) for name, recording in read}
    if not kinds:
        raise DatasetError("no recording was found to import; give files or folders with recordings")
    if len(kinds) > 1:
        raise DatasetError(
            f"the recordings are of several kinds ({', '.join(sorted({name for name, _ in kinds}))}, grippers in "
            f"{', '.join(sorted({unit for _, unit in kinds}))}): import each kind into a dataset of its own"
        )
    name, unit = kinds.pop()
    return RealConfig(source="real", rig=request.rig, imported=name, gripper=unit)


def _require_same_config(out: Path, config: RealConfig, locations: Locations) -> None:
    existing = read_imported_config(out, locations)
    for key in ("rig", "imported", "gripper"):
        if getattr(existing, key) != getattr(config, key):
            raise ConfigError(f"{out / CONFIG_FILE}: {key} differs from the recordings; choose another --out")


def _publish_episode(
    number: int, name: str, recording: Recording, request: ImportRequest, report: ImportReport
) -> None:
    motion = recording.motion_in_metres(request.rig)
    samples = _frame_samples(motion, recording)
    frames = [_frame_data(motion, recording, int(sample)) for sample in samples]
    problems = [*recording.problems, *(problem.text for problem in _recording_problems(motion, recording, request.rig))]
    files = {lowdim_path(k): dump_frame(frame) for k, frame in enumerate(frames)}
    sizes: dict[str, tuple[int, int]] = {}
    for camera in recording.pictures:
        for k, data in enumerate(_frame_jpegs(recording, camera, samples)):
            header = jpeg_header(data)
            size = None if header is None else (header.width, header.height)
            if size is None or sizes.setdefault(camera, size) != size:
                raise DatasetError(f"{motion.name}: picture {k} of {camera} is not a JPEG of {sizes.get(camera)} px")
            files[image_path(camera, k)] = data
        if (known := request.cameras.get(camera)) and sizes.get(camera, known.size) != known.size:
            raise DatasetError(
                f"{motion.name}: {camera} has pictures of {sizes[camera]} px, and is calibrated for {known.size}; "
                "calibrate with these recordings"
            )
    times = motion.times[samples]
    record = RealEpisodeRecord(
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
        versions=library_versions(),
        content_sha256=content_hash(frames),
        files={name: sha256_bytes(data) for name, data in sorted(files.items())},
    )
    publish_directory(
        request.out / episode_name(number), {**files, EPISODE_FILE: to_json(record)}, request.out / STAGING_FOLDER
    )
    report.episodes += 1
    report.frames += len(frames)
    if problems:
        report.problems[episode_name(number)] = problems


def _recording_problems(motion: RecordedMotion, recording: Recording, rig: RigConfig) -> Iterator[MotionProblem]:
    """Yield a motion's faults and, without gaps, each camera's."""
    yield from find_faults(motion, rig)
    if not any(find_gaps(motion.times)):
        for camera, pictures in recording.pictures.items():
            yield from find_gaps(motion.times[pictures.samples], f"{camera} has no image")


def _frame_samples(motion: RecordedMotion, recording: Recording) -> SampleIndices:
    """Return samples that become frames: of the camera with the most images, or all without cameras."""
    seen = [pictures.samples for pictures in recording.pictures.values()]
    return max(seen, key=len) if seen else np.arange(len(motion.times), dtype=np.int64)


def _frame_jpegs(recording: Recording, camera: str, samples: SampleIndices) -> Iterator[bytes]:
    pictures = recording.pictures[camera]
    images, number, data = pictures.read(), -1, b""
    for wanted in np.clip(np.searchsorted(pictures.samples, samples, side="right") - 1, 0, None):
        while number < wanted:
            number, data = number + 1, next(images, data)
        if not data:
            raise DatasetError(f"{recording.motion.name}: {camera} has fewer images than time stamps")
        yield data


def _frame_data(motion: RecordedMotion, recording: Recording, sample: int) -> dict[str, Any]:
    """Return a dataset's frame, without keys for values that were not recorded."""
    arms = motion.arms
    frame: dict[str, Any] = {"joints": _drive_row([(arm.joints, arm.openings) for arm in arms], sample)}
    frame["timestamp"] = float(motion.times[sample])
    # A row of commands needs those of all measured drives.
    if all(arm.commands is not None and (arm.openings is None or arm.commanded_openings is not None) for arm in arms):
        commands = [(arm.commands, None if arm.openings is None else arm.commanded_openings) for arm in arms]
        frame["ctrl"] = _drive_row(commands, sample)
    if all(arm.velocities is not None for arm in arms):
        frame["joint_velocities"] = _drive_row([(arm.velocities, None) for arm in arms], sample)
    if lenses := {camera: _as_float32(K) for camera, K in recording.intrinsics.items() if camera in recording.pictures}:
        frame["intrinsics"] = lenses
    if poses := {
        camera: _as_float32(T[sample]) for camera, T in recording.extrinsics.items() if camera in recording.pictures
    }:
        frame["extrinsics"] = poses
    if recording.prompt:
        frame["language_prompt"] = recording.prompt
    return frame


def _drive_row(parts: Sequence[tuple[Array | None, Array | None]], sample: int) -> NDArray[np.float32]:
    values = [
        np.append(joints[sample], [] if openings is None else openings[sample])
        for joints, openings in parts
        if joints is not None
    ]
    return _as_float32(np.concatenate(values))


def _as_float32(values: Array) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, dtype=np.float32)


def _unwritable_error(out: Path, error: OSError) -> ResourceError:
    return ResourceError(f"{out} cannot be written: {describe_disk_error(error, out)}; choose another --out")
