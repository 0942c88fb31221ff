"""H.264 in MP4 that any player and browser shows, with exact times, and on the disk whole or not at all."""

from __future__ import annotations

import contextlib
import uuid
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import ResourceError, SimulationError, UsageError
from ..files import move_aside, publish_file
from .image import Image

if TYPE_CHECKING:
    from av.container import OutputContainer
    from av.video.stream import VideoStream

# Of 57 recorded frames at 640 x 480: 41.7 dB in 2.6 ms a frame; the slower presets gain 0.5 dB for twice the time.
_ENCODER = {"preset": "veryfast", "crf": "18", "bf": "0"}

# BT.709 in limited range, what players take an untagged H.264 stream for; tagged all the same.
_BT709 = 1
_LIMITED = 1

# A player jumps to key frames only.
_SECONDS_BETWEEN_KEY_FRAMES = 1

# A period such as 1/30 s has no exact float; any that a person writes is a fraction of this size.
_FINEST_PERIOD = 1_000_000


# RGB in 0..1 to BT.709's Y, Cb, Cr in limited range. Source: ITU-R BT.709, 3.2 to 3.5.
_KR, _KB = 0.2126, 0.0722
_LUMA = np.array([_KR, 1 - _KR - _KB, _KB])
_TO_YUV = np.array(
    [
        219 * _LUMA,
        224 / 2 * (np.array([0, 0, 1]) - _LUMA) / (1 - _KB),
        224 / 2 * (np.array([1, 0, 0]) - _LUMA) / (1 - _KR),
    ]
)
_OFFSET = np.array([16.0, 128.0, 128.0])


def _yuv420(image: Image) -> NDArray[np.uint8]:
    """An RGB image as planes Y, Cb, Cr, (3 / 2 height, width); an odd side gets its last row or column twice.

    Not FFmpeg's own conversion: its result depends on how the memory happens to be aligned.
    """
    height, width = image.shape[:2]
    # Colours have half the resolution in both directions, so both sides have to be even.
    even = np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    full = cv2.transform(even.astype(np.float32), np.column_stack([_TO_YUV / 255, _OFFSET]))
    half = cv2.resize(full, (even.shape[1] // 2, even.shape[0] // 2), interpolation=cv2.INTER_AREA)
    planes = [full[..., 0].ravel(), half[..., 1].ravel(), half[..., 2].ravel()]
    rounded: NDArray[np.uint8] = np.round(np.concatenate(planes)).astype(np.uint8).reshape(-1, even.shape[1])
    return rounded


class VideoWriter:
    """Writes images into one MP4, frame k at exactly k periods. Use it as a context manager.

    The file is built under a hidden name beside its own; leaving the block flushes it to the disk and renames it, and
    leaving it by an exception removes it. The same images give the same bytes with the same version of the encoder.

    Attributes:
        path: the file.
        frames: how many images were written.
        moved_aside: where an older file of that name went, once the new one is there.

    Args:
        path: ends in `.mp4`; its directory has to exist.
        frame_period: from one image to the next, s.
        overwrite: move an existing file aside instead of refusing to start.
        key_frame_interval: every so many frames one can be decoded alone; those of a second unless given.

    Raises:
        ResourceError: PyAV is not installed or has no H.264 encoder, or the file cannot be written.
        UsageError: the name does not end in `.mp4`, there is no such directory, or the file exists.
        SimulationError: the encoder refused the images.
    """

    def __init__(
        self,
        path: Path,
        frame_period: float | Fraction,
        *,
        overwrite: bool = False,
        key_frame_interval: int | None = None,
    ) -> None:
        if not frame_period > 0:
            raise ValueError(f"frame_period must be above 0, not {frame_period}")
        self.path = path
        self.frames = 0
        self.moved_aside: Path | None = None
        self._period = Fraction(frame_period).limit_denominator(_FINEST_PERIOD)
        self._overwrite = overwrite
        self._interval = key_frame_interval or max(1, round(_SECONDS_BETWEEN_KEY_FRAMES / self._period))
        require_encoder()
        self._check_path()
        self._part = path.with_name(f".{path.name}.{uuid.uuid4().hex}.part")
        self._container: OutputContainer | None = None
        self._stream: VideoStream | None = None
        self._size = (0, 0)

    @property
    def written(self) -> int:
        """Bytes on the disk so far, while it is being written; the encoder and the muxer hold some back."""
        return self._part.stat().st_size

    def write(self, image: Image) -> None:
        """Add an RGB image (height, width, 3), all of one size; an odd side gets its last row or column twice."""
        if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
            raise ValueError(f"an image has to be (height, width, 3) of uint8, not {image.shape} of {image.dtype}")
        import av

        try:
            self._encode(image)
        except OSError as error:
            raise self._unwritable(error) from error
        except av.FFmpegError as error:
            raise SimulationError(f"{self.path}: the encoder refused frame {self.frames}: {error}") from error

    def _encode(self, image: Image) -> None:
        from av import VideoFrame

        height, width = image.shape[:2]
        if self._container is None or self._stream is None:
            self._container, self._stream = self._open(width, height)
            self._size = (width, height)
        if self._size != (width, height):
            expected = "x".join(map(str, self._size))
            raise ValueError(f"{self.path}: frame {self.frames} is {width}x{height}, the ones before it {expected}")
        frame = VideoFrame.from_ndarray(_yuv420(image), format="yuv420p")
        frame.colorspace, frame.color_range = _BT709, _LIMITED
        frame.pts, frame.time_base = self.frames, self._period
        self._container.mux(self._stream.encode(frame))
        self.frames += 1

    def _open(self, width: int, height: int) -> tuple[OutputContainer, VideoStream]:
        import av

        # faststart: the index comes first, so that a browser plays while it still loads.
        container = av.open(str(self._part), "w", format="mp4", options={"movflags": "+faststart"})
        stream = container.add_stream("libx264", rate=1 / self._period, options=_ENCODER | {"g": str(self._interval)})
        stream.width, stream.height, stream.pix_fmt = width + width % 2, height + height % 2, "yuv420p"
        context = stream.codec_context
        context.time_base = self._period
        # How the encoder splits a frame among threads changes the bytes.
        context.thread_count = 1
        context.colorspace = context.color_primaries = context.color_trc = _BT709
        context.color_range = _LIMITED
        return container, stream

    def _publish(self) -> None:
        if self._container is None or self._stream is None:
            raise ValueError(f"{self.path}: a video needs at least one image")
        try:
            self._container.mux(self._stream.encode(None))
            self._container.close()
            self._check_path()
            if self.path.exists():
                self.moved_aside = move_aside(self.path)
            publish_file(self._part, self.path)
        except OSError as error:
            raise self._unwritable(error) from error

    def _discard(self) -> None:
        if self._container is not None:
            # On a full disk closing fails as writing did; what matters is that the file goes away.
            with contextlib.suppress(OSError):
                self._container.close()
        self._part.unlink(missing_ok=True)

    def _check_path(self) -> None:
        if self.path.suffix.lower() != ".mp4":
            raise UsageError(f"{self.path} is not a name for a video: end it in .mp4")
        if not self.path.parent.is_dir():
            raise UsageError(f"{self.path}: there is no directory {self.path.parent}; make it, or choose another")
        if self.path.exists() and not (self._overwrite and self.path.is_file()):
            raise UsageError(f"{self.path} exists; move it aside with --overwrite, or choose another name")

    def _unwritable(self, error: OSError) -> ResourceError:
        return ResourceError(f"{self.path} cannot be written: {error.strerror or error}; mend it, or write elsewhere")

    def __enter__(self) -> VideoWriter:
        # The encoder holds back its first output for some frames; a directory that cannot be written is told now.
        try:
            self._part.touch(exist_ok=False)
        except OSError as error:
            raise self._unwritable(error) from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if error is None:
                self._publish()
        finally:
            self._discard()


def require_encoder() -> None:
    """Make sure that videos can be written here, before anything is made that a video is to show.

    Raises:
        ResourceError: PyAV is not installed, or has no H.264 encoder.
    """
    try:
        from av import codecs_available
    except ModuleNotFoundError as error:
        if error.name != "av":
            raise
        raise ResourceError("a video needs PyAV, which is not here: pip install 'yamsim[video]'") from error
    if "libx264" not in codecs_available:
        raise ResourceError(
            "this PyAV was built without an H.264 encoder (libx264): install its wheel by pip install 'yamsim[video]'"
        )
