"""Run by two spawned processes at once in test_fetch.py, with DATA, STORE and CALLS as globals."""

import time
from pathlib import Path

from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.scene.assets import AssetStore, load_lock
from yamsim_cli.mesh_download.fetch import fetch


class SlowSource:
    name = "slow"

    def has_set(self, assets):
        return True

    def read(self, assets, scratch, progress):
        with Path(CALLS).open("a") as calls:  # noqa: F821
            calls.write("called\n")
        time.sleep(0.5)
        return {"part.stl": b"solid part", "tip.stl": b"solid tip"}


store = AssetStore(Path(STORE))  # noqa: F821
fetch(load_lock(Locations((Path(DATA),), store.root)), ["tiny"], store, [SlowSource()])  # noqa: F821
