"""What a quality asks of a composed scene."""

from __future__ import annotations

import mujoco

from ..config.record import SHADOW_REACH, RenderConfig


def apply_quality(spec: mujoco.MjSpec, quality: RenderConfig, size: tuple[int, int]) -> None:
    """Let a scene be drawn with a quality; which meshes it shows was settled when it was composed.

    Args:
        size: width and height of the pictures, px.
    """
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight = quality.fine_size(size)
    visual.quality.offsamples = quality.multisamples
    visual.quality.shadowsize = quality.shadow_map_px
    # A scene is composed with the usual reach, and what its arms' distance adds to it.
    visual.map.shadowclip += quality.shadow_reach_m - SHADOW_REACH
    visual.quality.numslices, visual.quality.numstacks = quality.slices, quality.slices // 2
    for number, light in enumerate(spec.lights):
        light.castshadow = number < quality.shadow_lights
    if not quality.reflections:
        for material in spec.materials:
            material.reflectance = 0
