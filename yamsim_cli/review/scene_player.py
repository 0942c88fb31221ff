"""The 3D scene of an episode beside the review page: `yamsim replay` in a separate process."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import IO

from ..core.closable import Closable
from ..core.errors import ResourceError

_END_SECONDS = 10.0  # s that a player has to end before it is killed

# A free port, and the page of a browser instead of MuJoCo's window.
_REPLAY = (sys.executable, "-m", "yamsim_cli", "replay", "--web", "--port", "0")


def _drain(stream: IO[str]) -> None:
    with stream:
        for _ in stream:
            pass


class ScenePlayer(Closable):
    """Plays one episode at a time on the page of `yamsim replay`. Any thread may call the methods."""

    def __init__(self, command: Sequence[str] = _REPLAY) -> None:
        self._command = tuple(command)
        self._lock = threading.Lock()
        self._process: subprocess.Popen[str] | None = None

    def play(self, directory: Path) -> str:
        """Return the address of a page that plays an episode; the page of an earlier episode ends.

        It waits until the scene is built and the episode's physics repeated, which takes some seconds.

        Raises:
            ResourceError: the player cannot start, such as without the extra `yamsim[view]`.
        """
        with self._lock:
            self._end()
            self._process = subprocess.Popen(
                [*self._command, str(directory)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
            assert self._process.stdout is not None and self._process.stderr is not None
            line = self._process.stdout.readline()
            if line.startswith("http://"):
                # Later lines must not fill the pipes.
                for stream in (self._process.stdout, self._process.stderr):
                    threading.Thread(target=_drain, args=(stream,), daemon=True).start()
                return line.split()[0]
            said = self._process.communicate()[1].strip().splitlines()
            raise ResourceError(f"the 3D scene cannot be shown: {said[-1] if said else 'yamsim replay ended'}")

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        process.terminate()
        try:
            process.wait(_END_SECONDS)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def close(self) -> None:
        """End the player."""
        with self._lock:
            self._end()
