"""Whether this process may draw: one that was forked from a process that had used OpenGL would hang in it for ever."""

from __future__ import annotations

import os
import sys

from ..errors import ResourceError

# The process in which OpenGL was first used. A forked process inherits the number, a spawned one starts with None.
_user: int | None = None


def _note_mujocos_own() -> None:
    """Before a fork: what was drawn by MuJoCo's own renderer counts as well. It shows in the display that is open."""
    if getattr(sys.modules.get("mujoco.egl"), "EGL_DISPLAY", None) is not None:
        _note_use()


def _note_use() -> None:
    global _user
    if _user is None:
        _user = os.getpid()


os.register_at_fork(before=_note_mujocos_own)


def enter_opengl() -> None:
    """Note that this process is about to use OpenGL.

    Its drivers keep threads and locks, which a fork does not bring along: what is drawn there waits for them for ever.

    Raises:
        ResourceError: a process from which this one was forked has used OpenGL before.
    """
    if _user not in (None, os.getpid()):
        raise ResourceError(
            f"process {os.getpid()} cannot draw: it was forked, and process {_user} had used OpenGL before, so OpenGL "
            "would hang here; start the processes that draw with multiprocessing's 'forkserver' or 'spawn', as in "
            'AsyncVectorEnv(..., context="forkserver") or '
            'gymnasium.make_vec(..., vectorization_mode="async", vector_kwargs={"context": "forkserver"}), '
            "or draw nothing before they are forked"
        )
    _note_use()
