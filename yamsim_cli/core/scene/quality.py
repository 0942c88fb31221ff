"""Applies a render quality to a composed scene."""

from __future__ import annotations

import mujoco

from ..config.pictures import SHADOW_REACH, RenderConfig


def apply_quality(spec: mujoco.MjSpec, quality: RenderConfig, size: tuple[int, int]) -> None:
    """Set a scene up for rendering with a quality. Which meshes it shows was settled when it was composed.

    Args:
        size: width and height of the pictures, px.
    """
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight = quality.fine_size(size)
    visual.quality.offsamples = quality.multisamples
    visual.quality.shadowsize = quality.shadow_map_px
    # The composed scene has the default reach, and what the distance between its arms adds to it.
    visual.map.shadowclip += quality.shadow_reach_m - SHADOW_REACH
    visual.quality.numslices, visual.quality.numstacks = quality.slices, quality.slices // 2
    for number, light in enumerate(spec.lights):
        light.castshadow = number < quality.shadow_lights
    if not quality.reflections:
        for material in spec.materials:
            material.reflectance = 0
