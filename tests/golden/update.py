"""`make golden-update`: make today's pictures the golden ones. Look at each before you commit it."""

from __future__ import annotations

import os

from yamsim_cli.core.files.resources import Locations
from yamsim_cli.gl import find_backend

if __name__ == "__main__":
    os.environ["MUJOCO_GL"] = find_backend(os.environ).name or ""

    from tests.golden.shots import update

    for path in update(Locations.from_environment(os.environ)):
        print(path)
