"""How one attempt differs from another beside where things start: plain frozen data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class LightVariation:
    """How one light differs: factors on red, green and blue, and the turn (3,) of its direction, rad."""

    colour: tuple[float, float, float]
    turn: tuple[float, float, float]


@dataclass(frozen=True)
class SurfaceVariation:
    """The look of a surface: a pattern of two colours (RGB, 0..1), how often it repeats, and its noise's seed."""

    texture: str
    colours: tuple[tuple[float, float, float], tuple[float, float, float]]
    repeat: int
    seed: int


@dataclass(frozen=True)
class LookVariation:
    """The look of an object: its colour (RGB, 0..1) and its shine."""

    rgb: tuple[float, float, float]
    specular: float
    shininess: float


@dataclass(frozen=True)
class ArmVariation:
    """What is added to how one arm acts and is read, see `config.randomization.ArmRanges`; `gravity` has each joint."""

    command_delay_ms: float
    sensor_delay_ms: float
    sensor_noise_rad: float
    encoder_step_rad: float
    gravity: tuple[float, ...]


@dataclass(frozen=True)
class Variation:
    """What was sampled for one attempt from the ranges of a randomization; records keep it, key by key.

    A part that does not vary is empty or None.

    Attributes:
        headlight: factors on the light that the camera sheds, and on the light from everywhere.
        mass, friction: body -> factor.
        lens_deg: added to the scene camera's field of view.
        camera: shift (m) and turn (rad) of the scene camera, along and about the axes of `world`.
        looks: object -> its look.
        distractors: object -> where it stands, `[x, y, z, yaw]` in `world`, m and rad.
        noise, salt_pepper: of the pictures; see `config.randomization.PictureRanges`.
        arm_dynamics: of the scene's arms, in its order.
    """

    lights: tuple[LightVariation, ...] = ()
    headlight: tuple[float, float] | None = None
    mass: Mapping[str, float] = field(default_factory=dict)
    friction: Mapping[str, float] = field(default_factory=dict)
    lens_deg: float | None = None
    camera: tuple[float, float, float, float, float, float] | None = None
    table: SurfaceVariation | None = None
    floor: SurfaceVariation | None = None
    looks: Mapping[str, LookVariation] = field(default_factory=dict)
    distractors: Mapping[str, tuple[float, float, float, float]] = field(default_factory=dict)
    noise: float | None = None
    salt_pepper: float | None = None
    arm_dynamics: tuple[ArmVariation, ...] = ()
