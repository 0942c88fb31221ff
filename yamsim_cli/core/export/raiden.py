"""Export to the converted layout of the real stack, for programs that read real recordings; see `raiden_schema`."""

from __future__ import annotations

import functools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..config.recording import RecordConfig
from ..dataset.reader import StoredEpisode
from ..errors import DatasetError
from ..progress import Progress
from ..resources import Locations
from ..session import Session
from ..workers.executor import Executor, Factory, InlineExecutor
from ..workers.processes import WorkerPool
from . import raiden_schema as schema
from .raiden_calibration import calibration
from .raiden_episode import EpisodeMaker, MadeEpisode
from .raiden_files import metadata, write_episode, write_json, write_split
from .raiden_frames import FrameConverter, camera_names
from .raiden_options import RaidenOptions
from .source import Exported, Source, depth_cameras
from .target import export_directory

# Source of a recording -> how the arm was driven.
_CONTROL = {"record": "plan"}

# An episode's directory, and the directory that it is exported to.
Job = tuple[Path, Path]


def export_raiden(
    source: Source,
    out: Path,
    locations: Locations,
    progress: Progress,
    options: RaidenOptions,
    *,
    workers: int = 1,
    overwrite: bool = False,
) -> Exported:
    """Write a dataset in the real stack's layout.

    The global frame is the base of the left arm. A lone arm is the left one. The right one then stands still with all
    joints 0, unless it is left out. Grippers are shares of the opening, from 0 for closed to 1 for open, as the real
    arm's drive reports them.

    Args:
        locations: its meshes are those of rendered pictures.
        workers: processes that render; nothing else takes long.

    Raises:
        DatasetError: a file is missing, altered or damaged, or physics no longer leads to the recorded states.
        ResourceError: nothing can render here.
        UsageError, PartialJobError, InterruptedJobError: see `export_directory`. UsageError also if two arms are to be
            written as one.
    """
    converter = FrameConverter(source.rig, camera_names(source), locations, options.hand_frame, single=options.single)
    config = _as_recorded(source) if options.renders else source.config
    factory = functools.partial(EpisodeMaker, Session(config, locations), converter.names, options)
    frames: dict[str, int] = {}
    with export_directory(out, overwrite=overwrite) as stage:
        episodes = {schema.episode_name(k): episode for k, episode in enumerate(source.episodes())}
        jobs = [(episode.directory, stage.path / name) for name, episode in episodes.items()]
        for folder, made in _make(factory, jobs, workers if options.renders else 0):
            data = [converter.frame(frame) for frame in made.frames]
            described = _metadata(episodes[folder.name], converter, made, data, options)
            write_episode(folder, made.times, data, described)
            frames[folder.name] = len(data)
            if folder == jobs[0][1]:
                write_json(stage.path / schema.SHARED_METADATA, described)
                write_json(stage.path / schema.CALIBRATION, calibration(source, converter, options, data))
            progress(len(frames), len(source))
        write_split(stage.path, frames)
    return Exported(out, len(frames), sum(frames.values()), stage.moved_aside)


def _as_recorded(source: Source) -> RecordConfig:
    """The dataset's config, with the size of the recorded pictures."""
    sizes = set(source.cameras.values())
    if len(sizes) > 1:
        raise DatasetError(
            f"{source.path} has pictures of several sizes, which cannot be rendered: take --pictures nearest"
        )
    image = source.config.image.model_copy(update={"size_px": sizes.pop()})
    return source.config.model_copy(update={"image": image})


def _make(factory: Factory[Job, MadeEpisode], jobs: Sequence[Job], workers: int) -> Iterator[tuple[Path, MadeEpisode]]:
    """Each episode's folder and what was made of it, in the order in which they get done.

    Args:
        workers: processes that make them; 0 for this process.
    """
    executor: Executor[Job, MadeEpisode] = InlineExecutor(factory)
    if workers:
        executor = WorkerPool[Job, MadeEpisode](factory, min(workers, len(jobs)))
    waiting = list(reversed(jobs))
    with executor as pool:
        for _ in jobs:
            while pool.idle and waiting:
                pool.submit(waiting.pop())
            (_, folder), made = pool.result()
            yield folder, made


def _metadata(
    episode: StoredEpisode,
    converter: FrameConverter,
    made: MadeEpisode,
    data: Sequence[Mapping[str, Any]],
    options: RaidenOptions,
) -> dict[str, Any]:
    """The content of `metadata.json`."""
    record = episode.record
    return metadata(
        episode,
        converter.names,
        data,
        options,
        framerate=1 / record.frame_period_s if options.fps is None else options.fps,
        control=_CONTROL.get(record.source, record.source),
        pictures=made.pictures,
        depth=bool(depth_cameras(episode)),
    )
