"""A process like that of `filament_process`, with a renderer whose cameras do what a test asks for."""

from __future__ import annotations

import fcntl
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np

from yamsim_cli.core.images.image import Image
from yamsim_cli.photo_rendering import filament, filament_process

LOCK_VARIABLE = "FAKE_FILAMENT_LOCK"  # names a file that the process locks before it hangs


class FakeRenderer:
    """Renders grey images: of the camera's number, or of the background."""

    def __init__(self, model: mujoco.MjModel, size: tuple[int, int], samples: int) -> None:
        self._shape = (size[1], size[0], 3)

    def render(self, data: mujoco.MjData, camera: str, background: Callable[[], Image]) -> Image:
        """Render an image, hang, end with a message, or end without one."""
        if camera == "background":
            return background()
        if camera == "hang":
            if LOCK_VARIABLE in os.environ:
                lock = Path(os.environ[LOCK_VARIABLE]).open("w")  # noqa: SIM115 - locked until the process ends
                fcntl.flock(lock, fcntl.LOCK_EX)
                lock.write("locked")
                lock.flush()
            time.sleep(1000)
        if camera == "abort":
            print("no more memory", file=sys.stderr)
        if not camera.isdigit():
            sys.stderr.flush()
            os._exit(3)
        return np.full(self._shape, int(camera), np.uint8)


if __name__ == "__main__":
    filament.FilamentRenderer = FakeRenderer  # type: ignore[assignment,misc]
    filament_process.main()
