"""Adds a compiled scene's cloths to a viser page: meshes whose points move."""

from __future__ import annotations

import mujoco
import numpy as np
import viser

from ..geometry.se3 import Array


class ClothNodes:
    """A page's cloths, each in the mean colour of its pattern; all their points start at the origin."""

    def __init__(self, scene: viser.SceneApi, model: mujoco.MjModel) -> None:
        self._points = [
            slice(first, first + n) for first, n in zip(model.flex_vertadr, model.flex_vertnum, strict=True)
        ]
        self._nodes = [
            scene.add_mesh_simple(
                f"/cloth/{mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_FLEX, k)}",
                np.zeros((int(model.flex_vertnum[k]), 3)),
                # Points of a cloth are numbered from 0 in each.
                model.flex_elem[model.flex_elemdataadr[k] :][: 3 * model.flex_elemnum[k]].reshape(-1, 3),
                color=_colour(model, int(model.flex_matid[k])),
                side="double",
            )
            for k in range(model.nflex)
        ]

    def show(self, points: Array) -> None:
        """Move all points (nflexvert, 3) in `world`, m; viser does not send what has not changed."""
        for node, own in zip(self._nodes, self._points, strict=True):
            node.vertices = points[own].astype(np.float32)

    def remove(self) -> None:
        """Take them off the page."""
        for node in self._nodes:
            node.remove()


def _colour(model: mujoco.MjModel, material: int) -> tuple[int, int, int]:
    """The mean colour of a material's texture, or its own, from 0 to 255."""
    colour = 255 * model.mat_rgba[material, :3]
    if (texture := int(model.mat_texid[material, mujoco.mjtTextureRole.mjTEXROLE_RGB])) >= 0:
        channels = int(model.tex_nchannel[texture])
        pixels = int(model.tex_height[texture] * model.tex_width[texture])
        drawn = model.tex_data[model.tex_adr[texture] :][: pixels * channels].reshape(-1, channels)
        colour = drawn[:, :3].mean(axis=0)
    red, green, blue = (round(float(part)) for part in colour)
    return red, green, blue
