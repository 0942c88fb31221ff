"""H.264 videos in MP4 files with exact frame times."""

from __future__ import annotations

import contextlib
import uuid
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import DatasetError, ResourceError, SimulationError, UsageError
from ..files.writing import move_to_backup, publish_file
from .image import Image

if TYPE_CHECKING:
    from av.container import OutputContainer
    from av.video.codeccontext import VideoCodecContext
    from av.video.stream import VideoStream


@dataclass(frozen=True)
class ColorMatrix:
    """A conversion of RGB to luma and two colour differences in limited range.

    Attributes:
        red, blue: weights in luma; the weight of green is the rest to 1.
        tag: code of the matrix in a video stream. Source: ITU-T H.273, table 4.
    """

    red: float
    blue: float
    tag: int


# Players assume BT.709 for an untagged H.264 stream. Source: ITU-R BT.709, 3.2.
BT709 = ColorMatrix(0.2126, 0.0722, 1)
# Decoders for training that ignore the tag assume BT.601. Source: ITU-R BT.601, 2.5.1.
BT601 = ColorMatrix(0.299, 0.114, 6)

# Y, Cb and Cr of black, and widths of the ranges of luma and colour. Source: ITU-R BT.709, 3.4 and 3.5; as in BT.601.
_OFFSET = np.array([16.0, 128.0, 128.0])
_LUMA_RANGE, _COLOUR_RANGE = 219, 224


def convert_to_yuv420(image: Image, matrix: ColorMatrix) -> NDArray[np.uint8]:
    """Convert an RGB image to its planes Y, Cb and Cr, stacked as (3 / 2 height, width).

    If a side is odd, the last row or column is repeated. The result of FFmpeg's own conversion depends on the alignment
    of the memory.
    """
    height, width = image.shape[:2]
    # Colours have half the resolution, so both sides must be even.
    even = np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
    full = cv2.transform(even.astype(np.float32), np.column_stack([_yuv_from_rgb(matrix) / 255, _OFFSET]))
    half = cv2.resize(full, (even.shape[1] // 2, even.shape[0] // 2), interpolation=cv2.INTER_AREA)
    planes = [full[..., 0].ravel(), half[..., 1].ravel(), half[..., 2].ravel()]
    rounded: NDArray[np.uint8] = np.round(np.concatenate(planes)).astype(np.uint8).reshape(-1, even.shape[1])
    return rounded


def _yuv_from_rgb(matrix: ColorMatrix) -> NDArray[np.float64]:
    luma = np.array([matrix.red, 1 - matrix.red - matrix.blue, matrix.blue])
    return np.array(
        [
            _LUMA_RANGE * luma,
            _COLOUR_RANGE / 2 * (np.array([0, 0, 1]) - luma) / (1 - matrix.blue),
            _COLOUR_RANGE / 2 * (np.array([1, 0, 0]) - luma) / (1 - matrix.red),
        ]
    )


_CODECS = {"h264": "h264", "h265": "hevc", "hevc": "hevc"}


def _import_av() -> Any:
    try:
        import av
    except ModuleNotFoundError as error:
        if error.name != "av":
            raise
        raise ResourceError("a video needs PyAV, which is missing: pip install 'yamsim[video]'") from error
    return av


def read_video_frames(file: Path, begin: float, count: int, tolerance: float) -> Iterator[Image]:
    """Yield at most `count` RGB frames (height, width, 3) of a video file from `begin` (s) on.

    The first frame may precede `begin` by `tolerance` (s).
    """
    av = _import_av()
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
        raise DatasetError(f"{file} cannot be read as a video: {error}") from error


def decode_packets(packets: Iterable[bytes], codec: str, source: str) -> Iterator[Image]:
    """Yield the RGB frames (height, width, 3) of encoded packets of one frame each; `source` names them in errors."""
    av = _import_av()
    name = _CODECS.get(codec.lower())
    if name is None:
        raise DatasetError(f"{source}: the codec of its images is {codec!r}; valid: {', '.join(_CODECS)}")
    try:
        decoder = av.CodecContext.create(name, "r")
        for packet in packets:
            for frame in decoder.decode(av.Packet(packet)):
                yield frame.to_ndarray(format="rgb24")
        for frame in decoder.decode(None):
            yield frame.to_ndarray(format="rgb24")
    except av.FFmpegError as error:
        raise DatasetError(f"{source}: its images cannot be decoded: {error}") from error


# 43.7 dB for 57 recorded frames at 640 x 480; the preset medium gains 0.4 dB. With mbtree, equal images sometimes give
# different bytes: 3 of 60 encodings at 224 x 224, 20 of 100 at 24 x 16. Without mbtree, never.
H264_OPTIONS = {"preset": "veryfast", "crf": "21", "bf": "0", "mbtree": "0"}

# sRGB has the primaries of BT.709 and nearly its transfer curve. Source of the codes: ITU-T H.273, tables 2 and 3.
_BT709 = 1
_LIMITED = 1

_KEY_FRAME_SECONDS = 1  # s between key frames, the only frames to which players can jump
_MAX_DENOMINATOR = 1_000_000  # of a frame period as a fraction of a second; 1/30 s is not exact as a float


def open_h264_encoder(width: int, height: int, period: Fraction, options: Mapping[str, str]) -> VideoCodecContext:
    """Return an encoder of H.264 in Annex B for 4:2:0 images of a size, px, `period` s apart."""
    context = _import_av().CodecContext.create("libx264", "w")
    context.width, context.height, context.pix_fmt = width, height, "yuv420p"
    # Several threads would split frames, which changes the bytes.
    context.time_base, context.thread_count, context.options = period, 1, dict(options)
    return cast("VideoCodecContext", context)


def encode_packets(images: Iterable[Image], frame_period: float) -> list[bytes]:
    """Encode RGB images (height, width, 3) as H.264 in Annex B: a packet for each image, headers at each key frame.

    Args:
        frame_period: s. It decides only how often key frames come; packets have no times.

    Raises:
        SimulationError: the encoder rejected an image, or returned another number of packets.
    """
    av = _import_av()
    period = Fraction(frame_period).limit_denominator(_MAX_DENOMINATOR)
    context, packets, count = None, [], 0
    try:
        for count, image in enumerate(images, start=1):
            frame = av.VideoFrame.from_ndarray(convert_to_yuv420(image, BT601), format="yuv420p")
            if context is None:
                options = H264_OPTIONS | {"g": str(max(1, round(_KEY_FRAME_SECONDS / period)))}
                context = open_h264_encoder(frame.width, frame.height, period, options)
            frame.pts, frame.time_base = count - 1, period
            packets += [bytes(packet) for packet in context.encode(frame)]
        packets += [bytes(packet) for packet in context.encode(None)] if context else []
    except av.FFmpegError as error:
        raise SimulationError(f"the encoder rejected image {count}: {error}") from error
    if len(packets) != count:
        raise SimulationError(f"the encoder returned {len(packets)} packets for {count} images")
    return packets


class VideoWriter:
    """Writes images into one MP4 file, with frame k at exactly k periods; a context manager.

    The file has a hidden name in the same directory until the end of the block, and is deleted after an exception.
    Equal images give equal bytes with the same version of the encoder.

    Attributes:
        frames: number of images written so far.
        moved_aside: path to which an existing file was moved.

    Args:
        path: ends in `.mp4`; the directory must exist.
        frame_period: time between two images, s.
        overwrite: whether to move an existing file to a backup. Otherwise an existing file is an error.
        key_frame_interval: frames between key frames; one second by default.
        scene_cuts: whether the encoder may add key frames where the image changes.

    Raises:
        ResourceError: PyAV is not installed or has no H.264 encoder, or the file cannot be written.
        UsageError: the name does not end in `.mp4`, the directory does not exist, or the file exists.
        SimulationError: the encoder rejected an image.
    """

    def __init__(
        self,
        path: Path,
        frame_period: float | Fraction,
        *,
        overwrite: bool = False,
        key_frame_interval: int | None = None,
        matrix: ColorMatrix = BT709,
        scene_cuts: bool = True,
    ) -> None:
        if not frame_period > 0:
            raise ValueError(f"frame_period must be above 0, not {frame_period}")
        self.path = path
        self.frame_count = 0
        self.moved_aside: Path | None = None
        self._period = Fraction(frame_period).limit_denominator(_MAX_DENOMINATOR)
        self._overwrite, self._matrix = overwrite, matrix
        interval = key_frame_interval or max(1, round(_KEY_FRAME_SECONDS / self._period))
        self._options = H264_OPTIONS | {"g": str(interval)} | ({} if scene_cuts else {"sc_threshold": "0"})
        require_encoder()
        self._check_path()
        self._part = path.with_name(f".{path.name}.{uuid.uuid4().hex}.part")
        self._container: OutputContainer | None = None
        self._stream: VideoStream | None = None
        self._size = (0, 0)

    def write(self, image: Image) -> None:
        """Append an RGB image (height, width, 3) of the same size as all others; odd sides are padded by one pixel."""
        if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3:
            raise ValueError(f"an image must be (height, width, 3) of uint8, not {image.shape} of {image.dtype}")
        import av

        try:
            self._encode(image)
        except OSError as error:
            raise self._unwritable_error(error) from error
        except av.FFmpegError as error:
            raise SimulationError(f"{self.path}: the encoder refused frame {self.frame_count}: {error}") from error

    def _encode(self, image: Image) -> None:
        from av import VideoFrame

        height, width = image.shape[:2]
        if self._container is None or self._stream is None:
            self._container, self._stream = self._open(width, height)
            self._size = (width, height)
        if self._size != (width, height):
            expected = "x".join(map(str, self._size))
            raise ValueError(
                f"{self.path}: frame {self.frame_count} is {width}x{height}, but earlier ones are {expected}"
            )
        frame = VideoFrame.from_ndarray(convert_to_yuv420(image, self._matrix), format="yuv420p")
        frame.colorspace, frame.color_range = self._matrix.tag, _LIMITED
        frame.pts, frame.time_base = self.frame_count, self._period
        self._container.mux(self._stream.encode(frame))
        self.frame_count += 1

    def _open(self, width: int, height: int) -> tuple[OutputContainer, VideoStream]:
        import av

        # With faststart, the index comes first, and a browser can play the file while it loads.
        container = av.open(str(self._part), "w", format="mp4", options={"movflags": "+faststart"})
        stream = container.add_stream("libx264", rate=1 / self._period, options=self._options)
        stream.width, stream.height, stream.pix_fmt = width + width % 2, height + height % 2, "yuv420p"
        context = stream.codec_context
        context.time_base = self._period
        # Several threads would split frames, which changes the bytes.
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
            raise self._unwritable_error(error) from error

    def _discard(self) -> None:
        if self._container is not None:
            # On a full disk, closing fails too. The file is deleted anyway.
            with contextlib.suppress(OSError):
                self._container.close()
        self._part.unlink(missing_ok=True)

    def _check_path(self) -> None:
        if self.path.suffix.lower() != ".mp4":
            raise UsageError(f"{self.path} is not a valid name for a video; it must end in .mp4")
        if not self.path.parent.is_dir():
            raise UsageError(f"{self.path}: there is no directory {self.path.parent}; create it, or choose another")
        if self.path.exists() and not (self._overwrite and self.path.is_file()):
            raise UsageError(f"{self.path} exists; move it aside with --overwrite, or choose another name")

    def _unwritable_error(self, error: OSError) -> ResourceError:
        return ResourceError(f"{self.path} cannot be written: {error.strerror or error}; choose another path")

    def __enter__(self) -> VideoWriter:
        # The encoder writes nothing for its first frames: test here whether the directory is writable.
        try:
            self._part.touch(exist_ok=False)
        except OSError as error:
            raise self._unwritable_error(error) from error
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
    """Raise ResourceError if PyAV is not installed, or has no H.264 encoder."""
    if "libx264" not in _import_av().codecs_available:
        raise ResourceError(
            "this PyAV was built without an H.264 encoder (libx264): install its wheel by pip install 'yamsim[video]'"
        )
