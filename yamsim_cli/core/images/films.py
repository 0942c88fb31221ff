"""The pictures of films that others made, decoded."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from ..errors import DatasetError, ResourceError
from .image import Image

_CODECS = {"h264": "h264", "h265": "hevc", "hevc": "hevc"}


def _av() -> Any:
    try:
        import av
    except ModuleNotFoundError as error:
        if error.name != "av":
            raise
        raise ResourceError("films need PyAV, which is not here: pip install 'yamsim[video]'") from error
    return av


def film_frames(file: Path, begin: float, count: int, tolerance: float) -> Iterator[Image]:
    """The pictures (height, width, 3) of a film from a time on, as RGB.

    Args:
        begin: of the first, s.
        count: how many at most.
        tolerance: how much earlier the first may be, s.

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
    """The pictures (height, width, 3) of a stream of packets without a file around it, each with one picture, as RGB.

    Raises:
        DatasetError: they cannot be decoded, or the codec is another than H.264 and H.265.
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
