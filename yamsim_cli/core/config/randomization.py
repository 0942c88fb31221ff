"""Domain randomization: ranges of the values that vary between attempts."""

from __future__ import annotations

from typing import Annotated

from pydantic import AfterValidator, Field, FiniteFloat, model_validator

from ...procedural.light_kinds import HELD_OUT_LIGHTS, LightKind
from ...procedural.textures import HELD_OUT_TEXTURES, Texture
from ..files.documents.config_base import (
    Config,
    ConfigReference,
    ConflictError,
    Name,
    Positive,
    Range,
    require_ordered,
)
from ..files.documents.units import QuantityBounds, WorkspaceRange
from .objects.object_config import ObjectConfig


def _require_positive(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] <= 0:
        raise ValueError(f"factors must be above 0, not {value[0]}")
    return value


def _require_share(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] < 0 or value[1] > 1:
        raise ValueError(f"must lie in 0..1, not {value[0]}..{value[1]}")
    return value


FactorRange = Annotated[Range, AfterValidator(_require_positive)]
ShareRange = Annotated[Range, AfterValidator(_require_share)]
_BrightnessChange = Annotated[FiniteFloat, QuantityBounds("of 1", -1, 1)]
_PixelNoise = Annotated[FiniteFloat, QuantityBounds("of 255", 0, 128)]
_FieldOfViewChange = Annotated[FiniteFloat, QuantityBounds("degrees", -60, 60)]
_DelayMs = Annotated[FiniteFloat, QuantityBounds("ms", 0, 500)]
_EncoderError = Annotated[FiniteFloat, QuantityBounds("rad", 0, 0.1)]
_GravityErrorShare = Annotated[FiniteFloat, QuantityBounds("of 1", -1, 1)]


class LightRanges(Config):
    """Ranges for the scene's lights, each sampled independently.

    Attributes:
        intensity: range of the factor on a light's colour.
        tint: largest relative deviation of red, green and blue from the factor.
        tilt_deg: largest rotation of a light's direction, degrees; its position turns with it.
        kinds: kind -> its relative probability. A kind replaces the direction and the colour of the first light, see
            `procedural.light_kinds`; if left out, that light varies like the others.
    """

    intensity: FactorRange
    tint: float = Field(default=0.0, ge=0, le=0.5)
    tilt_deg: float = Field(default=0.0, ge=0, le=45)
    kinds: Annotated[dict[LightKind, Positive], Field(min_length=1)] | None = None


class HeadlightRanges(Config):
    """Ranges of the factors on the brightness of the light at the camera, and of the ambient light."""

    diffuse: FactorRange
    ambient: FactorRange


class CameraRanges(Config):
    """Ranges of the scene camera's pose: largest shift along each axis (m) and rotation about each axis (degrees)."""

    position: Annotated[FiniteFloat, QuantityBounds("m", 0, 1)]
    rotation_deg: float = Field(ge=0, le=20)


class SurfaceRanges(Config):
    """Ranges for the appearance of the table, the floor or the walls.

    Attributes:
        saturation, value: ranges of the colours' saturation and value; the hue is arbitrary.
        contrast: range of the difference in `value` between the two colours of a pattern.
        textures: texture of `procedural.textures` -> its relative probability. A checkered floor is made of tiles and
            costs no rendering time; other patterns do, see docs/recording.md.
    """

    saturation: ShareRange
    value: ShareRange
    contrast: ShareRange
    textures: dict[Texture, Positive] = Field(default={"plain": 1.0}, min_length=1)


class LookRanges(Config):
    """Ranges for the appearance of objects.

    Attributes:
        hue_deg: largest change of a colour's hue, degrees.
        saturation, value: ranges of the factors on a colour's saturation and value.
        specular, shininess: ranges of specular reflection and shininess of surfaces.
    """

    hue_deg: float = Field(ge=0, le=180)
    saturation: FactorRange
    value: FactorRange
    specular: ShareRange
    shininess: ShareRange


class Distractors(Config):
    """Objects on the table without a role in the task. Distractors do not move, and nothing touches them.

    Attributes:
        objects: objects to sample from; each is used at most once.
        count: least and largest number of distractors; fewer if no free place is found.
        x, y: ranges of their positions on the table, m.
        clearance: least distance (m) between distractors and, during the whole episode, to everything that moves.
    """

    objects: Annotated[tuple[ObjectConfig, ...], ConfigReference("objects")] = Field(min_length=1, max_length=20)
    count: tuple[Annotated[int, Field(ge=0, le=20)], Annotated[int, Field(ge=0, le=20)]]
    x: WorkspaceRange
    y: WorkspaceRange
    clearance: Annotated[FiniteFloat, QuantityBounds("m", 1e-4, 1)]

    @model_validator(mode="after")
    def _are_rigid(self) -> Distractors:
        for k, item in enumerate(self.objects):
            if item.cloth is not None:
                raise ConflictError(f"{item.name!r} is cloth, but distractors are rigid; give another", ("objects", k))
        return self


class PictureRanges(Config):
    """Ranges of brightness, contrast and noise that are added to rendered images.

    Attributes:
        brightness: offset of every pixel, as a share of the largest value; sampled for each image.
        contrast: factor on the difference from mid grey; sampled for each image.
        noise: standard deviation of Gaussian noise, on a scale of 0..255; sampled for each attempt.
        salt_pepper: share of pixels that turn white or black; sampled for each attempt.
    """

    brightness: Annotated[tuple[_BrightnessChange, _BrightnessChange], AfterValidator(require_ordered)] = (0.0, 0.0)
    contrast: FactorRange = (1.0, 1.0)
    noise: Annotated[tuple[_PixelNoise, _PixelNoise], AfterValidator(require_ordered)] = (0.0, 0.0)
    salt_pepper: ShareRange = (0.0, 0.0)


class ArmRanges(Config):
    """Ranges of dynamics, sampled for each arm and added to the arm's own dynamics.

    Attributes:
        command_delay_ms: delay between a command and its effect.
        sensor_delay_ms: age of the encoders' readings.
        sensor_noise_rad: standard deviation of a joint's reading.
        encoder_step_rad: resolution of the encoders.
        gravity_error: error of the gravity compensation as a factor of a joint's gravity load; sampled for each joint.
    """

    command_delay_ms: Annotated[tuple[_DelayMs, _DelayMs], AfterValidator(require_ordered)] = (0.0, 0.0)
    sensor_delay_ms: Annotated[tuple[_DelayMs, _DelayMs], AfterValidator(require_ordered)] = (0.0, 0.0)
    sensor_noise_rad: Annotated[tuple[_EncoderError, _EncoderError], AfterValidator(require_ordered)] = (0.0, 0.0)
    encoder_step_rad: Annotated[tuple[_EncoderError, _EncoderError], AfterValidator(require_ordered)] = (0.0, 0.0)
    gravity_error: Annotated[tuple[_GravityErrorShare, _GravityErrorShare], AfterValidator(require_ordered)] = (
        0.0,
        0.0,
    )


class RandomizationConfig(Config):
    """Ranges of the values that vary between attempts; a part that is left out does not vary.

    Each part has its own random stream, so that leaving a part out does not change the samples of the others.

    Attributes:
        held_out: whether these looks are only for tests of policies: `record` refuses them. Only such looks may have
            the textures and the kinds of lights in `procedural.textures.HELD_OUT_TEXTURES` and `HELD_OUT_LIGHTS`.
        walls: four walls around the station, which a scene does not have otherwise.
        mass: range of the factor on each object's mass.
        friction: range of the factor on the friction of each object and of the table. Only mass, friction and
            arm_dynamics affect physics.
        lens_deg: range of the change of the scene camera's vertical field of view, degrees.
        arm_dynamics: delays, noise and gravity compensation of arms.
    """

    name: Name = "none"
    held_out: bool = False
    lights: LightRanges | None = None
    headlight: HeadlightRanges | None = None
    mass: FactorRange | None = None
    friction: FactorRange | None = None
    lens_deg: Annotated[tuple[_FieldOfViewChange, _FieldOfViewChange], AfterValidator(require_ordered)] | None = None
    camera: CameraRanges | None = None
    table: SurfaceRanges | None = None
    floor: SurfaceRanges | None = None
    walls: SurfaceRanges | None = None
    objects: LookRanges | None = None
    distractors: Distractors | None = None
    picture: PictureRanges | None = None
    arm_dynamics: ArmRanges | None = None

    @model_validator(mode="after")
    def _held_out_looks_are_marked(self) -> RandomizationConfig:
        surfaces = (part.textures for part in (self.table, self.floor, self.walls) if part)
        used: set[str] = set().union(*surfaces, (self.lights and self.lights.kinds) or ())
        if not self.held_out and (kept := sorted(used & (HELD_OUT_TEXTURES | HELD_OUT_LIGHTS))):
            raise ValueError(f"{', '.join(kept)}: only for looks with held_out: true, so that no recording shows them")
        return self

    @property
    def varied_parts(self) -> tuple[str, ...]:
        """Keys of the parts of this config that are given, and so vary between attempts."""
        keys = (key for key in type(self).model_fields if key not in ("name", "held_out"))
        return tuple(key for key in keys if getattr(self, key) is not None)

    @property
    def distractor_configs(self) -> tuple[ObjectConfig, ...]:
        """The object configs from which distractors are sampled; empty without distractors."""
        return self.distractors.objects if self.distractors else ()
