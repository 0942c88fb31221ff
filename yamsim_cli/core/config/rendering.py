"""Size and rendering quality of recorded images."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat

from ..files.documents.config_base import Config, Name
from ..files.documents.units import QuantityBounds


class ImageConfig(Config):
    """Size (width, height in px) and JPEG quality of recorded images."""

    size_px: tuple[Annotated[int, Field(ge=16, le=4096)], Annotated[int, Field(ge=16, le=4096)]]
    jpeg_quality: int = Field(ge=1, le=100)


SHADOW_REACH = 0.8  # m, default of `RenderConfig.shadow_reach_m`


class RenderConfig(Config):
    """Rendering quality.

    Attributes:
        multisamples: samples per pixel, which smooth edges on a GPU; 0 for none.
        supersampling: factor on width and height of images by OpenGL, which are then averaged. It also smooths edges of
            shadows, and without a GPU costs less than 4 samples per pixel.
        shadow_map_px: edge of the shadow map in texels; 0 for no shadows.
        shadow_lights: number of the scene's lights that cast shadows. Each needs two more renderings of the scene.
        shadow_reach_m: radius of the region with shadows around the middle between an arm's base and the table. A
            smaller radius gives finer shadows.
        smooth_shadows: whether edges of shadows are a mean of nine texels, and not steps of one texel. Applies to one
            light that casts shadows without multisamples, reflections and transparent objects.
        reduced_meshes: whether meshes are shown with fewer faces, see `core.scene.assets.mesh_reduction`.
        reflections: whether surfaces reflect, which needs one more rendering of the scene.
        slices: number of faces around round primitives.
        photo_samples: renderings by MuJoCo's Filament that a colour image averages; 0 for images by OpenGL.
    """

    name: Name = "custom"
    multisamples: Literal[0, 2, 4, 8]
    supersampling: float = Field(ge=1, le=4)
    shadow_map_px: int = Field(ge=0, le=8192)
    shadow_lights: int = Field(ge=0, le=8)
    shadow_reach_m: Annotated[FiniteFloat, QuantityBounds("m", 0.2, 5)] = SHADOW_REACH
    smooth_shadows: bool = False
    reduced_meshes: bool
    reflections: bool
    slices: int = Field(ge=8, le=128, multiple_of=4)
    photo_samples: int = Field(default=0, ge=0, le=64, exclude_if=lambda samples: samples == 0)

    def fine_size(self, size: tuple[int, int]) -> tuple[int, int]:
        """Return width and height (px) at which an image of `size` is rendered before supersampling averages it."""
        return round(size[0] * self.supersampling), round(size[1] * self.supersampling)
