"""Which OpenGL backend MuJoCo is to use, found out before MuJoCo is imported: it reads `MUJOCO_GL` once, at import.

A backend can be missing, broken or hung, and only trying tells. It is tried in a process of its own, under a time
limit, so that a driver that hangs or crashes costs a message and nothing else.
"""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass

from .errors import ResourceError

# GPU first, then Mesa's software renderer through EGL, then OSMesa, which newer Mesa no longer ships.
LINUX_BACKENDS = ("egl", "osmesa")
_PROBE_SECONDS = 60.0
# What OpenGL calls itself where there is no GPU: Mesa's llvmpipe, softpipe, lavapipe and swrast, and others' stand-ins.
_SOFTWARE = re.compile("llvmpipe|softpipe|lavapipe|swrast|software|swiftshader", re.IGNORECASE)
# Drawn and read back: some backends make a context that then cannot draw.
_PROBE = """
import mujoco
model = mujoco.MjModel.from_xml_string("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
renderer = mujoco.Renderer(model, 16, 16)
renderer.update_scene(data)
drawn = renderer.render().any()
from OpenGL import GL
print((GL.glGetString(GL.GL_RENDERER) or b"unknown").decode())
renderer.close()
if not drawn:
    raise SystemExit("what it draws is black")
"""
INSTALL_GL = (
    "on Debian or Ubuntu: apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri libopengl0, "
    "or run tools/ensure_gl.sh from the checkout"
)


@dataclass(frozen=True)
class Backend:
    """A way to OpenGL.

    Attributes:
        name: the value `MUJOCO_GL` has to have, None where MuJoCo's own choice is right.
        renderer: what OpenGL calls itself; empty where nothing was tried.
    """

    name: str | None
    renderer: str = ""

    @property
    def software(self) -> bool:
        """Whether it draws without a GPU, as far as is known."""
        return _SOFTWARE.search(self.renderer) is not None


def choose_backend(environ: Mapping[str, str], platform: str = sys.platform) -> str | None:
    """The value `MUJOCO_GL` has to have for headless rendering to work, None where MuJoCo's own choice does.

    Args and errors as for `find_backend`.
    """
    return find_backend(environ, platform).name


def find_backend(environ: Mapping[str, str], platform: str = sys.platform) -> Backend:
    """A backend that works for headless rendering.

    Args:
        environ: the process's environment; a `MUJOCO_GL` in it is the user's choice and the only one tried.

    Raises:
        ResourceError: no backend works; the message says why for each, and what to install.
    """
    wanted = environ.get("MUJOCO_GL")
    if platform != "linux" and not wanted:
        return Backend(None)
    reasons = []
    for name in (wanted,) if wanted else LINUX_BACKENDS:
        found = probe_backend(name, environ)
        if isinstance(found, Backend):
            return found
        reasons.append(f"{name}: {found}")
    chosen = "; MUJOCO_GL is set, so no other was tried: unset it" if wanted else ""
    raise ResourceError(
        f"no OpenGL backend for headless rendering works ({'; '.join(reasons)}){chosen}; {INSTALL_GL}; "
        "yamsim doctor looks into it"
    )


def bind_backend(name: str) -> None:
    """Let MuJoCo use a backend that was chosen once MuJoCo had been imported, as by a notebook.

    Args:
        name: the value that `MUJOCO_GL` has by now.
    """
    if (mujoco := sys.modules.get("mujoco")) and name in LINUX_BACKENDS:
        mujoco.GLContext = importlib.import_module(f"mujoco.{name}").GLContext  # type: ignore[attr-defined]


def probe_backend(name: str, environ: Mapping[str, str]) -> Backend | str:
    """Try a backend in a process of its own; the backend if it works, else why not."""
    environment = {**environ, "MUJOCO_GL": name}
    # PyOpenGL's own choice has to agree with MuJoCo's, or the import fails.
    environment.pop("PYOPENGL_PLATFORM", None)
    try:
        probe = subprocess.run(
            [sys.executable, "-c", _PROBE],
            env=environment,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=_PROBE_SECONDS,
            stdin=subprocess.DEVNULL,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"hangs (gave up after {_PROBE_SECONDS:g} s)"
    if probe.returncode == 0:
        return Backend(name, probe.stdout.strip().splitlines()[-1] if probe.stdout.strip() else "")
    lines = [line for line in probe.stderr.splitlines() if line.strip()]
    return lines[-1].strip() if lines else f"crashes (exit code {probe.returncode})"
