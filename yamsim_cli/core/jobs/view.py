"""Watch a rig and move its joints, in a browser page or in MuJoCo's own window."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from ..config.rig import RigConfig
from ..config.scene import SceneConfig
from ..errors import ResourceError
from ..resources import Locations
from ..scene.compose import Contents, Meshes
from ..viewers.live import LiveRig
from ..viewers.shown import Shown
from ..viewers.viewpoint import frame_rig
from .compose import rig_spec

if TYPE_CHECKING:
    from ..viewers.bodies_page import BodiesPage

# Between two pictures, s. Physics takes as many steps between them as real time asks for.
PERIOD = 1 / 30


def live_rig(rig: RigConfig, scene: SceneConfig, contents: Contents, locations: Locations, meshes: Meshes) -> LiveRig:
    """Compose a rig and put it into keyframe `home`, ready to run."""
    _, model = rig_spec(rig, scene, contents, locations, meshes)
    return LiveRig(rig, model)


def view_in_browser(live: LiveRig, port: int, ready: Callable[[str], None], stopped: Callable[[], bool]) -> None:
    """Serve a page on 127.0.0.1 and run physics, until `stopped` says so.

    Args:
        port: of the page; 0 takes a free one.
        ready: called with the page's URL once it is up, unless it is no longer wanted.

    Raises:
        UsageError: the port cannot be had.
        ResourceError: the viewer library is not installed.
    """
    require_page()
    from ..viewers.page import Page

    run_page(Page(live, frame_rig(live.rig), port), live, ready, stopped)


def require_page() -> None:
    """Make sure that a browser page can be served.

    Raises:
        ResourceError: the viewer library is not installed.
    """
    try:
        from ..viewers import bodies_page  # noqa: F401
    except ModuleNotFoundError as error:
        if error.name != "viser":
            raise
        raise ResourceError("the browser page needs viser, which is not here: pip install 'yamsim[view]'") from error


def run_page(page: BodiesPage, shown: Shown, ready: Callable[[str], None], stopped: Callable[[], bool]) -> None:
    """Let what a page shows go on until `stopped` says so, and close the page; see `view_in_browser`."""
    try:
        if not stopped():
            ready(page.url)
        while not stopped():
            began = time.monotonic()
            shown.advance(began)
            page.update()
            time.sleep(max(0.0, began + PERIOD - time.monotonic()))
    finally:
        page.close()


def view_in_window(live: LiveRig, ready: Callable[[], None], stopped: Callable[[], bool]) -> None:
    """Open MuJoCo's window and run physics, until it is closed or `stopped` says so.

    Args:
        ready: called when the window is open, unless it is no longer wanted.

    Raises:
        ResourceError: no window can be opened here.
    """
    from ..viewers.window import run_window

    run_window(live, frame_rig(live.rig), PERIOD, ready, stopped)
