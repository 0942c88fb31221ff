"""Refuses OpenGL in a process that was forked from one that had used it: it would hang there for ever."""

from __future__ import annotations

import os
import sys

from ..errors import ResourceError

# The process in which OpenGL was first used. A forked process inherits the number, a spawned one starts with None.
_user: int | None = None


def _note_mujocos_own() -> None:
    """Before a fork, note OpenGL that MuJoCo's own renderer has used, which shows in its open display."""
    if getattr(sys.modules.get("mujoco.egl"), "EGL_DISPLAY", None) is not None:
        _note_use()


def _note_use() -> None:
    global _user
    if _user is None:
        _user = os.getpid()


os.register_at_fork(before=_note_mujocos_own)


def enter_opengl() -> None:
    """Note that this process is about to use OpenGL.

    OpenGL's drivers keep threads and locks. A fork does not copy the threads, and rendering there waits for ever.

    Raises:
        ResourceError: a process from which this one was forked has used OpenGL before.
    """
    if _user not in (None, os.getpid()):
        raise ResourceError(
            f"process {os.getpid()} cannot render: it was forked, and process {_user} had used OpenGL before, so "
            "OpenGL would hang here; start the processes that render with multiprocessing's 'forkserver' or 'spawn', "
            "as in "
            'AsyncVectorEnv(..., context="forkserver") or '
            'gymnasium.make_vec(..., vectorization_mode="async", vector_kwargs={"context": "forkserver"}), '
            "or render nothing before they are forked"
        )
    _note_use()
