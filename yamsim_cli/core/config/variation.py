"""Samples of the domain randomization of one attempt, as immutable dataclasses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from pydantic import Field

from ...disturbances.config import PushSample


@dataclass(frozen=True)
class LightSample:
    """Factors on a light's red, green and blue, and the rotation vector (3,) of its direction, rad."""

    colour: tuple[float, float, float]
    turn: tuple[float, float, float]


@dataclass(frozen=True)
class SurfaceSample:
    """Texture of a surface: two colours (RGB, 0..1), repetitions along each edge, and the seed of its noise."""

    texture: str
    colours: tuple[tuple[float, float, float], tuple[float, float, float]]
    repeat: int
    seed: int


@dataclass(frozen=True)
class AppearanceSample:
    """Appearance of an object: colour (RGB, 0..1), specular reflection and shininess."""

    rgb: tuple[float, float, float]
    specular: float
    shininess: float


@dataclass(frozen=True)
class ArmDynamicsSample:
    """Values added to one arm's dynamics; `gravity`: error of gravity compensation per joint, as share of its load."""

    command_delay_ms: float
    sensor_delay_ms: float
    sensor_noise_rad: float
    encoder_step_rad: float
    gravity: tuple[float, ...]


PHYSICS_PARTS = ("mass", "friction", "arm_dynamics")  # parts of a randomization that affect more than images


@dataclass(frozen=True)
class RandomizationSample:
    """The samples of one attempt from the ranges of a randomization; a part that does not vary is empty or None.

    Attributes:
        headlight: factors on the camera's headlight and on the ambient light.
        mass, friction: body -> factor.
        lens_deg: change of the scene camera's vertical field of view, degrees.
        camera: shift (m) and rotation (rad) of the scene camera, along and about the axes of `world`.
        looks: object -> its appearance.
        distractors: object -> its pose `[x, y, z, yaw]` in `world`, m and rad.
        noise, salt_pepper: standard deviation of image noise (0..255); share of pixels that turn white or black.
        arm_dynamics: samples for each arm, in the order of arms in the compiled scene.
    """

    lights: tuple[LightSample, ...] = ()
    headlight: tuple[float, float] | None = None
    mass: Mapping[str, float] = field(default_factory=dict)
    friction: Mapping[str, float] = field(default_factory=dict)
    lens_deg: float | None = None
    camera: tuple[float, float, float, float, float, float] | None = None
    table: SurfaceSample | None = None
    floor: SurfaceSample | None = None
    looks: Mapping[str, AppearanceSample] = field(default_factory=dict)
    distractors: Mapping[str, tuple[float, float, float, float]] = field(default_factory=dict)
    noise: float | None = None
    salt_pepper: float | None = None
    arm_dynamics: tuple[ArmDynamicsSample, ...] = ()
    # Left out of records without walls, whose bytes stay the same.
    walls: Annotated[SurfaceSample | None, Field(exclude_if=lambda walls: walls is None)] = None
    pushes: Annotated[tuple[PushSample, ...], Field(exclude_if=lambda pushes: not pushes)] = ()  # see `--disturb`
