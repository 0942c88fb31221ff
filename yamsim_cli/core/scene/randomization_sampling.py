from __future__ import annotations

import colorsys
import math
from collections.abc import Mapping, Sequence

import numpy as np

from ..attempt_data import AttemptJob
from ..config.objects.object_config import ObjectConfig
from ..config.randomization import ArmRanges, LightRanges, LookRanges, RandomizationConfig, SurfaceRanges, Texture
from ..config.variation import AppearanceSample, ArmDynamicsSample, LightSample, RandomizationSample, SurfaceSample
from .random_streams import Stream, random_generator

_PATTERN_REPEATS = (2, 9)  # half-open range of a pattern's repetitions along each edge of a surface
_SEEDS = 2**31
_PHYSICAL = (Stream.MASS, Stream.FRICTION, Stream.ARMS)  # streams that do not depend on the look
TABLE = "table"  # key in `RandomizationSample.friction`, whose other keys are objects


def sample_randomization(
    config: RandomizationConfig,
    job: AttemptJob,
    lights: int,
    objects: Sequence[ObjectConfig],
    dofs: Sequence[int],
    look: int = 0,
) -> RandomizationSample:
    """Sample an attempt's variation without distractors, which `sim.placement` places when the motion is known.

    `lights` and `dofs` are the numbers of lights and of each arm's joints. `look` affects all parts but the physical.
    """

    def rng(stream: Stream) -> np.random.Generator:
        return random_generator(job if stream in _PHYSICAL else job.for_look(look), stream)

    def uniform(stream: Stream, low: float, high: float) -> float:
        return float(rng(stream).uniform(low, high))

    # Mass and friction of cloth do not vary.
    names = [item.name for item in objects if item.cloth is None]
    picture, camera, headlight = config.picture, config.camera, config.headlight
    return RandomizationSample(
        lights=_sample_lights(config.lights, lights, rng(Stream.LIGHTS)) if config.lights else (),
        headlight=_sample_pair(headlight.diffuse, headlight.ambient, rng(Stream.HEADLIGHT)) if headlight else None,
        mass=_sample_factors(config.mass, names, rng(Stream.MASS)),
        friction=_sample_factors(config.friction, [*names, TABLE], rng(Stream.FRICTION)),
        lens_deg=uniform(Stream.LENS, *config.lens_deg) if config.lens_deg else None,
        camera=_sample_offset(camera.position, math.radians(camera.rotation_deg), rng(Stream.CAMERA))
        if camera
        else None,
        table=_sample_surface(config.table, rng(Stream.TABLE)) if config.table else None,
        floor=_sample_surface(config.floor, rng(Stream.FLOOR)) if config.floor else None,
        looks=_sample_looks(config.objects, (*objects, *config.distractor_configs), rng(Stream.APPEARANCE))
        if config.objects
        else {},
        noise=uniform(Stream.NOISE, *picture.noise) if picture else None,
        salt_pepper=uniform(Stream.SALT_PEPPER, *picture.salt_pepper) if picture else None,
        arm_dynamics=_sample_arms(config.arm_dynamics, dofs, rng(Stream.ARMS)) if config.arm_dynamics else (),
    )


def _sample_pair(
    first: tuple[float, float], second: tuple[float, float], rng: np.random.Generator
) -> tuple[float, float]:
    return float(rng.uniform(*first)), float(rng.uniform(*second))


def _sample_factors(
    limits: tuple[float, float] | None, names: Sequence[str], rng: np.random.Generator
) -> dict[str, float]:
    """Sample a factor for each name, log-uniform between the limits."""
    if limits is None:
        return {}
    low, high = math.log(limits[0]), math.log(limits[1])
    return {name: math.exp(float(rng.uniform(low, high))) for name in names}


def _sample_lights(ranges: LightRanges, count: int, rng: np.random.Generator) -> tuple[LightSample, ...]:
    sampled = []
    for _ in range(count):
        intensity = float(rng.uniform(*ranges.intensity))
        r, g, b = (intensity * (1 + float(part)) for part in rng.uniform(-ranges.tint, ranges.tint, 3))
        axis = rng.normal(size=3)
        angle = math.radians(ranges.tilt_deg) * math.sqrt(float(rng.uniform()))
        x, y, z = (float(part) for part in angle * axis / np.linalg.norm(axis))
        sampled.append(LightSample((r, g, b), (x, y, z)))
    return tuple(sampled)


def _sample_arms(ranges: ArmRanges, dofs: Sequence[int], rng: np.random.Generator) -> tuple[ArmDynamicsSample, ...]:
    drawn = []
    for dof in dofs:
        delays = float(rng.uniform(*ranges.command_delay_ms)), float(rng.uniform(*ranges.sensor_delay_ms))
        reads = float(rng.uniform(*ranges.sensor_noise_rad)), float(rng.uniform(*ranges.encoder_step_rad))
        gravity = tuple(float(part) for part in rng.uniform(*ranges.gravity_error, dof))
        drawn.append(ArmDynamicsSample(*delays, *reads, gravity))
    return tuple(drawn)


def _sample_offset(
    shift: float, turn: float, rng: np.random.Generator
) -> tuple[float, float, float, float, float, float]:
    x, y, z = (float(part) for part in rng.uniform(-shift, shift, 3))
    a, b, c = (float(part) for part in rng.uniform(-turn, turn, 3))
    return x, y, z, a, b, c


def _sample_surface(ranges: SurfaceRanges, rng: np.random.Generator) -> SurfaceSample:
    texture = _weighted_choice(ranges.textures, float(rng.uniform()))
    hue, saturation, value = float(rng.uniform()), float(rng.uniform(*ranges.saturation)), rng.uniform(*ranges.value)
    contrast = float(rng.uniform(*ranges.contrast))
    other = value - contrast if value > 0.5 else value + contrast
    first, second = (colorsys.hsv_to_rgb(hue, saturation, float(np.clip(v, 0, 1))) for v in (value, other))
    colours = (first, first) if texture == "plain" else (first, second)
    return SurfaceSample(texture, colours, int(rng.integers(*_PATTERN_REPEATS)), int(rng.integers(_SEEDS)))


def _weighted_choice(weights: Mapping[Texture, float], share: float) -> Texture:
    """Return the name at a share (0 to 1) of the weights, summed up in alphabetical order."""
    rest = share * sum(weights.values())
    for name in sorted(weights):
        if rest < weights[name]:
            return name
        rest -= weights[name]
    return max(weights)


def _sample_looks(
    ranges: LookRanges, objects: Sequence[ObjectConfig], rng: np.random.Generator
) -> dict[str, AppearanceSample]:
    looks = {}
    for item in objects:
        hue, saturation, value = colorsys.rgb_to_hsv(*item.mesh.rgba[:3])
        hue += float(rng.uniform(-ranges.hue_deg, ranges.hue_deg)) / 360
        saturation *= float(rng.uniform(*ranges.saturation))
        value *= float(rng.uniform(*ranges.value))
        rgb = colorsys.hsv_to_rgb(hue % 1.0, min(1.0, saturation), min(1.0, value))
        looks[item.name] = AppearanceSample(
            rgb, float(rng.uniform(*ranges.specular)), float(rng.uniform(*ranges.shininess))
        )
    return looks
