"""Export of real recordings to raiden's layout: the recorded frames that are nearest to even times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..dataset.reader import RecordedImages
from ..errors import DatasetError, UsageError
from ..images.png import encode_png
from ..progress import Progress
from ..resources import Locations
from . import raiden_schema as schema
from .raiden_files import metadata, write_episode, write_json, write_split
from .raiden_frames import FrameConverter
from .raiden_options import RaidenOptions
from .real_source import ActionSource, RealEpisode, RealSource, actions_of
from .source import Exported
from .target import export_directory

# What the layout says of how the arm was driven. What was imported does not tell.
_CONTROL = "unknown"


def export_real_raiden(
    source: RealSource,
    out: Path,
    locations: Locations,
    progress: Progress,
    options: RaidenOptions,
    actions: ActionSource = "recorded",
    *,
    overwrite: bool = False,
) -> Exported:
    """Write real recordings in the layout of the real stack. Each frame is a recorded one, and nothing is drawn.

    Hands' poses are those of the joints, by the kinematics that `options` names. A camera's matrices are there where
    they are known, a lone arm's arrays have that arm alone, and there is no calibration.

    Args:
        source: at the rate of `options`.

    Raises:
        DatasetError: a file is missing, altered or damaged; there are no pictures, by which the layout keeps times; or
            nobody recorded the commands that are asked for.
        UsageError: the layout has no place for such an arm, or none for frames without actions.
        PartialJobError, InterruptedJobError: see `export_directory`.
    """
    if actions == "none":
        raise UsageError("--actions none: each frame of raiden's layout has one; take measured, or export as lerobot")
    if not source.cameras:
        raise DatasetError(
            f"{source.path} has no pictures, and raiden's layout keeps its times beside them: export it as lerobot"
        )
    names = {camera: camera for camera in source.cameras}
    single = len(source.rig.recorded) == 1
    converter = FrameConverter(source.rig, names, locations, options.hand_frame, single=options.single or single)
    frames: dict[str, int] = {}
    notes: list[str] = []
    with export_directory(out, overwrite=overwrite) as stage:
        for number, episode in enumerate(source.episodes()):
            name = schema.episode_name(number)
            recorded = episode.frames()
            data = _converted(source, converter, episode, recorded, actions)
            folder = stage.path / name
            _copy(episode, folder, options)
            described = metadata(
                episode,
                names,
                data,
                options,
                framerate=1 / source.period,
                control=_CONTROL,
                pictures=_pictures(source, episode),
            )
            write_episode(folder, _times(source, recorded), data, described)
            if number == 0:
                write_json(stage.path / schema.SHARED_METADATA, described)
            if (note := source.unevenness(episode, recorded)) is not None:
                notes.append(note)
            frames[name] = len(data)
            progress(number + 1, len(source))
        write_split(stage.path, frames)
    return Exported(out, len(frames), sum(frames.values()), stage.moved_aside, tuple(notes))


def _converted(
    source: RealSource,
    converter: FrameConverter,
    episode: RealEpisode,
    recorded: Sequence[Mapping[str, Any]],
    actions: ActionSource,
) -> list[dict[str, Any]]:
    """An episode's frames in the form of `raiden_schema.lowdim`, as far as they were recorded."""
    _require_grippers(source)
    joints = source.shares([frame["joints"] for frame in recorded])
    told = actions_of(source, episode, recorded, actions)
    prompt = recorded[0].get("language_prompt", "")
    words = {"intrinsics": {}, "extrinsics": {}, "language_task": prompt, "language_prompt": prompt}
    return [
        converter.converted(words | dict(frame), list(measured), list(command))
        for frame, measured, command in zip(recorded, joints, told, strict=True)
    ]


def _require_grippers(source: RealSource) -> None:
    if source.first.record.drives != source.rig.drives:
        raise DatasetError(
            f"{source.path} has no grippers, since nobody recorded them, and raiden's layout has one of each arm: "
            "export it as lerobot"
        )


def _times(source: RealSource, recorded: Sequence[Mapping[str, Any]]) -> list[float]:
    if source.even:
        return [k * source.period for k in range(len(recorded))]
    return [frame["timestamp"] for frame in recorded]


def _pictures(source: RealSource, episode: RealEpisode) -> dict[str, Any]:
    """What the metadata says of where pictures, and all else of a frame, are from."""
    if not source.even:
        return {"source": "recorded"}
    period = source.first.record.frame_period_s
    return {"source": "nearest", "recorded_frames": list(episode.chosen), "recorded_period_s": period}


def _copy(episode: RealEpisode, folder: Path, options: RaidenOptions) -> None:
    """Copy the pictures: JPEGs byte for byte, or PNGs of the pixels that are read from them."""
    images = RecordedImages(episode)
    for camera in images.cameras:
        place = folder / "rgb" / camera
        place.mkdir(parents=True)
        before, data = -1, b""
        for k, recorded in enumerate(episode.chosen):
            if recorded != before:
                jpeg = options.images == "jpg"
                data = episode.image(camera, k) if jpeg else encode_png(images.read(camera, k))
                before = recorded
            (place / schema.frame_name(k, options.images)).write_bytes(data)
