"""The config of a drawn dataset: the source's config with other images and the same physics."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import ValidationError

from ..core.config.recording import DrawnFrom, RecordConfig
from ..core.config.rig import RigCamera, RigConfig
from ..core.config.scene import SceneConfig
from ..core.config.variation import PHYSICS_PARTS
from ..core.errors import UsageError
from ..core.files.documents.units import SKIP_BOUNDS_CONTEXT
from ..core.geometry.se3 import quat_from_rotation

_ELEVATION = (15.0, 75.0)  # degrees above the horizontal, of random views: lower ones see mostly the floor and the sky
_DISTANCE = (0.6, 1.3)  # of the scene camera's distance; nearer views cut off the arm
_FOVY = (40.0, 65.0)  # degrees, of random views; the D405 has 58
_TARGET_SHIFT = 0.05  # m along each axis, by which the target of a random view differs from the scene camera's
_DIGITS = 6  # decimal places of a random view's figures: 1 um
_VIEWS_STREAM = 1001  # separates the seeds of views from the seeds of attempts, whose second number is an attempt


@dataclass(frozen=True)
class DrawChanges:
    """What a drawn dataset changes.

    Attributes:
        values: keys of the record config -> new values.
        cameras: names of the cameras to draw; None for the source's cameras.
        views: number of random views, in addition.
        fixed_cameras: further cameras, in addition.
        look: number of the look; None to keep the source's look.
    """

    values: Mapping[str, Any]
    cameras: Sequence[str] | None = None
    views: int = 0
    fixed_cameras: Sequence[RigCamera] = ()
    look: int | None = None


def draw_config(source: RecordConfig, config_sha256: str, changes: DrawChanges) -> RecordConfig:
    """Return the config of a drawn dataset. `config_sha256` is the hash of the source's config.

    Raises UsageError if a change would affect physics, or contradicts the rest of the config.
    """
    values = dict(changes.values)
    if (scene := values.get("scene")) is not None:
        _require_same_surfaces(source.scene, scene)
    look = source.look if changes.look is None else changes.look
    if (ranges := values.get("randomization")) is not None:
        physics = {part: getattr(source.randomization, part) for part in PHYSICS_PARTS}
        values["randomization"] = ranges.model_copy(update=physics)
    rig = values.get("rig", source.rig)
    physical = source.drawn.rig if source.drawn and source.drawn.rig else None
    if rig.arms != source.rig.arms:
        _require_same_joints(source.rig, rig)
        physical = physical or source.rig
    scene = values.get("scene", source.scene)
    added = (*changes.fixed_cameras, *_random_views(scene, rig, source.seed, look, changes.views))
    if added:
        rig = rig.model_copy(update={"cameras": (*rig.cameras, *added)})
    if source.cameras == ():  # recorded with --no-images
        source = source.model_copy(update={"cameras": None})
    if changes.cameras or added:
        first = tuple(changes.cameras or source.recorded_cameras)
        values["cameras"] = (*first, *(camera.name for camera in added if camera.name not in first))
    drawn = DrawnFrom(config_sha256=config_sha256, rig=physical)
    fields = {name: getattr(source, name) for name in RecordConfig.model_fields}
    try:
        return RecordConfig.model_validate(
            fields | values | {"rig": rig, "look": look, "drawn": drawn, "meshes": None}, context=SKIP_BOUNDS_CONTEXT
        )
    except ValidationError as error:
        first_error = error.errors(include_url=False)[0]
        raise UsageError(str(first_error.get("ctx", {}).get("error", first_error["msg"]))) from None


def _require_same_surfaces(source: SceneConfig, scene: SceneConfig) -> None:
    def physics_of(config: SceneConfig) -> tuple[Any, ...]:
        table = config.table
        return config.safety_plane, table and (table.position, table.half_size, table.contact)

    if physics_of(scene) != physics_of(source):
        raise UsageError(
            f"--scene {scene.name}: its table or safety_plane differs from scene {source.name!r}, with which "
            "the states were recorded; give a scene with the same `table.position`, `half_size`, `contact` and "
            "`safety_plane`"
        )


def _require_same_joints(source: RigConfig, rig: RigConfig) -> None:
    def joints_of(config: RigConfig) -> list[tuple[Any, ...]]:
        return [
            (arm.side, arm.prefix, arm.base, arm.robot.joint_names, arm.robot.fingers is None) for arm in config.arms
        ]

    if joints_of(rig) != joints_of(source) or rig.margin != source.margin:
        raise UsageError(
            f"rig {rig.name!r} cannot show states of rig {source.name!r}: its arms have other joints, sides or bases; "
            "give a rig with the same arms, such as another --revision"
        )


def _random_views(scene: SceneConfig, rig: RigConfig, seed: int, look: int, count: int) -> tuple[RigCamera, ...]:
    """Return cameras around the point that the scene camera looks at; equal seeds and looks give equal views."""
    camera = scene.widened_for_arm_distance(rig.arm_span).scene_camera
    assert camera is not None  # every recorded scene has one
    rng = np.random.default_rng([seed, _VIEWS_STREAM, look])
    usual = math.dist(camera.position, camera.look_at)
    return tuple(_random_view(f"view_{k:02d}", np.array(camera.look_at), usual, rng) for k in range(count))


def _random_view(name: str, target: np.ndarray[Any, Any], usual: float, rng: np.random.Generator) -> RigCamera:
    target = target + rng.uniform(-_TARGET_SHIFT, _TARGET_SHIFT, 3)
    azimuth = rng.uniform(-math.pi, math.pi)
    # Even on the sphere between the two elevations.
    height = rng.uniform(*np.sin(np.radians(_ELEVATION)))
    across = math.sqrt(1 - height**2)
    away = np.array([across * math.cos(azimuth), across * math.sin(azimuth), height])
    right = np.array([-math.sin(azimuth), math.cos(azimuth), 0.0])
    R = np.column_stack([right, np.cross(-away, right), -away])
    place = target + rng.uniform(*_DISTANCE) * usual * away
    x, y, z = (round(float(part), _DIGITS) for part in place)
    qw, qx, qy, qz = (round(float(part), _DIGITS) for part in quat_from_rotation(R))
    fovy = round(float(rng.uniform(*_FOVY)), 3)
    return RigCamera(name=name, position=(x, y, z), quat=(qw, qx, qy, qz), fovy_deg=fovy)


def varies_in_looks(config: RecordConfig, views: int) -> bool:
    """Return whether two looks of a config would differ: by random views, or by randomization of appearance."""
    return views > 0 or not set(config.randomization.varied_parts) <= set(PHYSICS_PARTS)
