"""What recorded pictures are, and what rendering them may cost."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat

from ..documents.base import Config, Name, omit_default
from ..documents.units import Within


class ImageConfig(Config):
    """Size in pixels (width, height) and JPEG quality of recorded images."""

    size_px: tuple[Annotated[int, Field(ge=16, le=4096)], Annotated[int, Field(ge=16, le=4096)]]
    jpeg_quality: int = Field(ge=1, le=100)


# How far shadows reach unless a quality says otherwise, m.
SHADOW_REACH = 0.8


class RenderConfig(Config):
    """A quality: how good pictures are, and so what they cost.

    Attributes:
        multisamples: samples a pixel, which smooth edges on a GPU; 0 for none.
        supersampling: pictures are rendered this many times as wide and high, and averaged. That smooths the edges of
            shadows too, and costs less without a GPU than 4 samples a pixel do.
        shadow_map_px: edge of the shadow map in texels; 0 for no shadows.
        shadow_lights: how many of the scene's lights cast shadows, the first ones first. Each renders everything twice
            more.
        shadow_reach_m: how far from the middle of an arm's base and table shadows reach: the nearer, the finer they are
            rendered, and what stands farther off casts none.
        reduced_meshes: show meshes with fewer faces where they are to be had, see `core.assets.reduction`.
        reflections: let what reflects reflect: it renders everything once more.
        slices: faces around what is round, where it is shown as a primitive.
    """

    name: Name = "custom"
    multisamples: Literal[0, 2, 4, 8]
    supersampling: float = Field(ge=1, le=4)
    shadow_map_px: int = Field(ge=0, le=8192)
    shadow_lights: int = Field(ge=0, le=8)
    shadow_reach_m: Annotated[FiniteFloat, Within("m", 0.2, 5), omit_default(SHADOW_REACH)] = SHADOW_REACH
    reduced_meshes: bool
    reflections: bool
    slices: int = Field(ge=8, le=128, multiple_of=4)

    def fine_size(self, size: tuple[int, int]) -> tuple[int, int]:
        """Width and height (px) in which pictures of a size are rendered."""
        return round(size[0] * self.supersampling), round(size[1] * self.supersampling)
