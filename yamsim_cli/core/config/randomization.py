"""Domain randomization: what may vary from one attempt to the next, and by how much."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field, FiniteFloat, model_validator

from ..documents.base import OMIT_NONE, Config, ConflictError, Name, Positive, Range, Reference, ordered
from ..documents.units import ReachRange, Within
from .things.thing import ObjectConfig


def _positive(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] <= 0:
        raise ValueError(f"factors must be above 0, not {value[0]}")
    return value


def _share(value: tuple[float, float]) -> tuple[float, float]:
    if value[0] < 0 or value[1] > 1:
        raise ValueError(f"must lie in 0..1, not {value[0]}..{value[1]}")
    return value


Factor = Annotated[Range, AfterValidator(_positive)]
Share = Annotated[Range, AfterValidator(_share)]
_Brightness = Annotated[FiniteFloat, Within("of 1", -1, 1)]
_Noise = Annotated[FiniteFloat, Within("of 255", 0, 128)]
_Lens = Annotated[FiniteFloat, Within("degrees", -60, 60)]
_Delay = Annotated[FiniteFloat, Within("ms", 0, 500)]
_Reading = Annotated[FiniteFloat, Within("rad", 0, 0.1)]
_Gravity = Annotated[FiniteFloat, Within("of 1", -1, 1)]
Texture = Literal["plain", "checker", "gradient", "noise"]


class LightRanges(Config):
    """The scene's lights, each sampled independently.

    Attributes:
        intensity: range of the factor on a light's colour.
        tint: by what share each of red, green and blue may differ from that factor.
        tilt_deg: by how much a light's direction may turn, degrees; its position turns with it.
    """

    intensity: Factor
    tint: float = Field(default=0.0, ge=0, le=0.5)
    tilt_deg: float = Field(default=0.0, ge=0, le=45)


class HeadlightRanges(Config):
    """Ranges of the factors on the light that the camera itself sheds, and on the light from all around."""

    diffuse: Factor
    ambient: Factor


class CameraRanges(Config):
    """The scene camera's pose: how far it may be off along each axis (m), and turned about each axis (degrees)."""

    position: Annotated[FiniteFloat, Within("m", 0, 1)]
    rotation_deg: float = Field(ge=0, le=20)


class SurfaceRanges(Config):
    """The looks of the table or the floor.

    Attributes:
        saturation, value: ranges of its colours' saturation and value; the hue may be any.
        contrast: by how much a pattern's second colour is lighter or darker than the first, in `value`.
        textures: texture -> its weight: how likely it is beside the others. A checkered floor is made of tiles and
            costs nothing. Other patterns are looked up for every pixel, see docs/recording.md for the cost.
    """

    saturation: Share
    value: Share
    contrast: Share
    textures: dict[Texture, Positive] = Field(default={"plain": 1.0}, min_length=1)


class LookRanges(Config):
    """The objects' looks.

    Attributes:
        hue_deg: by how much a colour's hue may turn either way, degrees.
        saturation, value: ranges of the factors on a colour's saturation and value.
        specular, shininess: ranges of these properties of an object's surface.
    """

    hue_deg: float = Field(ge=0, le=180)
    saturation: Factor
    value: Factor
    specular: Share
    shininess: Share


class Distractors(Config):
    """Objects that stand on the table and have no part in the task. They do not move, and nothing ever touches them.

    Attributes:
        objects: the objects to choose from; each is chosen at most once.
        count: how many stand there at least and at most. There are fewer where no free place is found.
        x, y: where on the table they may stand, m.
        clearance: smallest distance (m) to everything that moves, during the whole episode, and to each other.
    """

    objects: Annotated[tuple[ObjectConfig, ...], Reference("objects")] = Field(min_length=1, max_length=20)
    count: tuple[Annotated[int, Field(ge=0, le=20)], Annotated[int, Field(ge=0, le=20)]]
    x: ReachRange
    y: ReachRange
    clearance: Annotated[FiniteFloat, Within("m", 1e-4, 1)]

    @model_validator(mode="after")
    def _are_stiff(self) -> Distractors:
        for k, item in enumerate(self.objects):
            if item.cloth is not None:
                raise ConflictError(f"{item.name!r} is cloth, and distractors are stiff; take another", ("objects", k))
        return self


class PictureRanges(Config):
    """What a camera and its cable do to a picture.

    Attributes:
        brightness: what is added to every pixel, as a share of the largest value; sampled for each picture.
        contrast: factor on the difference from mid grey; sampled for each picture.
        noise: standard deviation of Gaussian noise, of 255; sampled for each attempt.
        salt_pepper: share of pixels that turn white or black; sampled for each attempt.
    """

    brightness: Annotated[tuple[_Brightness, _Brightness], AfterValidator(ordered)] = (0.0, 0.0)
    contrast: Factor = (1.0, 1.0)
    noise: Annotated[tuple[_Noise, _Noise], AfterValidator(ordered)] = (0.0, 0.0)
    salt_pepper: Share = (0.0, 0.0)


class ArmRanges(Config):
    """How arms act and are read, drawn for each arm; each draw is added to what the arm's own dynamics say.

    Attributes:
        command_delay_ms: how much later commands act.
        sensor_delay_ms: how much older what encoders read is.
        sensor_noise_rad: standard deviation of what a joint reads.
        encoder_step_rad: between two values that an encoder can read.
        gravity_error: by how many times a joint's weight its gravity compensation gives too much; drawn for each joint.
    """

    command_delay_ms: Annotated[tuple[_Delay, _Delay], AfterValidator(ordered)] = (0.0, 0.0)
    sensor_delay_ms: Annotated[tuple[_Delay, _Delay], AfterValidator(ordered)] = (0.0, 0.0)
    sensor_noise_rad: Annotated[tuple[_Reading, _Reading], AfterValidator(ordered)] = (0.0, 0.0)
    encoder_step_rad: Annotated[tuple[_Reading, _Reading], AfterValidator(ordered)] = (0.0, 0.0)
    gravity_error: Annotated[tuple[_Gravity, _Gravity], AfterValidator(ordered)] = (0.0, 0.0)


class RandomizationConfig(Config):
    """What varies between attempts, and by how much; a part that is left out does not vary.

    Each part samples from a random stream of its own, so that leaving one out does not change the others.

    Attributes:
        mass: range of the factor on each object's mass.
        friction: range of the factor on the friction of each object and of the table. Of all parts only mass, friction
            and arm_dynamics act in physics.
        lens_deg: range of what is added to the scene camera's field of view, degrees.
        arm_dynamics: how late arms act, how they are read, and how their gravity compensation errs. Older configs do
            not say it.
    """

    name: Name = "none"
    lights: LightRanges | None = None
    headlight: HeadlightRanges | None = None
    mass: Factor | None = None
    friction: Factor | None = None
    lens_deg: Annotated[tuple[_Lens, _Lens], AfterValidator(ordered)] | None = None
    camera: CameraRanges | None = None
    table: SurfaceRanges | None = None
    floor: SurfaceRanges | None = None
    objects: LookRanges | None = None
    distractors: Distractors | None = None
    picture: PictureRanges | None = None
    arm_dynamics: Annotated[ArmRanges | None, OMIT_NONE] = None

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the parts that vary."""
        return tuple(key for key in type(self).model_fields if key != "name" and getattr(self, key) is not None)

    @property
    def extras(self) -> tuple[ObjectConfig, ...]:
        """The distractors to choose from."""
        return self.distractors.objects if self.distractors else ()
