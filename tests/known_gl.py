"""Which OpenGL backend works here, found out once for all tests: to try one takes a process and seconds."""

from __future__ import annotations

import os
from collections.abc import Mapping

from yamsim_cli import gl
from yamsim_cli.core.errors import ResourceError
from yamsim_cli.gl import GlBackend

# "native" where MuJoCo's own choice is right, "none" where nothing works; and what OpenGL calls itself there.
NAME, RENDERER = "YAMSIM_TEST_GL", "YAMSIM_TEST_GL_RENDERER"


def settle_backend() -> None:
    """Find a backend, and put it into the environment, from where xdist's workers and commands inherit the answer."""
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
    """Answer in this process from the environment, where a backend would be tried again that is known to work."""
    really = gl.probe_backend

    def answer(name: str, environ: Mapping[str, str]) -> GlBackend | str:
        if environ.get(NAME) == name and environ.get(RENDERER):
            return GlBackend(name, environ[RENDERER])
        return really(name, environ)

    gl.probe_backend = answer
