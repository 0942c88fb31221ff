from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..core.attempt_data import AttemptJob
from ..core.closable import Closable
from ..core.config.session import Session
from ..core.dataset.dataset_paths import depth_path
from ..core.dataset.disk_errors import explain_disk_error
from ..core.dataset.ground_truth_files import dump_depth
from ..core.dataset.reader import RecordedEpisode, StoredEpisode, open_episode
from ..core.episode.attempt_payload import render_depth, render_recorded_images
from ..core.episode.simulator import Simulator, SimulatorCache
from ..core.errors import DatasetError, PartialJobError
from ..core.images.image import Image
from ..core.images.jpeg import decode_jpeg, encode_jpeg
from ..core.images.png import encode_png
from ..selection import AppliedSelection
from . import raiden_schema as schema
from .export_source import depth_cameras
from .raiden_schema import RaidenOptions
from .resample import ResampledEpisode, nearest_frames, resample_episode

# 0 to 255, largest mean pixel difference between a newly rendered and the recorded image. OpenGL of another machine
# stays below. Missing meshes, or the appearance of another yamsim version, exceed it.
_MAX_DIFFERENCE = 3.0


@dataclass(frozen=True)
class ConvertedEpisode:
    """Frames of an episode whose images are already written, with their times, s."""

    times: Sequence[float]
    frames: list[dict[str, Any]]
    pictures: Mapping[str, Any]


class EpisodeConverter(Closable):
    """Converts episodes of one dataset, and may own a renderer.

    Args:
        session: of the dataset's config, with the size of rendered images. Only rendering needs its meshes.
        names: camera -> its name in raiden's layout.
        selection: decisions of a person, which cut off frames.
    """

    def __init__(
        self,
        session: Session,
        names: Mapping[str, str],
        options: RaidenOptions,
        selection: AppliedSelection | None = None,
    ) -> None:
        self._names = names
        self._selection = selection
        self._options = options
        self._quality = session.config.image.jpeg_quality
        self._truth = session.config.truth
        self._simulators = None if options.fps is None else SimulatorCache(session)

    def run(self, job: tuple[Path, Path]) -> ConvertedEpisode:
        """Convert an episode and write its images. `job` is the episode directory and the output folder."""
        directory, folder = job
        try:
            return self._convert_episode(open_episode(directory), folder)
        except OSError as error:
            raise PartialJobError(f"{explain_disk_error(error, folder)}: nothing was exported") from error

    def _convert_episode(self, episode: StoredEpisode, folder: Path) -> ConvertedEpisode:
        shown = self._selection.trim(episode) if self._selection else episode
        first, count = shown.first_frame, shown.record.frames
        if self._simulators is None or self._options.fps is None:
            frames = shown.frames()
            self._copy(episode, folder, range(first, first + count))
            return ConvertedEpisode([frame["timestamp"] for frame in frames], frames, {"source": "recorded"})
        simulator = self._simulators.get(AttemptJob(episode.record.seed, episode.record.attempt))
        made = resample_episode(simulator, episode, self._options.fps, first, count)
        if self._options.renders_images:
            self._render(simulator, shown, folder, made)
            return ConvertedEpisode(made.times.tolist(), made.frames, {"source": "drawn"})
        nearest = nearest_frames(made.times, first + count, episode.record.frame_period_s)
        self._copy(episode, folder, nearest)
        pictures = schema.nearest_pictures(nearest, episode.record.frame_period_s)
        return ConvertedEpisode(made.times.tolist(), made.frames, pictures)

    def _copy(self, episode: StoredEpisode, folder: Path, frames: Sequence[int]) -> None:
        copy_images(episode, folder, self._names, frames, self._options)
        for camera in depth_cameras(episode):
            for k, frame in enumerate(frames):
                place = folder / "depth" / self._names[camera] / schema.frame_name(k, "npz")
                _write_with_parents(place, _read_raiden_depth(episode, camera, frame))

    def _render(self, simulator: Simulator, episode: StoredEpisode, folder: Path, made: ResampledEpisode) -> None:
        depths = depth_cameras(episode)
        if depths and not self._truth:
            raise DatasetError(
                f"{episode.directory} has depth, but its dataset was recorded without --truth, so depth cannot be "
                "rendered again; use the recorded pictures with --pictures nearest"
            )
        for k, camera, image in render_recorded_images(simulator, made.attempt, made.qpos):
            name = self._names[camera]
            if k == 0:
                self._require_same_appearance(episode, camera, image)
            data = encode_png(image) if self._options.images == "png" else encode_jpeg(image, self._quality)
            _write_with_parents(folder / "rgb" / name / schema.frame_name(k, self._options.images), data)
            if camera in depths:
                data = dump_depth(render_depth(simulator, made.attempt, made.qpos[k], camera))
                _write_with_parents(folder / "depth" / name / schema.frame_name(k, "npz"), data)

    def _require_same_appearance(self, episode: StoredEpisode, camera: str, image: Image) -> None:
        recorded = _decode_image(episode, camera, 0, episode.image(camera, 0))
        rendered = decode_jpeg(encode_jpeg(image, self._quality))
        assert rendered is not None
        difference = np.inf
        if rendered.shape == recorded.shape:
            difference = float(np.abs(rendered.astype(np.int16) - recorded).mean())
        if difference > _MAX_DIFFERENCE:
            raise DatasetError(
                f"{episode.directory}: {camera} rendered again is not what was recorded (mean difference "
                f"{difference:.1f} of 255, at most {_MAX_DIFFERENCE:g}): run `yamsim assets fetch` if meshes are "
                "missing, or use "
                "the recorded pictures with --pictures nearest"
            )

    def close(self) -> None:
        """Free the renderer."""
        if self._simulators is not None:
            self._simulators.close()


def copy_images(
    episode: RecordedEpisode, folder: Path, names: Mapping[str, str], frames: Sequence[int], options: RaidenOptions
) -> None:
    """Copy recorded images: JPEGs byte for byte, or as PNGs. `names` is camera -> its name in raiden's layout."""
    for camera, name in names.items():
        before, data = -1, b""
        for k, frame in enumerate(frames):
            if frame != before:
                data = episode.image(camera, frame)
                if options.images == "png":
                    data = encode_png(_decode_image(episode, camera, frame, data))
                before = frame
            _write_with_parents(folder / "rgb" / name / schema.frame_name(k, options.images), data)


def _write_with_parents(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)


def _decode_image(episode: RecordedEpisode, camera: str, frame: int, data: bytes) -> Image:
    image = decode_jpeg(data)
    if image is None:
        raise DatasetError(
            f"{episode.directory}: frame {frame} of {camera} is not a valid JPEG; --images jpg copies it unchanged"
        )
    return image


def _read_raiden_depth(episode: StoredEpisode, camera: str, number: int) -> bytes:
    name = depth_path(camera, number)
    data = episode.read_verified(name)
    width, height = episode.record.cameras[camera]
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            depth = archive[schema.DEPTH_KEY]
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise DatasetError(f"{episode.directory / name} holds no array {schema.DEPTH_KEY!r}: {error}") from error
    if depth.dtype != schema.DEPTH_DTYPE or depth.shape != (height, width):
        raise DatasetError(
            f"{episode.directory / name}: depth is {depth.dtype} {depth.shape}, not {schema.DEPTH_DTYPE} "
            f"{(height, width)}"
        )
    return data
