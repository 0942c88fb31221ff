"""What a program has to find around it so that python-can opens simulated buses."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from ..errors import ResourceError

# A distribution of its own, with one module and one entry point, on the path of the one program that is to find it.
_SITE = Path(__file__).resolve().parents[2] / "can_site"


def program_environment(environ: Mapping[str, str], folder: Path) -> dict[str, str]:
    """The variables, with their values, by which a program finds the buses whose sockets lie in a folder.

    Raises:
        ResourceError: nothing is served there.
    """
    served = sorted(path.name for path in folder.glob("*") if path.is_socket()) if folder.is_dir() else []
    if not served:
        raise ResourceError(
            f"{folder}: nothing is served there; start `yamsim serve-robot --rig yam_v1+linear_4310` first"
        )
    path = os.pathsep.join(filter(None, (str(_SITE), environ.get("PYTHONPATH"))))
    return {"PYTHONPATH": path, "YAMSIM_CAN_FOLDER": str(folder.resolve())}
