"""Silhouettes of a mesh from all sides."""

from __future__ import annotations

import mujoco
import numpy as np

DIRECTIONS = 12
PIXELS = 512


def _directions() -> np.ndarray:
    """Unit vectors (n, 3), spread evenly over half a sphere: opposite sides have the same outline."""
    k = np.arange(DIRECTIONS) + 0.5
    z, angle = 1 - k / DIRECTIONS, np.pi * (1 + np.sqrt(5)) * k
    return np.column_stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z])


class Silhouettes:
    """Renders meshes without perspective, so that the reference mesh fills nine tenths of the picture."""

    def __init__(self, vertices: np.ndarray) -> None:
        self._middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
        self._height = 2 * np.linalg.norm(vertices - self._middle, axis=1).max() / 0.9

    def of(self, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
        """Return the covered pixels, (directions, pixels, pixels) of bool."""
        spec = mujoco.MjSpec()
        scale = 1 / self._height
        spec.visual.global_.offwidth = spec.visual.global_.offheight = PIXELS
        spec.visual.quality.offsamples = spec.visual.quality.shadowsize = 0
        spec.stat.extent = 1.0
        mesh = spec.add_mesh(
            name="mesh", uservert=((vertices - self._middle) * scale).ravel(), userface=np.asarray(faces).ravel()
        )
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="mesh")
        for k, direction in enumerate(_directions()):
            quat = np.empty(4)
            mujoco.mju_quatZ2Vec(quat, direction)
            projection = mujoco.mjtProjection.mjPROJ_ORTHOGRAPHIC
            spec.worldbody.add_camera(name=str(k), pos=direction, quat=quat, proj=projection, fovy=1.0)
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        seen = []
        with mujoco.Renderer(model, PIXELS, PIXELS) as renderer:
            renderer.enable_segmentation_rendering()
            for k in range(DIRECTIONS):
                renderer.update_scene(data, str(k))
                seen.append(renderer.render()[..., 0] >= 0)
        return np.array(seen)


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    """Smallest intersection over union of all directions."""
    return float(min((x & y).sum() / (x | y).sum() for x, y in zip(a, b, strict=True)))
