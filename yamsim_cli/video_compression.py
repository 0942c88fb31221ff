"""H.264 compression of a camera's images, so that a recording shows its artefacts.

Images of an episode are encoded and decoded in their order, so an image depends on those since the last key frame, as
in a stream. The quantiser is constant, one thread encodes, and no image waits for later ones.
"""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

import cv2
import numpy as np

from .core.errors import SimulationError
from .core.images.image import Image
from .core.images.video import BT601, convert_to_yuv420, open_h264_encoder, require_encoder

if TYPE_CHECKING:
    from av.video.codeccontext import VideoCodecContext

# Adaptive quantisation and rate control calculate with floating-point numbers; a constant quantiser needs neither.
# `ipratio` is the step of other frames, relative to the step of key frames.
_X264 = "ipratio=1:aq-mode=0:mbtree=0:scenecut=0"
_ENCODER_OPTIONS = {"preset": "veryfast", "tune": "zerolatency", "x264-params": _X264}
_PERIOD = Fraction(1, 30)  # s, which the encoder requires; it has no effect with a constant quantizer


class VideoCompression:
    """Encodes and decodes the images of one camera.

    Attributes:
        packet: the last image in H.264 (Annex B), with headers if it is a key frame.

    Args:
        qp: quantization parameter of all frames, 1 to 51; an increase by 6 doubles the step.
        key_frame_interval: frames between key frames; with 1, no image depends on another one.

    Raises:
        ResourceError: PyAV is not installed, or has no H.264 encoder.
    """

    def __init__(self, qp: int, key_frame_interval: int) -> None:
        require_encoder()
        self._options = _ENCODER_OPTIONS | {"qp": str(qp), "g": str(key_frame_interval)}
        self._next_frame = 0
        self._codecs: tuple[VideoCodecContext, VideoCodecContext] | None = None
        self.packet = b""

    def apply(self, image: Image, frame: int) -> None:
        """Compress an RGB image (height, width, 3) in place. Frame 0 begins another video.

        Raises:
            ValueError: the frame does not follow the last one.
            SimulationError: the encoder or the decoder rejected the image.
        """
        import av

        if frame == 0:
            self._codecs, self._next_frame = None, 0
        if frame != self._next_frame:
            raise ValueError(f"frame {frame} is compressed after frame {self._next_frame - 1}")
        self._next_frame += 1
        height, width = image.shape[:2]
        yuv = av.VideoFrame.from_ndarray(convert_to_yuv420(image, BT601), format="yuv420p")
        yuv.pts = frame
        if self._codecs is None:
            decoder = av.CodecContext.create("h264", "r")
            decoder.thread_count = 1
            self._codecs = open_h264_encoder(yuv.width, yuv.height, _PERIOD, self._options), decoder
        encoder, decoder = self._codecs
        try:
            packets = encoder.encode(yuv)
            decoded = [shown for packet in packets for shown in decoder.decode(packet)]
        except av.FFmpegError as error:
            raise SimulationError(f"image {frame} cannot be compressed by H.264: {error}") from error
        if len(packets) != 1 or len(decoded) != 1:
            raise SimulationError(f"H.264 gave {len(packets)} packets and {len(decoded)} images for image {frame}")
        self.packet = bytes(packets[0])
        # The result of FFmpeg's own conversion depends on the alignment of the memory.
        rgb = cv2.cvtColor(decoded[0].to_ndarray(format="yuv420p"), cv2.COLOR_YUV2RGB_I420)
        image[:] = np.asarray(rgb)[:height, :width]
