"""Scenes: the table, the lights and the fixed cameras."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import Field, model_validator

from ...scene_photos.embedded_photos import PhotoText, Plate
from ..files.documents.config_base import Config, ConflictError, Name, Rgb, Rgba, Vector
from ..files.documents.units import FieldOfView, Place, PlacePoint, Size
from .objects.object_config import Contact


class Table(Config):
    """The work surface, a box: centre and half-size (m), and the share of light that the surface reflects.

    `photo` shows its surface from above as base64 text, with +x to the right and +y up; see `scene_photos`.
    """

    position: PlacePoint
    half_size: tuple[Size, Size, Size]
    rgba: Rgba
    reflectance: float = Field(default=0.0, ge=0, le=1)
    photo: PhotoText | None = None
    contact: Contact = Contact()

    @property
    def top_height(self) -> float:
        """Height of the surface in `world`, m."""
        return self.position[2] + self.half_size[2]

    def widen(self, by: float) -> Table:
        """Return the table with its full width along world y increased by `by` metres."""
        x, y, z = self.half_size
        return self.model_copy(update={"half_size": (x, y + by / 2, z)})

    def covering(self, x: tuple[float, float], y: tuple[float, float]) -> Table:
        """Return the table, enlarged where needed so that it covers two ranges in `world`, m."""
        position, half_size = list(self.position), list(self.half_size)
        for k, wanted in enumerate((x, y)):
            present = (position[k] - half_size[k], position[k] + half_size[k])
            low, high = min(wanted[0], present[0]), max(wanted[1], present[1])
            if (low, high) != present:
                position[k], half_size[k] = (low + high) / 2, (high - low) / 2
        return self.model_copy(update={"position": tuple(position), "half_size": tuple(half_size)})


class Light(Config):
    """A directional light.

    Attributes:
        direction: direction in which the light shines.
        castshadow: whether the light casts shadows in other programs. In yamsim's images, the quality determines the
            number of lights that cast shadows.
    """

    direction: Vector
    diffuse: Rgb
    specular: Rgb = (0.2, 0.2, 0.2)
    castshadow: bool = False


_CAMERA_SHIFT_PER_SPAN = 0.5  # m of backward shift of the scene camera for each m between two arms


class FixedCamera(Config):
    """A camera in `world`: its position and the point in the middle of its image, m; `up` is by default world up."""

    position: PlacePoint
    look_at: PlacePoint
    fovy_deg: Annotated[FieldOfView, Field(gt=1, lt=179)]
    up: Vector | None = None

    @model_validator(mode="after")
    def _not_along_up(self) -> FixedCamera:
        if math.dist(self.position, self.look_at) < 1e-6:
            raise ValueError("position and look_at are the same point")
        return self

    def move_back(self, by: float) -> FixedCamera:
        """Return the camera, `by` metres farther from `look_at`."""
        away = 1 + by / math.dist(self.position, self.look_at)
        x, y, z = (at + away * (p - at) for p, at in zip(self.position, self.look_at, strict=True))
        return self.model_copy(update={"position": (x, y, z)})


class SceneConfig(Config):
    """The surroundings of the arms: table, floor, sky, lights and a fixed camera.

    Attributes:
        table: the work surface; if left out, the rig stands on the floor.
        safety_plane: height of the floor in `world`, m.
        floor_rgba: the two colours of the floor's tiles.
        sky: the two colours of the sky's gradient.
        ambient: colour of the ambient light.
        scene_camera: the fixed camera that recordings use.
        plates: photos behind the arms and objects in images of fixed cameras, as `yamsim match` writes them.
    """

    name: Name
    table: Table | None = None
    safety_plane: Place
    floor_rgba: tuple[Rgb, Rgb]
    sky: tuple[Rgb, Rgb]
    ambient: Rgb
    lights: tuple[Light, ...] = Field(min_length=1)
    scene_camera: FixedCamera | None = None
    plates: tuple[Plate, ...] = ()

    @model_validator(mode="after")
    def _plane_below_table(self) -> SceneConfig:
        if self.table and self.safety_plane >= self.table.top_height:
            raise ConflictError(
                f"safety_plane {self.safety_plane} m must lie below the table's top at {self.table.top_height} m",
                ("safety_plane",),
                ("table",),
            )
        return self

    def widened_for_arm_distance(self, span: float) -> SceneConfig:
        """Return the scene for arms `span` metres apart: with a wider table, and a scene camera that sees the table."""
        if not span:
            return self
        return self.model_copy(
            update={
                "table": self.table and self.table.widen(span),
                "scene_camera": self.scene_camera and self.scene_camera.move_back(_CAMERA_SHIFT_PER_SPAN * span),
            }
        )
