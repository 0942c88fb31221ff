"""Renders states of a compiled model with MuJoCo's Filament renderer, a physically based one.

It needs the packages `mujoco-studio` and `numpy` alone and, without a display, a Vulkan driver in software (on Debian,
`mesa-vulkan-drivers` and `libvulkan1`). Benchmarks run it as a program of the Python that has `mujoco-studio`:

    python tools/bench/filament_pictures.py MODEL.mjb POSITIONS.npy CAMERA WIDTHxHEIGHT PICTURES.npy
"""

from __future__ import annotations

import collections.abc
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

_MAX_GEOMS = 5000  # of a scene
_SECONDS = 1800  # s, for all pictures of a program, after which it counts as hung


class FilamentRenderer:
    """Renders a camera of a model. Lights keep their directions; Filament has its own units and tone curve.

    The camera's `cam_ipd` in `model` becomes 0.
    """

    def __init__(self, model: mujoco.MjModel, camera: str, size: tuple[int, int]) -> None:
        if not hasattr(collections.abc, "Buffer"):
            # Python 3.12 brought it. MuJoCo's modules name it in annotations.
            collections.abc.Buffer = object  # type: ignore[attr-defined]
        # They come with `mujoco-studio`; the window's module registers materials.
        import mujoco.studio.window
        from mujoco import mjrf
        from mujoco.rendering.filament.model_scene import ModelScene
        from mujoco.rendering.filament.renderer import Renderer, View

        self._model = model
        self._picture = np.zeros((size[1], size[0], 3), np.uint8)
        config = mjrf.ContextConfig(graphics_api=mjrf.GraphicsApi.GRAPHICS_API_VULKAN, software_rendering=True)
        self._renderer = Renderer(mjrf.Context(config))
        self._scene = ModelScene(self._renderer.context, model, self._renderer.scene("photo"))
        self._renderer.target("photo", self._picture)
        self._view = View("photo", "photo")
        self._options, self._abstract = mujoco.MjvOption(), mujoco.MjvScene(model, _MAX_GEOMS)
        self._fixed = mujoco.MjvCamera()
        self._fixed.type, self._fixed.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, model.camera(camera).id
        # Both eyes of the stereo camera coincide: the picture has one eye.
        model.cam_ipd[self._fixed.fixedcamid] = 0.0

    def render(self, data: mujoco.MjData) -> NDArray[np.uint8]:
        """Return the picture of a state as RGB (height, width, 3)."""
        mujoco.mj_forward(self._model, data)
        mujoco.mjv_updateScene(
            self._model, data, self._options, None, self._fixed, mujoco.mjtCatBit.mjCAT_ALL, self._abstract
        )
        self._scene.update(data)
        self._view.camera = self._abstract.camera[0]
        self._renderer.render([self._view])
        return self._picture.copy()


def render_elsewhere(
    python: Path, model: mujoco.MjModel, positions: Sequence[NDArray[np.float64]], camera: str, size: tuple[int, int]
) -> list[NDArray[np.uint8]]:
    """Return the pictures (height, width, 3) of positions (nq,), rendered by another Python.

    Raises:
        subprocess.CalledProcessError: the program failed; its messages are on the error output.
        subprocess.TimeoutExpired: it took longer than `_SECONDS`.
    """
    with tempfile.TemporaryDirectory(prefix="filament_") as folder:
        stored, states, pictures = (Path(folder) / name for name in ("model.mjb", "positions.npy", "pictures.npy"))
        mujoco.mj_saveModel(model, str(stored))
        np.save(states, np.array(positions))
        given = [str(stored), str(states), camera, f"{size[0]}x{size[1]}", str(pictures)]
        subprocess.run(
            [str(python), __file__, *given], check=True, timeout=_SECONDS, stdout=subprocess.DEVNULL, cwd=folder
        )
        return list(np.load(pictures))


def main() -> None:
    """Render all states of a file."""
    stored, states, camera, size, pictures = sys.argv[1:]
    width, height = (int(part) for part in size.split("x"))
    model = mujoco.MjModel.from_binary_path(stored)
    data = mujoco.MjData(model)
    renderer = FilamentRenderer(model, camera, (width, height))
    taken = []
    for position in np.load(states):
        data.qpos[:] = position
        taken.append(renderer.render(data))
    np.save(pictures, np.array(taken))


if __name__ == "__main__":
    main()
