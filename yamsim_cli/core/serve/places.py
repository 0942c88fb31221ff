"""Where the sockets of `serve-robot` lie, for it and for whoever looks for them."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

# On which pictures are handed out. A bus cannot have this name: its letters have no point among them.
CAMERA_SOCKET = "cameras.sock"


def default_folder(environ: Mapping[str, str]) -> Path:
    """The user's own folder for them."""
    runtime = environ.get("XDG_RUNTIME_DIR")
    return Path(runtime) / "yamsim-can" if runtime else Path(tempfile.gettempdir()) / f"yamsim-can-{os.getuid()}"
