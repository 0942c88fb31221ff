"""Sessions of the station."""

from __future__ import annotations

import logging
import os
from typing import Any

from ..core.opener import Opener, parse_size
from ..core.session import Session

STATION = "yam_station_linear_4310_d405"

# Whichever of ours: a scene of the benchmark brings a task of its own.
_ANY_TASK = "tower"

_LOG = logging.getLogger("yamsim")

_OPENER = Opener(os.environ, _LOG.warning, "{}=".format)


def open_base(size: str, *, images: bool, quality: str = "fast", task: str = _ANY_TASK) -> Session:
    """A session of the station.

    Args:
        task: one of ours; those of the benchmark's scenes replace it.

    Raises:
        UsageError: the size, the quality or the task is not valid.
        ResourceError: images are wanted, and nothing can render here.
    """
    given: dict[str, Any] = {"rig": STATION, "task": task, "size": parse_size(size), "quality": quality}
    where = _OPENER.locations()
    if "contact" in _OPENER.config("default", where, **given).task.valid_grasps:
        # Actions of Inspect Robots command grippers, and no magnet.
        given["grasp"] = "contact"
    if images:
        return _OPENER.open("default", parallel=False, **given)
    return Session(_OPENER.config("default", where, **given), where).without_meshes()
