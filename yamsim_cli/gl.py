"""Finds an OpenGL backend for MuJoCo, which reads the environment variable `MUJOCO_GL` at its import.

Each backend is tried in a separate process, because a driver can hang or crash.
"""

from __future__ import annotations

import importlib
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass

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


def find_backend(environ: Mapping[str, str], platform: str = sys.platform) -> GlBackend:
    """Return the first backend that renders without a display.

    Args:
        environ: If the user has set `MUJOCO_GL`, no other backend is tried.
    """
    wanted = environ.get("MUJOCO_GL")
    if platform != "linux" and not wanted:
        return GlBackend(None)
    reasons = []
    for name in (wanted,) if wanted else LINUX_BACKENDS:
        found = probe_backend(name, environ)
        if isinstance(found, GlBackend):
            return found
        reasons.append(f"{name}: {found}")
    chosen = "; MUJOCO_GL is set, so no other was tried: unset it" if wanted else ""
    raise ResourceError(
        f"no OpenGL backend for headless rendering works ({'; '.join(reasons)}){chosen}; {INSTALL_GL}; "
        "run `yamsim doctor` to find the cause"
    )


def bind_backend(name: str) -> None:
    """Switch MuJoCo to a backend, if it was already imported with another one, as in a notebook."""
    if (mujoco := sys.modules.get("mujoco")) and name in LINUX_BACKENDS:
        mujoco.GLContext = importlib.import_module(f"mujoco.{name}").GLContext  # type: ignore[attr-defined]


def probe_backend(name: str, environ: Mapping[str, str]) -> GlBackend | str:
    """Try a backend in a separate process. Return it, or why it does not work."""
    environment = {**environ, "MUJOCO_GL": name}
    # The import fails unless PyOpenGL and MuJoCo choose the same platform.
    environment.pop("PYOPENGL_PLATFORM", None)
    try:
        probe = subprocess.run(
            [sys.executable, "-c", PROBE_PROGRAM],
            env=environment,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=PROBE_SECONDS,
            stdin=subprocess.DEVNULL,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"hangs (gave up after {PROBE_SECONDS:g} s)"
    if probe.returncode == 0:
        return GlBackend(name, probe.stdout.strip().splitlines()[-1] if probe.stdout.strip() else "")
    lines = [line for line in probe.stderr.splitlines() if line.strip()]
    return lines[-1].strip() if lines else f"crashes (exit code {probe.returncode})"
