"""Runs Filament in a separate process, which ends when its parent closes the connection or ends for any reason.

Filament 4.0.0 with Mesa's Vulkan driver keeps 1 to 1.5 MB of memory of each rendering until its process ends. So the
process is replaced when it has grown too large. A driver that aborts ends this process, not the caller's.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import resource
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from importlib.metadata import version
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import mujoco

from ..core.closable import Closable
from ..core.errors import ResourceError
from ..core.images.image import Image
from .filament_context import MAX_BYTES, require_filament

_END_SECONDS = 10  # s, for the end of a process that was told to end
_ANSWER_SECONDS = 600  # s, longest wait for the start and for an image, after which the driver counts as hung
_PARENT_POLL_SECONDS = 1.0  # s, between two looks whether the parent still exists
_ADVICE = "run `yamsim doctor`, or take another --quality"
# What an image depends on and attempts vary: fields of `MjModel`, of its headlight, and of `MjData`.
_MODEL_FIELDS = (
    "geom_group", "geom_matid", "geom_rgba", "flex_group", "flex_matid", "flex_rgba", "mat_rgba", "mat_specular",
    "mat_shininess", "mat_metallic", "mat_roughness", "light_active", "light_castshadow", "light_diffuse", "cam_fovy",
)  # fmt: skip
_HEADLIGHT_FIELDS = ("active", "ambient", "diffuse")
_DATA_FIELDS = (
    "geom_xpos", "geom_xmat", "light_xpos", "light_xdir", "cam_xpos", "cam_xmat", "flexvert_xpos", "subtree_com",
    "xpos", "xmat", "xipos", "ximat",
)  # fmt: skip


class FilamentProcess(Closable):
    """A `FilamentRenderer` in another process, started for the first image.

    Attributes:
        description: name and version of the renderer, and the Vulkan device.

    Args:
        model: the scene. Its lights, materials and cameras may change between images.
        size: width and height of images, px.
        samples: renderings that an image averages, see `light_samples`.

    Raises:
        ResourceError: `mujoco-studio` is not installed, or no Vulkan driver works.
    """

    def __init__(self, model: mujoco.MjModel, size: tuple[int, int], samples: int) -> None:
        self.description = f"Filament of mujoco-studio {version('mujoco-studio')}, {require_filament()}"
        self._model, self._size, self._samples = model, size, samples
        self._process: subprocess.Popen[bytes] | None = None
        self._connection: Connection[Any, Any] | None = None
        self._errors = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115 - closed by `close`
        self._reload = False

    def reload_textures(self) -> None:
        """Take the textures of the model again after they have changed."""
        self._reload = True

    def render(self, data: mujoco.MjData, camera: str, background: Callable[[], Image]) -> Image:
        """Render an RGB image (height, width, 3) of the state `data`, before an image of the same shape."""
        model = self._model
        try:
            if self._connection is None:
                self._start()
            state = {key: getattr(model, key) for key in _MODEL_FIELDS}
            headlight = {key: getattr(model.vis.headlight, key) for key in _HEADLIGHT_FIELDS}
            poses = {key: getattr(data, key) for key in _DATA_FIELDS}
            self._send((camera, state, headlight, poses, model.tex_data if self._reload else None))
            self._reload = False
            while (answer := self._receive()) is None:
                self._send(background())
        except BaseException:
            # An answer that nobody received would be taken for the next image.
            self._kill()
            raise
        image: Image = answer[0]
        if answer[1] > MAX_BYTES:
            self._stop()
        return image

    def _start(self) -> None:
        self._errors.seek(0)
        self._errors.truncate()
        self._connection, theirs = Pipe()
        with theirs:
            # Ctrl-C in the terminal does not reach a separate session.
            self._process = subprocess.Popen(
                [sys.executable, "-m", __name__, str(theirs.fileno()), str(os.getpid())],
                stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=self._errors, pass_fds=[theirs.fileno()],
                env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
                start_new_session=True,
            )  # fmt: skip
        self._send((self._model, self._size, self._samples))
        self._reload = False
        self._receive()

    def _send(self, message: object) -> None:
        assert self._connection is not None
        try:
            self._connection.send(message)
        except OSError as error:
            raise ResourceError(self._explain_end()) from error

    def _receive(self) -> Any:
        assert self._connection is not None
        try:
            if self._connection.poll(_ANSWER_SECONDS):
                return self._connection.recv()
        except (EOFError, OSError) as error:
            raise ResourceError(self._explain_end()) from error
        raise ResourceError(f"the process of {self.description} hangs: no answer after {_ANSWER_SECONDS} s; {_ADVICE}")

    def _explain_end(self) -> str:
        process = self._process
        self._stop()
        code = process.returncode if process else None
        self._errors.seek(0)
        lines = self._errors.read().decode(errors="replace").strip().splitlines() or ["it left no message"]
        return f"the process of {self.description} ended with code {code} ({lines[-1].strip()}); {_ADVICE}"

    def _stop(self) -> None:
        """Let the process end, or kill it if it does not end in time."""
        if self._connection is not None:
            self._connection.close()
        if self._process is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(_END_SECONDS)
        self._kill()

    def _kill(self) -> None:
        if self._connection is not None:
            self._connection.close()
        if self._process is not None:
            self._process.kill()
            self._process.wait()
        self._process = self._connection = None

    def close(self) -> None:
        """End the process. Repeated calls have no effect."""
        self._stop()
        self._errors.close()


def _serve(connection: Connection[Any, Any]) -> None:
    """Render images until the other side closes the connection."""
    from .filament import FilamentRenderer

    model, size, samples = connection.recv()
    data = mujoco.MjData(model)
    renderer = FilamentRenderer(model, size, samples)
    connection.send("ready")

    def background() -> Image:
        connection.send(None)
        image: Image = connection.recv()
        return image

    while True:
        camera, state, headlight, poses, textures = connection.recv()
        for target, values in ((model, state), (data, poses)):
            for key, value in values.items():
                getattr(target, key)[:] = value
        for key, value in headlight.items():
            setattr(model.vis.headlight, key, value)
        if textures is not None:
            model.tex_data[:] = textures
            renderer.reload_textures()
        image = renderer.render(data, camera, background)
        connection.send((image, _used_bytes()))


def _used_bytes() -> int:
    """Return the resident memory of this process; without /proc, as on macOS, the largest that it ever had."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # On Linux, the largest memory that `getrusage` gives begins with the memory of the parent.
    return pages * resource.getpagesize()


def _end_with_parent(parent: int) -> None:
    """End this process as soon as its parent has ended, even during an image: Filament releases the GIL."""
    while os.getppid() == parent:
        time.sleep(_PARENT_POLL_SECONDS)
    os._exit(1)


def main() -> None:
    """Serve the connection with the number of the command line, as long as the process given after it exists."""
    threading.Thread(target=_end_with_parent, args=(int(sys.argv[2]),), daemon=True).start()
    try:
        _serve(Connection(int(sys.argv[1])))
    except (EOFError, ConnectionError, pickle.UnpicklingError):
        return


if __name__ == "__main__":
    main()
