"""Export to the converted layout of raiden, a program that records real arms; see `raiden_schema`."""

from __future__ import annotations

import functools
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..core.config.recording import RecordConfig
from ..core.config.session import Session
from ..core.dataset.lowdim import dump_frame
from ..core.dataset.reader import RecordedEpisode
from ..core.errors import DatasetError, UsageError
from ..core.files.resources import Locations
from ..core.progress import Progress
from . import raiden_schema as schema
from .episode_jobs import run_episode_jobs
from .export_source import ActionSource, Frames, RealEpisode, RealSource, SimulatedSource, depth_cameras
from .output_directory import ExportResult, export_directory
from .raiden_episode import EpisodeConverter, copy_images
from .raiden_frames import FrameConverter, calibration_json, camera_names, hand_frame
from .raiden_schema import RaidenOptions

_CONTROL_BY_SOURCE = {"record": "plan"}  # `source` of an episode -> `control` in metadata.json, where they differ
_REAL_CONTROL = "unknown"  # `control` of real recordings, which do not state how the arm was controlled


def export_raiden(
    source: SimulatedSource,
    out: Path,
    locations: Locations,
    progress: Progress,
    options: RaidenOptions,
    *,
    workers: int = 1,
    overwrite: bool = False,
) -> ExportResult:
    """Write a simulated dataset in raiden's layout.

    The global frame is the base of the left arm. A single arm is the left one. The right arm then rests with all joints
    0, or is omitted with `options.single`. Grippers are shares of the opening, 0 closed to 1 open, as the drive of the
    real arm reports them.
    """
    converter = FrameConverter(
        source.rig, camera_names(source), locations, options.hand_frame, single=options.as_single_arm
    )
    config = _with_recorded_size(source) if options.renders_images else source.config
    factory = functools.partial(
        EpisodeConverter, Session(config, locations), converter.names, options, source.selection
    )
    frames: dict[str, int] = {}
    with export_directory(out, overwrite=overwrite) as stage:
        episodes = {schema.episode_name(k): episode for k, episode in enumerate(source.open_episodes())}
        jobs = [(episode.directory, stage.path / name) for name, episode in episodes.items()]
        processes = min(workers, len(jobs)) if options.renders_images else 0
        for (_, folder), made in run_episode_jobs(factory, jobs, processes):
            episode = episodes[folder.name]
            record = episode.record
            data = [converter.convert_simulated_step(frame) for frame in made.frames]
            metadata = _metadata(
                episode,
                converter.names,
                data,
                options,
                framerate=1 / record.frame_period_s if options.fps is None else options.fps,
                control=_CONTROL_BY_SOURCE.get(record.source, record.source),
                pictures=made.pictures,
                depth=bool(depth_cameras(episode)),
            )
            _write_episode(folder, made.times, data, metadata)
            frames[folder.name] = len(data)
            if folder == jobs[0][1]:
                _write_json(stage.path / schema.SHARED_METADATA_FILE, metadata)
                _write_json(stage.path / schema.CALIBRATION_FILE, calibration_json(source, converter, options, data))
            progress(len(frames), len(source))
        _write_split_file(stage.path, frames)
    return ExportResult(out, len(frames), sum(frames.values()), stage.moved_aside)


def _with_recorded_size(source: SimulatedSource) -> RecordConfig:
    sizes = set(source.camera_sizes.values())
    if len(sizes) > 1:
        raise DatasetError(
            f"{source.path} has pictures of several sizes, which cannot be rendered: use --pictures nearest"
        )
    image = source.config.image.model_copy(update={"size_px": sizes.pop()})
    return source.config.model_copy(update={"image": image})


def export_real_raiden(
    source: RealSource,
    out: Path,
    locations: Locations,
    progress: Progress,
    options: RaidenOptions,
    actions: ActionSource = "recorded",
    *,
    overwrite: bool = False,
) -> ExportResult:
    """Write real recordings in raiden's layout. Each frame is the recorded frame nearest to its time.

    Hand poses follow from the joints by the kinematics in `options`. Only known camera matrices are written. The arrays
    of a single arm hold only that arm. No calibration file is written.

    Args:
        source: opened with the rate of `options`.
        actions: "recorded" for commands, or "measured" for joints one frame later.
    """
    if actions == "none":
        raise UsageError(
            "--actions none: each frame of raiden's layout needs an action; give measured, or export as lerobot"
        )
    if not source.camera_sizes:
        raise DatasetError(
            f"{source.path} has no pictures, which raiden's layout needs for its times: export it as lerobot"
        )
    names = {camera: camera for camera in source.camera_sizes}
    single = options.as_single_arm or len(source.rig.recording_order) == 1
    converter = FrameConverter(source.rig, names, locations, options.hand_frame, single=single)
    frames: dict[str, int] = {}
    notes: list[str] = []
    with export_directory(out, overwrite=overwrite) as stage:
        for number, episode in enumerate(source.open_episodes()):
            folder = stage.path / schema.episode_name(number)
            recorded = episode.frames()
            data = _convert_episode(source, converter, episode, recorded, actions)
            copy_images(
                RecordedEpisode(episode.directory, episode.record), folder, names, episode.frame_numbers, options
            )
            times = [
                k * source.period if source.is_resampled else frame["timestamp"] for k, frame in enumerate(recorded)
            ]
            pictures: dict[str, Any] = {"source": "recorded"}
            if source.is_resampled:
                pictures = schema.nearest_pictures(episode.frame_numbers, source.first.record.frame_period_s)
            metadata = _metadata(
                episode, names, data, options, framerate=1 / source.period, control=_REAL_CONTROL, pictures=pictures
            )
            _write_episode(folder, times, data, metadata)
            if number == 0:
                _write_json(stage.path / schema.SHARED_METADATA_FILE, metadata)
            if (note := source.describe_uneven_times(episode, recorded)) is not None:
                notes.append(note)
            frames[folder.name] = len(data)
            progress(number + 1, len(source))
        _write_split_file(stage.path, frames)
    return ExportResult(out, len(frames), sum(frames.values()), stage.moved_aside, tuple(notes))


def _convert_episode(
    source: RealSource, converter: FrameConverter, episode: RealEpisode, recorded: Frames, actions: ActionSource
) -> list[dict[str, Any]]:
    if source.first.record.drives != source.rig.drive_count:
        raise DatasetError(
            f"{source.path} has no grippers, because they were not recorded, but raiden's layout needs one per arm: "
            "export it as lerobot"
        )
    joints = source.with_gripper_shares([frame["joints"] for frame in recorded])
    commands = source.actions(episode, recorded, actions)
    prompt = recorded[0].get("language_prompt", "")
    common = {"intrinsics": {}, "extrinsics": {}, "language_task": prompt, "language_prompt": prompt}
    return [
        converter.convert_frame(common | dict(frame), list(measured), list(command))
        for frame, measured, command in zip(recorded, joints, commands, strict=True)
    ]


def _metadata(
    episode: RecordedEpisode,
    names: Mapping[str, str],
    data: Frames,
    options: RaidenOptions,
    *,
    framerate: float,
    control: str,
    pictures: Mapping[str, Any],
    depth: bool = False,
) -> dict[str, Any]:
    """Return the content of `metadata.json`. `names` is camera -> its name in raiden's layout."""
    sizes = {names[camera]: [height, width] for camera, (width, height) in episode.record.cameras.items()}
    one_size = len({tuple(size) for size in sizes.values()}) == 1
    task = str(data[0]["language_task"])
    return {
        "info": {
            "name": task,
            "raw_id": f"{episode.dataset_directory.name}/{episode.directory.name}",
            "tags": ["robotics"],
        },
        "labels": [*(["rgb"] if sizes else []), *(["depth"] if depth else []), "action", "language"],
        "cameras": list(sizes),
        "resolution": next(iter(sizes.values())) if one_size else sizes,
        "framerate": int(framerate) if framerate.is_integer() else framerate,
        "language": {"task": task, "prompt": [str(data[0]["language_prompt"])]},
        "num_frames": len(data),
        "rgb": {"extension": options.images},
        **({"depth": {"extension": "npz", "sparse": False, "metric": True}} if depth else {}),
        "intrinsics": {"model": "pinhole"},
        "extrinsics": {"transform": "cam2world", "metric": True},
        "action": {"format": "joint_cmd", "dims": len(data[0]["action_joints"])},
        "control": control,
        "hand_frame": hand_frame(options.hand_frame),
        "pictures": dict(pictures),
    }


def _write_episode(folder: Path, times: Sequence[float], data: Frames, metadata: Mapping[str, Any]) -> None:
    stream = io.BytesIO()
    np.save(stream, np.array([round(time * 1e9) for time in times], dtype=schema.TIMESTAMP_DTYPE))
    for camera in metadata["cameras"]:
        (folder / "rgb" / camera / schema.TIMESTAMPS_FILE).write_bytes(stream.getvalue())
    (folder / "lowdim").mkdir(parents=True)
    for k, frame in enumerate(data):
        (folder / "lowdim" / schema.frame_name(k, "pkl")).write_bytes(dump_frame(frame))
    _write_json(folder / schema.METADATA_FILE, metadata)


def _write_split_file(root: Path, frames: Mapping[str, int]) -> None:
    size = {"n_seqs": len(frames), "n_samples": len(frames), "n_frames": sum(frames.values())}
    _write_json(root / schema.SPLIT_FILE, {"filters": {}, "size": size, "files": dict(sorted(frames.items()))})


def _write_json(path: Path, content: Mapping[str, Any]) -> None:
    path.write_text(json.dumps(content, indent=2, allow_nan=False) + "\n")
