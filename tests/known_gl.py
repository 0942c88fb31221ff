"""The working OpenGL backend, determined once for all tests: each try takes a process and seconds."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping

from yamsim_cli import gl
from yamsim_cli.core.errors import ResourceError
from yamsim_cli.gl import GlBackend

# "native" if MuJoCo's own choice works, "none" if nothing works; and OpenGL's renderer name.
NAME, RENDERER = "YAMSIM_TEST_GL", "YAMSIM_TEST_GL_RENDERER"


def settle_backend() -> None:
    """Find a backend, and set environment variables, which xdist's workers and commands inherit."""
    if NAME not in os.environ:
        try:
            found = gl.find_backend(os.environ)
            os.environ[NAME], os.environ[RENDERER] = found.name or "native", found.renderer
        except ResourceError:
            os.environ[NAME] = "none"
    if os.environ[NAME] == "none":
        os.environ["MUJOCO_GL"] = "disabled"
    elif os.environ[NAME] != "native":
        os.environ["MUJOCO_GL"] = os.environ[NAME]


def remember_backend() -> None:
    """Read the backend from the environment instead of testing it again."""
    really = gl.probe_backend

    def answer(name: str, environ: Mapping[str, str]) -> GlBackend | str:
        if environ.get(NAME) == name and environ.get(RENDERER):
            return GlBackend(name, environ[RENDERER])
        return really(name, environ)

    start = gl.start_probe

    def start_unless_known(environ: Mapping[str, str], platform: str = sys.platform) -> gl.BackendProbe | None:
        return None if environ.get(RENDERER) else start(environ, platform)

    gl.probe_backend, gl.start_probe = answer, start_unless_known
