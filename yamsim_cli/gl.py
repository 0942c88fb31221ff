"""Finds an OpenGL backend for MuJoCo, which reads the environment variable `MUJOCO_GL` at its import.

Each backend is tried in a separate process, because a driver can hang or crash.
"""

from __future__ import annotations

import importlib
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass

from .core.closable import Closable
from .core.errors import ResourceError
from .core.rendering.software_renderers import is_software_renderer

LINUX_BACKENDS = ("egl", "osmesa")  # EGL finds a GPU or Mesa's software renderer; newer Mesa has no OSMesa
PROBE_SECONDS = 60.0  # s, time limit of the test of a backend
# Python program that tests a backend. It reads a rendered image back, since some backends render nothing.
PROBE_PROGRAM = """
import mujoco
model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
renderer = mujoco.Renderer(model, 16, 16)
renderer.update_scene(data)
rendered = renderer.render().any()
from OpenGL import GL
print((GL.glGetString(GL.GL_RENDERER) or b"unknown").decode())
renderer.close()
if not rendered:
    raise SystemExit("its pictures are black")
"""
INSTALL_GL = (
    "on Debian or Ubuntu: apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri libopengl0, "
    "or run tools/ensure_gl.sh from the checkout"
)


@dataclass(frozen=True)
class GlBackend:
    """An OpenGL backend.

    Attributes:
        name: the value for `MUJOCO_GL`; None where MuJoCo's own choice works.
        renderer: as OpenGL names it; empty if the backend was not tried.
    """

    name: str | None
    renderer: str = ""

    @property
    def is_software(self) -> bool:
        """Whether the backend is known to render without a GPU."""
        return is_software_renderer(self.renderer)


class BackendProbe(Closable):
    """A try of a backend in a separate process, which runs beside the caller until `result` or `close`."""

    def __init__(self, name: str, environ: Mapping[str, str]) -> None:
        self.name = name
        environment = {**environ, "MUJOCO_GL": name}
        # The import fails unless PyOpenGL and MuJoCo choose the same platform.
        environment.pop("PYOPENGL_PLATFORM", None)
        self._process = subprocess.Popen(
            [sys.executable, "-c", PROBE_PROGRAM],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
        )

    def result(self) -> GlBackend | str:
        """Wait for the end of the try; return the backend, or why it does not work."""
        process = self._process
        try:
            output, errors = process.communicate(timeout=PROBE_SECONDS)
        except subprocess.TimeoutExpired:
            return f"hangs (gave up after {PROBE_SECONDS:g} s)"
        finally:
            self.close()
        if process.returncode == 0:
            return GlBackend(self.name, output.strip().splitlines()[-1] if output.strip() else "")
        lines = [line for line in errors.splitlines() if line.strip()]
        return lines[-1].strip() if lines else f"crashes (exit code {process.returncode})"

    def close(self) -> None:
        """End the try."""
        # Ends the process, closes its pipes and waits for its end.
        with self._process as process:
            process.kill()


def find_backend(
    environ: Mapping[str, str], platform: str = sys.platform, started: BackendProbe | None = None
) -> GlBackend:
    """Return the first backend that renders without a display.

    Args:
        environ: If the user has set `MUJOCO_GL`, no other backend is tried.
        started: the result of `start_probe` for the same variables; takes the place of the first try.
    """
    reasons = []
    for name in (candidates := _candidates(environ, platform)):
        found = started.result() if started is not None and name == candidates[0] else probe_backend(name, environ)
        if isinstance(found, GlBackend):
            return found
        reasons.append(f"{name}: {found}")
    if not candidates:
        return GlBackend(None)
    chosen = "; MUJOCO_GL is set, so no other was tried: unset it" if environ.get("MUJOCO_GL") else ""
    raise ResourceError(
        f"no OpenGL backend for headless rendering works ({'; '.join(reasons)}){chosen}; {INSTALL_GL}; "
        "run `yamsim doctor` to find the cause"
    )


def start_probe(environ: Mapping[str, str], platform: str = sys.platform) -> BackendProbe | None:
    """Start the first try of `find_backend`; None if it tries no backend."""
    candidates = _candidates(environ, platform)
    return BackendProbe(candidates[0], environ) if candidates else None


def _candidates(environ: Mapping[str, str], platform: str) -> tuple[str, ...]:
    if wanted := environ.get("MUJOCO_GL"):
        return (wanted,)
    return LINUX_BACKENDS if platform == "linux" else ()


def bind_backend(name: str) -> None:
    """Switch MuJoCo to a backend, if it was already imported with another one, as in a notebook."""
    if (mujoco := sys.modules.get("mujoco")) and name in LINUX_BACKENDS:
        mujoco.GLContext = importlib.import_module(f"mujoco.{name}").GLContext  # type: ignore[attr-defined]


def probe_backend(name: str, environ: Mapping[str, str]) -> GlBackend | str:
    """Try a backend in a separate process. Return it, or why it does not work."""
    return BackendProbe(name, environ).result()
