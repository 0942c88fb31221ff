"""The config of a camera's lens, shutter and sensor."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat, model_validator

from ..core.files.documents.config_base import Config, ConflictError, Name
from ..core.files.documents.units import QuantityBounds
from ..core.geometry.camera import CameraModel, Intrinsics

_MIN_CROP = 0.05  # smallest width and height of `crop`, as shares; less is most likely a mistake
_COEFFICIENT_COUNTS = {"opencv": (0, 4, 5, 8, 12, 14), "fisheye": (4,)}  # lens -> valid numbers of coefficients

_Coefficient = Annotated[FiniteFloat, Field(ge=-10, le=10)]
_Offset = Annotated[FiniteFloat, QuantityBounds("of 1", -0.25, 0.25)]
_Share = Annotated[FiniteFloat, QuantityBounds("of 1", 0, 1)]
_AspectRatio = Annotated[FiniteFloat, QuantityBounds("of 1", 0.2, 5)]
_Gain = Annotated[FiniteFloat, QuantityBounds("of 1", 0.1, 10)]
_Exposure = Annotated[FiniteFloat, QuantityBounds("EV", -8, 8)]
_FullWell = Annotated[FiniteFloat, QuantityBounds("electrons", 10, 1e6)]
_ReadNoise = Annotated[FiniteFloat, QuantityBounds("electrons", 0, 1000)]
_Time = Annotated[FiniteFloat, QuantityBounds("ms", 0, 500)]


class CameraEffects(Config):
    """Differences of a real camera's images from those of an ideal pinhole camera with the same field of view.

    Effects apply in this order: delay, shutter, lens with `crop` and `letterbox`, exposure, white balance, noise, JPEG,
    H.264. A key that is left out has no effect.

    Attributes:
        lens: model of `distortion`: OpenCV's standard model, or its fisheye model.
        distortion: coefficients in OpenCV's order: 4, 5, 8, 12 or 14 of the standard model, 4 of the fisheye model. The
            camera's field of view determines the focal length.
        principal_point: offset of the principal point from the sensor's centre, to the right and down, as a share of
            the sensor's width and height.
        exposure_ev: change of the exposure, EV: +1 doubles the light.
        white_balance: factors on the light of red, green and blue.
        full_well_e: electrons of a saturated pixel, which determine the shot noise; without it, there is no noise. A
            gain divides this number.
        read_noise_e: standard deviation of the read noise, electrons.
        jpeg_quality: quality of the JPEG compression in the camera, 1 to 100, before the image is stored.
        h264_qp: quantization parameter (QP) of H.264 compression in the camera, 1 to 51, before the image is stored; an
            increase by 6 doubles the step. An image depends on those before it, as in a video. Needs the extra `video`.
        h264_key_frames: number of frames from one key frame of `h264_qp` to the next; with 1, each image is compressed
            alone.
        crop: left, top, right and bottom edge of the part of the sensor's image that is kept, as shares of its size.
            The field of view and `principal_point` are those of the whole sensor.
        letterbox: aspect ratio (width / height) of the picture; black bars fill the rest of the image. Without it, the
            picture fills the image.
        exposure_ms: time for which a row is exposed, ms, which blurs motion. Without `readout_ms`, the exposure ends at
            the frame's time.
        readout_ms: time from the exposure of the first row to that of the last one, ms: a rolling shutter. The last row
            is exposed until the frame's time.
        shutter_samples: number of states that are rendered for one image, if it has motion blur or a rolling shutter.
        delay_frames: number of frames by which images, and their ground truth, are late.
    """

    name: Name = "custom"
    lens: Literal["opencv", "fisheye"] = "opencv"
    distortion: tuple[_Coefficient, ...] = ()
    principal_point: tuple[_Offset, _Offset] = (0.0, 0.0)
    exposure_ev: _Exposure = 0.0
    white_balance: tuple[_Gain, _Gain, _Gain] = (1.0, 1.0, 1.0)
    full_well_e: _FullWell | None = None
    read_noise_e: _ReadNoise = 0.0
    jpeg_quality: int | None = Field(default=None, ge=1, le=100)
    h264_qp: int | None = Field(default=None, ge=1, le=51)
    h264_key_frames: int = Field(default=30, ge=1, le=1000)
    crop: tuple[_Share, _Share, _Share, _Share] | None = None
    letterbox: _AspectRatio | None = None
    exposure_ms: _Time = 0.0
    readout_ms: _Time = 0.0
    shutter_samples: int = Field(default=6, ge=2, le=64)
    delay_frames: int = Field(default=0, ge=0, le=100)

    @model_validator(mode="after")
    def _is_consistent(self) -> CameraEffects:
        valid = _COEFFICIENT_COUNTS[self.lens]
        if len(self.distortion) not in valid:
            raise ConflictError(
                f"distortion has {len(self.distortion)} numbers; valid for lens {self.lens!r}: "
                f"{', '.join(map(str, valid))}",
                ("distortion",),
                ("lens",),
            )
        if self.read_noise_e and self.full_well_e is None:
            raise ConflictError(
                "read_noise_e needs full_well_e, the number of electrons of a white pixel", ("read_noise_e",)
            )
        if self.h264_qp is None and self.h264_key_frames != type(self).model_fields["h264_key_frames"].default:
            raise ConflictError("h264_key_frames needs h264_qp, the quantization of the video", ("h264_key_frames",))
        if self.crop is not None:
            left, top, right, bottom = self.crop
            if min(right - left, bottom - top) < _MIN_CROP:
                raise ConflictError(
                    f"crop is left, top, right, bottom, at least {_MIN_CROP:g} wide and high; it is {right - left:g} "
                    f"wide and {bottom - top:g} high",
                    ("crop",),
                )
        return self

    @property
    def has_lens(self) -> bool:
        """Whether images differ in geometry from those of a centred pinhole camera."""
        off_centre = self.principal_point != (0.0, 0.0)
        return bool(self.distortion) or off_centre or self.crop is not None or self.letterbox is not None

    @property
    def has_shutter(self) -> bool:
        """Whether an image shows more than one state."""
        return self.exposure_ms > 0 or self.readout_ms > 0

    def picture_box(self, width: int, height: int) -> tuple[int, int, int, int]:
        """Return left, top, right and bottom edge, px, of the picture without bars in an image of a size, px."""
        if self.letterbox is None:
            return 0, 0, width, height
        across, down = min(width, round(height * self.letterbox)), min(height, round(width / self.letterbox))
        left, top = (width - across) // 2, (height - down) // 2
        return left, top, left + across, top + down

    def camera_model(self, ideal: Intrinsics) -> CameraModel:
        """Return the camera whose sensor has the vertical field of view of the centred pinhole camera `ideal`."""
        left, top, right, bottom = self.picture_box(ideal.width, ideal.height)
        x0, y0, x1, y1 = self.crop or (0.0, 0.0, 1.0, 1.0)
        # Size of the whole sensor, and place of its centre, in pixels of the image.
        width, height = (right - left) / (x1 - x0), (bottom - top) / (y1 - y0)
        cx = left - x0 * width + (width - 1) / 2 + self.principal_point[0] * width
        cy = top - y0 * height + (height - 1) / 2 + self.principal_point[1] * height
        scale = height / ideal.height
        K = ((ideal.fx * scale, 0.0, cx), (0.0, ideal.fy * scale, cy), (0.0, 0.0, 1.0))
        return CameraModel(ideal.width, ideal.height, K, self.distortion, fisheye=self.lens == "fisheye")
