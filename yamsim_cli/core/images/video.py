"""Writes H.264 in MP4 for any player and browser, with exact times, and reads the pictures of films.

A written file appears whole or not at all.
"""

from __future__ import annotations

import contextlib
import uuid
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import DatasetError, ResourceError, SimulationError, UsageError
from ..files.writing import move_to_backup, publish_file
from .image import Image

if TYPE_CHECKING:
    from av.container import OutputContainer
    from av.video.stream import VideoStream


@dataclass(frozen=True)
class ColorMatrix:
    """A conversion of RGB to luma and two colour differences, in limited range.

    Attributes:
        red, blue: their shares of luma; green has the rest.
        tag: the matrix's number in a stream. Source: ITU-T H.273, table 4.
    """

    red: float
    blue: float
    tag: int


# The matrix that players assume for an untagged H.264 stream. Source: ITU-R BT.709, 3.2.
BT709 = ColorMatrix(0.2126, 0.0722, 1)
# The matrix that decoders for training assume if they ignore the tag. Source: ITU-R BT.601, 2.5.1.
BT601 = ColorMatrix(0.299, 0.114, 6)

# Y, Cb and Cr of black, and the ranges of luma and colours. Source: ITU-R BT.709, 3.4 and 3.5; BT.601 has the same.
_OFFSET = np.array([16.0, 128.0, 128.0])
_LUMA_RANGE, _COLOUR_RANGE = 219, 224


def yuv420(image: Image, matrix: ColorMatrix) -> NDArray[np.uint8]:
    """The planes Y, Cb and Cr of an RGB image, (3 / 2 height, width); an odd side gets its last row or column twice.

    FFmpeg's own conversion is not used: its result depends on how the memory happens to be aligned.
    """
    height, width = image.shape[:2]
    # Colours have half the resolution, so both sides have to be even.
    even = np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    full = cv2.transform(even.astype(np.float32), np.column_stack([_rows(matrix) / 255, _OFFSET]))
    half = cv2.resize(full, (even.shape[1] // 2, even.shape[0] // 2), interpolation=cv2.INTER_AREA)
    planes = [full[..., 0].ravel(), half[..., 1].ravel(), half[..., 2].ravel()]
    rounded: NDArray[np.uint8] = np.round(np.concatenate(planes)).astype(np.uint8).reshape(-1, even.shape[1])
    return rounded


def _rows(matrix: ColorMatrix) -> NDArray[np.float64]:
    """The matrix (3, 3) from RGB in 0..1 to Y, Cb and Cr."""
    luma = np.array([matrix.red, 1 - matrix.red - matrix.blue, matrix.blue])
    return np.array(
        [
            _LUMA_RANGE * luma,
            _COLOUR_RANGE / 2 * (np.array([0, 0, 1]) - luma) / (1 - matrix.blue),
            _COLOUR_RANGE / 2 * (np.array([1, 0, 0]) - luma) / (1 - matrix.red),
        ]
    )


_CODECS = {"h264": "h264", "h265": "hevc", "hevc": "hevc"}


def _av() -> Any:
    try:
        import av
    except ModuleNotFoundError as error:
        if error.name != "av":
            raise
        raise ResourceError("a video needs PyAV, which is not here: pip install 'yamsim[video]'") from error
    return av


def film_frames(file: Path, begin: float, count: int, tolerance: float) -> Iterator[Image]:
    """The pictures (height, width, 3) of a film from a time on, as RGB.

    Args:
        begin: time of the first picture, s.
        count: largest number of pictures.
        tolerance: how much earlier than `begin` the first picture may be, s.

    Raises:
        DatasetError: the film cannot be read.
        ResourceError: PyAV is not installed.
    """
    av = _av()
    try:
        with av.open(str(file)) as container:
            stream = container.streams.video[0]
            if begin > 0:
                container.seek(int(begin / stream.time_base), stream=stream, backward=True)
            for frame in container.decode(stream):
                if frame.time is None or frame.time < begin - tolerance:
                    continue
                if count <= 0:
                    return
                count -= 1
                yield frame.to_ndarray(format="rgb24")
    except (OSError, av.FFmpegError, IndexError) as error:
        raise DatasetError(f"{file} cannot be read as a film: {error}") from error


def packet_frames(packets: Iterable[bytes], codec: str, source: str) -> Iterator[Image]:
    """The pictures (height, width, 3) of a stream of packets with one picture each, as RGB.

    Raises:
        DatasetError: the packets cannot be decoded, or the codec is not H.264 or H.265.
        ResourceError: PyAV is not installed.
    """
    av = _av()
    name = _CODECS.get(codec.lower())
    if name is None:
        raise DatasetError(f"{source}: its pictures are {codec!r}; valid: {', '.join(_CODECS)}")
    try:
        decoder = av.CodecContext.create(name, "r")
        for packet in packets:
            for frame in decoder.decode(av.Packet(packet)):
                yield frame.to_ndarray(format="rgb24")
        for frame in decoder.decode(None):
            yield frame.to_ndarray(format="rgb24")
    except av.FFmpegError as error:
        raise DatasetError(f"{source}: its pictures cannot be decoded: {error}") from error


# 43.7 dB for 57 recorded frames at 640 x 480; the preset medium gains 0.4 dB. With mbtree the same images sometimes
# give different bytes (3 of 60 encodings at 224 x 224, and 20 of 100 at 24 x 16); without mbtree never.
ENCODER = {"preset": "veryfast", "crf": "21", "bf": "0", "mbtree": "0"}

# sRGB pictures have BT.709's primaries and nearly its transfer curve. Source: ITU-T H.273, tables 2 and 3.
_BT709 = 1
_LIMITED = 1

_SECONDS_BETWEEN_KEY_FRAMES = 1  # players can jump only to key frames
_FINEST_PERIOD = 1_000_000  # largest denominator of a period, s: 1/30 s is not exact as a float


class VideoWriter:
    """Writes images into one MP4; frame k is at exactly k periods. Use it as a context manager.

    The file is built under a hidden name beside its own. At the block's end it is flushed to the disk and renamed; an
    exception removes it. The same images give the same bytes with the same version of the encoder.

    Attributes:
        path: the file.
        frames: how many images were written.
        moved_aside: the new place of an older file of that name; None without one, or if no new file was written.

    Args:
        path: ends in `.mp4`; its directory has to exist.
        frame_period: time from one image to the next, s.
        overwrite: move an existing file aside instead of refusing to start.
        key_frame_interval: frames from one key frame to the next; by default those of one second.
        matrix: how colours are stored; the stream has the matrix's tag.

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
        matrix: ColorMatrix = BT709,
    ) -> None:
        if not frame_period > 0:
            raise ValueError(f"frame_period must be above 0, not {frame_period}")
        self.path = path
        self.frames = 0
        self.moved_aside: Path | None = None
        self._period = Fraction(frame_period).limit_denominator(_FINEST_PERIOD)
        self._overwrite, self._matrix = overwrite, matrix
        self._interval = key_frame_interval or max(1, round(_SECONDS_BETWEEN_KEY_FRAMES / self._period))
        require_encoder()
        self._check_path()
        self._part = path.with_name(f".{path.name}.{uuid.uuid4().hex}.part")
        self._container: OutputContainer | None = None
        self._stream: VideoStream | None = None
        self._size = (0, 0)

    def write(self, image: Image) -> None:
        """Add an RGB image (height, width, 3). All have one size; an odd side gets its last row or column twice."""
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
        frame = VideoFrame.from_ndarray(yuv420(image, self._matrix), format="yuv420p")
        frame.colorspace, frame.color_range = self._matrix.tag, _LIMITED
        frame.pts, frame.time_base = self.frames, self._period
        self._container.mux(self._stream.encode(frame))
        self.frames += 1

    def _open(self, width: int, height: int) -> tuple[OutputContainer, VideoStream]:
        import av

        # With faststart the index comes first, so that a browser can play the file while it loads.
        container = av.open(str(self._part), "w", format="mp4", options={"movflags": "+faststart"})
        stream = container.add_stream("libx264", rate=1 / self._period, options=ENCODER | {"g": str(self._interval)})
        stream.width, stream.height, stream.pix_fmt = width + width % 2, height + height % 2, "yuv420p"
        context = stream.codec_context
        context.time_base = self._period
        # Several threads would split frames, and that changes the bytes.
        context.thread_count = 1
        context.color_primaries = context.color_trc = _BT709
        context.colorspace, context.color_range = self._matrix.tag, _LIMITED
        return container, stream

    def _publish(self) -> None:
        if self._container is None or self._stream is None:
            raise ValueError(f"{self.path}: a video needs at least one image")
        try:
            self._container.mux(self._stream.encode(None))
            self._container.close()
            self._check_path()
            if self.path.exists():
                self.moved_aside = move_to_backup(self.path)
            publish_file(self._part, self.path)
        except OSError as error:
            raise self._unwritable(error) from error

    def _discard(self) -> None:
        if self._container is not None:
            # On a full disk closing fails too, and the file is removed.
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
        # The encoder writes nothing for its first frames. This shows whether the directory can be written.
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
    """Refuse, before any work, to write videos without an encoder.

    Raises:
        ResourceError: PyAV is not installed, or has no H.264 encoder.
    """
    if "libx264" not in _av().codecs_available:
        raise ResourceError(
            "this PyAV was built without an H.264 encoder (libx264): install its wheel by pip install 'yamsim[video]'"
        )
