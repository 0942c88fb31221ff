from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.rendering import RenderConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.errors import ResourceError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.images.image import Image
from yamsim_cli.core.rendering.renderer import SceneRenderer
from yamsim_cli.core.scene.blueprint import Blueprint, PictureSettings, task_blueprint
from yamsim_cli.core.scene.cameras import station_camera, wrist_camera

from ..page_address import PageAddress
from ..viewed_scene import LiveRig, ViewedScene
from ..viewpoint import Viewpoint, rig_viewpoint, workspace_viewpoint
from .compose import compose_at_home, first_attempt_start

if TYPE_CHECKING:
    from ..scene_page import ScenePage

FRAME_PERIOD = 1 / 30  # s, between two images
_PAGE_IMAGE_SIZE = (320, 240)  # px, (width, height) of camera images on the page


def make_live_rig(blueprint: Blueprint, locations: Locations, quality: RenderConfig | None = None) -> LiveRig:
    """Compose a rig in keyframe `home`. With `quality`, its cameras can be rendered."""
    _, model = compose_at_home(_with_cameras(blueprint, quality), locations)
    return LiveRig(blueprint.rig, model)


def make_live_task(session: Session, *, boards: bool = True, quality: RenderConfig | None = None) -> LiveRig:
    """Compose a task's scene as in the seed's first attempt. With `quality`, its cameras can be rendered."""
    config, home = first_attempt_start(session)
    blueprint = _with_cameras(task_blueprint(config, boards=boards), quality)
    _, model = compose_at_home(blueprint, session.locations, home)
    return LiveRig(config.rig, model, config.task.name)


def _with_cameras(blueprint: Blueprint, quality: RenderConfig | None) -> Blueprint:
    pictures = PictureSettings(quality, _PAGE_IMAGE_SIZE) if quality is not None else None
    rig = blueprint.rig
    cameras = (
        *blueprint.cameras,
        *(wrist_camera(arm, _PAGE_IMAGE_SIZE) for arm in rig.arms),
        *(station_camera(rig, camera, _PAGE_IMAGE_SIZE) for camera in rig.cameras),
    )
    return replace(blueprint, cameras=cameras, pictures=pictures)


def task_viewpoint(config: RecordConfig) -> Viewpoint:
    """Return a view towards a point between the arm and the middle of the table."""
    x, y, _ = config.widened_table.position
    return workspace_viewpoint(x - 0.15, y, config.widened_table.top_height + 0.1, config.rig.arm_span)


class LivePictures:
    """Renders a live rig's cameras. The first call creates the renderer, which belongs to that thread."""

    def __init__(self, live: LiveRig) -> None:
        self._live = live
        self._renderer: SceneRenderer | None = None

    def render(self, camera: str) -> Image:
        """Return an RGB image (240, 320, 3). Raise ResourceError without an OpenGL context."""
        if self._renderer is None:
            self._renderer = SceneRenderer(self._live.model, _PAGE_IMAGE_SIZE)
        with self._live.lock:
            return self._renderer.render(self._live.data, camera)

    def close(self) -> None:
        """Free the renderer."""
        if self._renderer is not None:
            self._renderer.close()


def view_rig(
    live: LiveRig,
    address: PageAddress | None,
    ready: Callable[[str | None], None],
    stopped: Callable[[], bool],
    viewpoint: Viewpoint | None = None,
    *,
    boards: bool = True,
    pictures: bool = False,
) -> None:
    """Simulate a rig, and show it as `show_scene` does, with boards at first and pictures of its cameras if wanted."""
    viewpoint = viewpoint or rig_viewpoint(live.rig)
    seen = LivePictures(live) if pictures else None

    def open_page(address: PageAddress) -> ScenePage:
        from ..rig_page import RigPage

        return RigPage(live, viewpoint, address, boards=boards, pictures=seen)

    try:
        show_scene(live, viewpoint, address, open_page, ready, stopped)
    finally:
        if seen is not None:
            seen.close()


def show_scene(
    scene: ViewedScene,
    viewpoint: Viewpoint,
    address: PageAddress | None,
    open_page: Callable[[PageAddress], ScenePage],
    ready: Callable[[str | None], None],
    stopped: Callable[[], bool],
) -> None:
    """Show a scene in real time until `stopped` returns True, or MuJoCo's window is closed.

    Args:
        address: address of the browser page; None for MuJoCo's window.
        ready: called once when the viewer is open, with the URL of the page or None. Not called if `stopped` returns
            True before.
    """
    if address is None:
        from ..mujoco_window import run_window

        run_window(scene, viewpoint, FRAME_PERIOD, lambda: ready(None), stopped)
        return
    require_viser()
    page = open_page(address)
    try:
        if not stopped():
            ready(page.url)
        while not stopped():
            began = time.monotonic()
            scene.advance_to(began)
            page.update()
            time.sleep(max(0.0, began + FRAME_PERIOD - time.monotonic()))
    finally:
        page.close()


def require_viser() -> None:
    """Raise ResourceError unless viser is installed, which serves browser pages."""
    try:
        from .. import scene_page as bodies_page  # noqa: F401
    except ModuleNotFoundError as error:
        if error.name != "viser":
            raise
        raise ResourceError("the browser page needs viser: run `pip install 'yamsim[view]'`") from error
