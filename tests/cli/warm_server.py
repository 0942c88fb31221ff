"""A process that has imported yamsim, and forks for every command that a test runs.

`python -m tests.cli.warm_server FD` reads requests from a socket, see `tests.cli.warm`. A fork runs the whole
executable, from `yamsim_cli.__main__` on, with its own arguments, directory, environment and streams. Only the imports
are done already.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import gc
import importlib
import json
import os
import pkgutil
import runpy
import signal
import socket
import struct
import sys
import threading
from typing import Any, NoReturn

import typer.main

import yamsim_cli
from tests.known_gl import remember_backend

# Modules of few commands that affect others: gymnasium registers environments, Ray replaces signal handlers.
_LEFT_OUT = ("yamsim_cli.gym_env", "yamsim_cli.recording.ray_pool", "yamsim_cli.__main__")


def import_everything() -> None:
    """Import everything that commands import, except OpenGL, which forks choose themselves."""
    os.environ["MUJOCO_GL"] = "off"
    names = [module.name for module in pkgutil.walk_packages(yamsim_cli.__path__, "yamsim_cli.")]
    for name in (*names, "rich.progress", "rich.table", "rich.constrain"):
        # Commands report missing extras.
        with contextlib.suppress(ModuleNotFoundError):
            if name not in _LEFT_OUT:
                importlib.import_module(name)
    # Typer would compute the commands' flags again in every process.
    typer.main.get_command = functools.cache(typer.main.get_command)
    typer.main.get_command(sys.modules["yamsim_cli.main"].app)


def serve(requests: socket.socket) -> list[str]:
    """Fork for each request; return in the fork, with the arguments."""
    # Children that only wait need no wait call.
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    while True:
        data, descriptors, _, _ = socket.recv_fds(requests, 1_000_000, 3)
        if not data:
            os._exit(0)
        if os.fork() == 0:
            requests.close()
            *streams, status = descriptors
            _fork_and_report(status)
            os.close(status)
            return _become(json.loads(data), streams)
        for descriptor in descriptors:
            os.close(descriptor)


def _fork_and_report(status: int) -> None:
    """Go on in a fork, while this process reports the fork's process ID and exit code."""
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    child = os.fork()
    if child == 0:
        return
    with contextlib.suppress(BrokenPipeError):
        os.write(status, struct.pack("i", child))
        _, ended = os.waitpid(child, 0)
        os.write(status, struct.pack("i", os.waitstatus_to_exitcode(ended)))
    os._exit(0)


def _become(request: dict[str, Any], streams: list[int]) -> list[str]:
    """Take on streams, directory, environment and arguments of a request."""
    nothing = os.open(os.devnull, os.O_RDONLY)
    for descriptor, number in zip((nothing, *streams), range(3), strict=True):
        os.dup2(descriptor, number)
        os.close(descriptor)
    os.chdir(request["cwd"])
    os.environ.clear()
    os.environ.update(request["env"])
    words: list[str] = request["args"]
    return words


def run() -> NoReturn:
    """Run the executable, and end as Python does, without freeing memory that the fork shares with its parent."""
    code: object = 0
    try:
        runpy.run_module("yamsim_cli", run_name="__main__", alter_sys=True)
    except SystemExit as end:
        code = end.code
    except BaseException:  # noqa: BLE001
        sys.excepthook(*sys.exc_info())  # type: ignore[arg-type]
        code = 1
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code if isinstance(code, int) else int(code is not None))


if __name__ == "__main__":
    import_everything()
    remember_backend()
    # Otherwise a fork copies memory when the garbage collector looks through it.
    gc.freeze()
    sys.argv = ["yamsim", *serve(socket.socket(fileno=int(sys.argv[1])))]
    run()
