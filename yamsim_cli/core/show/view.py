"""Watch a rig and move its joints, in a browser page or in MuJoCo's own window."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from ..config.pictures import RenderConfig
from ..config.recording import RecordConfig
from ..errors import ResourceError
from ..images.image import Image
from ..resources import Locations
from ..scene.blueprint import Blueprint, Pictures, task_blueprint
from ..scene.cameras import station_camera, wrist_camera
from ..session import Session
from ..viewers.address import PageAddress
from ..viewers.live import LiveRig
from ..viewers.shown import Shown
from ..viewers.viewpoint import Viewpoint, frame_rig, frame_workspace
from ..vision.renderer import SceneRenderer
from .compose import at_home, task_start

if TYPE_CHECKING:
    from ..viewers.bodies_page import BodiesPage

# Between two pictures, s. Physics takes as many steps between them as real time asks for.
PERIOD = 1 / 30

# Of a camera's picture on the page, px.
_PICTURE = (320, 240)


def live_rig(blueprint: Blueprint, locations: Locations, quality: RenderConfig | None = None) -> LiveRig:
    """Compose a rig and put it into keyframe `home`, ready to run.

    Args:
        quality: of its wrist cameras' pictures; None where none are rendered.
    """
    _, model = at_home(_with_cameras(blueprint, quality), locations)
    return LiveRig(blueprint.rig, model)


def live_task(session: Session, *, boards: bool = True, quality: RenderConfig | None = None) -> LiveRig:
    """A task's scene, with the layout of the seed's first attempt; see `live_rig`.

    Raises:
        SimulationError: its things have no room, or its scene cannot be compiled.
    """
    config, home = task_start(session)
    blueprint = _with_cameras(task_blueprint(config, boards=boards), quality)
    _, model = at_home(blueprint, session.locations, home)
    return LiveRig(config.rig, model, config.task.name)


def _with_cameras(blueprint: Blueprint, quality: RenderConfig | None) -> Blueprint:
    """The same scene with all wrist cameras."""
    pictures = Pictures(quality, _PICTURE) if quality is not None else None
    rig = blueprint.rig
    cameras = (
        *blueprint.cameras,
        *(wrist_camera(arm, _PICTURE) for arm in rig.arms),
        *(station_camera(rig, camera, _PICTURE) for camera in rig.cameras),
    )
    return replace(blueprint, cameras=cameras, pictures=pictures)


def task_viewpoint(config: RecordConfig) -> Viewpoint:
    """Where a task's scene is watched from: between the arm and the middle of the table."""
    x, y, _ = config.table.position
    return frame_workspace(x - 0.15, y, config.table.top + 0.1, config.rig.span)


class LivePictures:
    """What a live rig's cameras see now; the renderer is made when first needed, for the thread that asks."""

    def __init__(self, live: LiveRig) -> None:
        self._live = live
        self._renderer: SceneRenderer | None = None

    def render(self, camera: str) -> Image:
        """An RGB image (240, 320, 3) of a camera.

        Raises:
            ResourceError: no OpenGL context could be made.
        """
        if self._renderer is None:
            self._renderer = SceneRenderer(self._live.model, _PICTURE)
        with self._live.lock:
            return self._renderer.render(self._live.data, camera)

    def close(self) -> None:
        """Free the renderer."""
        if self._renderer is not None:
            self._renderer.close()


def view_in_browser(
    live: LiveRig,
    address: PageAddress,
    ready: Callable[[str], None],
    stopped: Callable[[], bool],
    viewpoint: Viewpoint | None = None,
    *,
    boards: bool = True,
    pictures: bool = False,
) -> None:
    """Serve a page and run physics, until `stopped` says so.

    Args:
        ready: called with the page's URL once it is up, unless it is no longer wanted.
        viewpoint: where the page's camera starts; without, it sees the whole rig.
        boards: whether boards and mounts are shown at first.
        pictures: whether the page offers what the cameras see.

    Raises:
        UsageError: the address cannot be had.
        ResourceError: the viewer library is not installed.
    """
    require_page()
    from ..viewers.rig_page import RigPage

    seen = LivePictures(live) if pictures else None
    try:
        page = RigPage(live, viewpoint or frame_rig(live.rig), address, boards=boards, pictures=seen)
        run_page(page, live, ready, stopped)
    finally:
        if seen is not None:
            seen.close()


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


def view_in_window(
    live: LiveRig, ready: Callable[[], None], stopped: Callable[[], bool], viewpoint: Viewpoint | None = None
) -> None:
    """Open MuJoCo's window and run physics, until it is closed or `stopped` says so.

    Args:
        ready: called when the window is open, unless it is no longer wanted.
        viewpoint: where its camera starts; without, it sees the whole rig.

    Raises:
        ResourceError: no window can be opened here.
    """
    from ..viewers.window import run_window

    run_window(live, viewpoint or frame_rig(live.rig), PERIOD, ready, stopped)
