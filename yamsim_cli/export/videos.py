from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..core.dataset.reader import RecordedEpisode, read_side_by_side_images
from ..core.errors import DatasetError, InterruptedJobError, PartialJobError, UsageError, suggest_similar
from ..core.files.writing import move_to_backup, write_file
from ..core.images.image import Image
from ..core.images.jpeg import decode_jpeg, encode_jpeg
from ..core.images.video import VideoWriter, require_encoder
from ..core.progress import Progress
from ..core.rendering.view_cameras import draw_labels, resize_area
from .export_source import ExportSource, RealSource
from .output_directory import ExportResult, export_directory, require_parent

_SHEET_QUALITY = 90  # JPEG quality (1 to 100)
_MAX_SIDE_PX = 16_000  # px of a contact sheet: some programs cannot open a larger JPEG


def export_mp4(
    source: ExportSource,
    out: Path,
    cameras: Sequence[str],
    progress: Progress,
    *,
    speed: float = 1.0,
    overwrite: bool = False,
) -> ExportResult:
    """Write an H.264 video of each episode into a directory. The time of frame k is exactly k frame periods.

    Cameras are shown side by side, by default all. A `speed` of 1 is real time.
    """
    chosen = _choose_cameras(source, cameras)
    require_encoder()
    frames = 0
    notes: list[str] = []
    with export_directory(out, overwrite=overwrite) as stage:
        for number, episode in enumerate(source.open_episodes()):
            if isinstance(source, RealSource) and (note := source.describe_uneven_times(episode, episode.frames())):
                notes.append(note)
            with VideoWriter(stage.path / f"{episode.directory.name}.mp4", source.frame_period / speed) as video:
                for image in read_side_by_side_images(episode, chosen):
                    video.write(image)
            frames += video.frame_count
            progress(number + 1, len(source))
    return ExportResult(out, len(source), frames, stage.moved_aside, tuple(notes))


def export_sheet(
    source: ExportSource,
    out: Path,
    cameras: Sequence[str],
    progress: Progress,
    *,
    columns: int = 8,
    width: int = 160,
    overwrite: bool = False,
) -> ExportResult:
    """Write a contact sheet: one JPEG in which a row shows images of `width` px, evenly spread over an episode.

    Each camera has a row per episode; the default is the first camera.
    """
    chosen = _choose_cameras(source, cameras or tuple(source.camera_sizes)[:1])
    if out.suffix.lower() not in (".jpg", ".jpeg"):
        raise UsageError(f"{out} is not a valid name for a sheet; it must end in .jpg")
    require_parent(out)
    if out.exists() and not overwrite:
        raise UsageError(f"{out} exists; move it aside with --overwrite, or choose another OUT")
    heights = {
        camera: round(width * source.camera_sizes[camera][1] / source.camera_sizes[camera][0]) for camera in chosen
    }
    size = (columns * width, len(source) * sum(heights.values()))
    if max(size) > _MAX_SIDE_PX:
        raise UsageError(
            f"{len(source)} episodes make a sheet of {size[0]}x{size[1]} px, but a side has at most {_MAX_SIDE_PX} px: "
            "give fewer --episodes, or a smaller --width"
        )
    moved = None
    try:
        rows: list[Image] = []
        for number, episode in enumerate(source.open_episodes()):
            rows += [_image_row(episode, camera, columns, (width, height)) for camera, height in heights.items()]
            progress(number + 1, len(source))
        data = encode_jpeg(np.concatenate(rows), _SHEET_QUALITY)
        if out.exists():
            moved = move_to_backup(out)
        write_file(out, data)
    except OSError as error:
        raise PartialJobError(f"{out} cannot be written: {error.strerror or error}; choose another OUT") from error
    except KeyboardInterrupt:
        raise InterruptedJobError(f"interrupted: nothing was written to {out}; run it again") from None
    return ExportResult(out, len(source), len(rows) * columns, moved)


def _image_row(episode: RecordedEpisode, camera: str, columns: int, size: tuple[int, int]) -> Image:
    images = []
    for k in np.linspace(0, episode.record.frames - 1, columns).round().astype(int):
        image = decode_jpeg(episode.image(camera, int(k)))
        if image is None:
            raise DatasetError(f"{episode.directory}: frame {k} of {camera} is not a JPEG")
        images.append(resize_area(image, *size))
    return draw_labels(np.concatenate(images, axis=1), {}, episode.directory.name)


def _choose_cameras(source: ExportSource, wanted: Sequence[str]) -> tuple[str, ...]:
    if not source.camera_sizes:
        raise DatasetError(f"{source.path} has no pictures, so there is nothing to show")
    for name in wanted:
        if name not in source.camera_sizes:
            raise UsageError(f"--camera {name!r} is not valid; {suggest_similar(name, source.camera_sizes)}")
    chosen = tuple(wanted) or tuple(source.camera_sizes)
    if len({source.camera_sizes[name][1] for name in chosen}) > 1:
        raise UsageError(f"the images of {' and '.join(chosen)} differ in height: give one --camera")
    return chosen
