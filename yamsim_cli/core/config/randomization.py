"""Domain randomization: what may differ from one episode to the next, and by how much."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, Field, FiniteFloat

from .base import Config, Name, Positive, Range, Reference, ordered
from .things import ObjectConfig
from .units import ReachRange, Within


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
Texture = Literal["plain", "checker", "gradient", "noise"]


class LightRanges(Config):
    """The scene's lights, each drawn on its own.

    Attributes:
        intensity: by which a light's colour is multiplied.
        tint: by how much each of red, green and blue may differ from that, as a share.
        tilt_deg: by how much a light's direction may turn, degrees; where it shines from turns with it.
    """

    intensity: Factor
    tint: float = Field(default=0.0, ge=0, le=0.5)
    tilt_deg: float = Field(default=0.0, ge=0, le=45)


class HeadlightRanges(Config):
    """What the camera itself sheds, and what comes from everywhere, as factors."""

    diffuse: Factor
    ambient: Factor


class CameraRanges(Config):
    """Where the scene camera stands: it may be off by so much along each axis (m), and turned about each (degrees)."""

    position: Annotated[FiniteFloat, Within("m", 0, 1)]
    rotation_deg: float = Field(ge=0, le=20)


class SurfaceRanges(Config):
    """The looks of the table or the floor.

    Attributes:
        saturation, value: of its colours; their hue is any.
        contrast: how much lighter or darker the second colour of a pattern is, in `value`.
        textures: how likely each is, in any unit. A checkered floor is its tiles and costs nothing. Other patterns are
            textures, and a look-up for every pixel: see docs/recording.md for its cost.
    """

    saturation: Share
    value: Share
    contrast: Share
    textures: dict[Texture, Positive] = Field(default={"plain": 1.0}, min_length=1)


class LookRanges(Config):
    """The objects' looks.

    Attributes:
        hue_deg: by which a colour's hue may turn either way, degrees.
        saturation, value: by which a colour's saturation and value are multiplied.
        specular, shininess: of their surface.
    """

    hue_deg: float = Field(ge=0, le=180)
    saturation: Factor
    value: Factor
    specular: Share
    shininess: Share


class Distractors(Config):
    """Objects that stand about and have nothing to do with the task. They stand fixed, and nothing ever touches them.

    Attributes:
        objects: of which some are drawn, each at most once.
        count: how many, at least and at most; fewer where no free place is found.
        x, y: where on the table, m.
        clearance: least distance (m) to everything that moves, during the whole episode, and to each other.
    """

    objects: Annotated[tuple[ObjectConfig, ...], Reference("objects")] = Field(min_length=1, max_length=20)
    count: tuple[Annotated[int, Field(ge=0, le=20)], Annotated[int, Field(ge=0, le=20)]]
    x: ReachRange
    y: ReachRange
    clearance: Annotated[FiniteFloat, Within("m", 1e-4, 1)]


class PictureRanges(Config):
    """What a camera and its cable do to a picture.

    Attributes:
        brightness: added, as a share of the largest value; drawn for each picture.
        contrast: factor about the middle; drawn for each picture.
        noise: standard deviation of Gaussian noise, of 255; drawn for each episode.
        salt_pepper: share of pixels that are white or black; drawn for each episode.
    """

    brightness: Annotated[tuple[_Brightness, _Brightness], AfterValidator(ordered)] = (0.0, 0.0)
    contrast: Factor = (1.0, 1.0)
    noise: Annotated[tuple[_Noise, _Noise], AfterValidator(ordered)] = (0.0, 0.0)
    salt_pepper: Share = (0.0, 0.0)


class RandomizationConfig(Config):
    """What is randomized. Each part draws from a stream of its own: leaving one out changes none of the others' draws.

    Attributes:
        mass, friction: factors for each object, and for friction the table; alone among all parts they act in physics.
        lens_deg: added to the scene camera's field of view, degrees.
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

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of the parts that are randomized."""
        return tuple(key for key in type(self).model_fields if key != "name" and getattr(self, key) is not None)

    @property
    def extras(self) -> tuple[ObjectConfig, ...]:
        """The objects that may stand about."""
        return self.distractors.objects if self.distractors else ()
