from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

from ..core.errors import ResourceError
from .viewed_scene import ViewedScene
from .viewpoint import Viewpoint

_KEY_SPACE = 32  # key code in GLFW
_CLOSE_SECONDS = 5.0  # s, longest wait for the window's thread, which renders at most one more image


def run_window(
    shown: ViewedScene, viewpoint: Viewpoint, period: float, ready: Callable[[], None], stopped: Callable[[], bool]
) -> None:
    """Show a scene in MuJoCo's window until the window is closed, or `stopped` returns True.

    Control sliders command the drives of a simulated rig. Space pauses. Backspace or the reset button resets the scene.

    Args:
        period: time between two images, s.
        ready: called when the window is open, unless `stopped` returns True before.
    """
    _check_display()
    with _open_window(shown) as viewer:
        with viewer.lock():
            viewer.cam.lookat[:] = viewpoint.look_at
            viewer.cam.distance = viewpoint.distance
            viewer.cam.azimuth, viewer.cam.elevation = viewpoint.azimuth_deg, viewpoint.elevation_deg
        if not stopped():
            ready()
        while viewer.is_running() and not stopped():
            began = time.monotonic()
            shown.advance_to(began)
            then = shown.simulated_seconds
            viewer.sync()
            if shown.simulated_seconds < then:
                # The window's reset sets every joint to 0, where the arms intersect themselves.
                shown.reset()
            time.sleep(max(0.0, began + period - time.monotonic()))


@contextlib.contextmanager
def _open_window(shown: ViewedScene) -> Iterator[Any]:
    import mujoco.viewer

    def handle_key(key: int) -> None:
        if key == _KEY_SPACE:
            shown.paused = not shown.paused

    others = set(threading.enumerate())
    try:
        viewer = mujoco.viewer.launch_passive(shown.model, shown.data, key_callback=handle_key)
    except RuntimeError as error:
        raise ResourceError(f"MuJoCo's window cannot be opened ({error}): use --web") from error
    try:
        yield viewer
    finally:
        viewer.close()
        # A thread of the window that outlives the interpreter reads freed memory.
        for thread in set(threading.enumerate()) - others:
            thread.join(_CLOSE_SECONDS)


def _check_display() -> None:
    """Open an invisible window as a test: without a display, MuJoCo's viewer would wait forever."""
    try:
        import glfw
    except ImportError as error:
        raise ResourceError(f"MuJoCo's window needs GLFW ({error}): use --web") from error

    # The callback stays set. By default, GLFW prints warnings about missing desktop features on stderr.
    reasons = ["GLFW gives no reason"]
    glfw.set_error_callback(lambda _, text: reasons.append(os.fsdecode(text)))
    window = None
    if glfw.init():
        glfw.window_hint(glfw.VISIBLE, glfw.FALSE)
        window = glfw.create_window(16, 16, "", None, None)
        glfw.default_window_hints()
    if not window:
        raise ResourceError(f"no window can be opened on this display ({reasons[-1]}): use --web")
    glfw.destroy_window(window)
