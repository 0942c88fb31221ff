"""What all that is watched while it changes has in common: a lock around its state, and where everything is."""

from __future__ import annotations

import threading

import mujoco

from ..geometry.se3 import Array


class WatchedState:
    """The part of a `Shown` that does not depend on what moves it: a scene's state, read in other threads.

    Attributes:
        model, data: the scene and its state; whoever makes it sets them.
        paused: whether it stands still.
        lock: whoever changes or reads the state holds it. A page's controls act in threads of their own.
    """

    model: mujoco.MjModel
    data: mujoco.MjData

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.paused = False

    def body_poses(self) -> tuple[Array, Array]:
        """Every body's position (nbody, 3), m, and orientation (nbody, 4), wxyz, in `world`; mocap bodies included."""
        with self.lock:
            return self.data.xpos.copy(), self.data.xquat.copy()

    def cloth_points(self) -> Array:
        """Every point of all cloths (nflexvert, 3) in `world`, m."""
        with self.lock:
            points: Array = self.data.flexvert_xpos.copy()
            return points
