"""The interface between a viewer and what it shows."""

from __future__ import annotations

from typing import Protocol

import mujoco

from ..geometry.se3 import Array


class Shown(Protocol):
    """A model whose state changes while it is watched. Its methods may be called from any thread.

    Attributes:
        title: title of the page's tab.
        model, data: the model and its state, as MuJoCo's own window shows them. A page shows another model once it is
            there.
        paused: whether it stands still.
    """

    title: str
    model: mujoco.MjModel
    data: mujoco.MjData
    paused: bool

    @property
    def time(self) -> float:
        """Simulated time, s."""
        ...

    def advance(self, now: float) -> None:
        """Move on to `now`, s on a steady clock."""
        ...

    def reset(self) -> None:
        """Go back to the beginning."""
        ...

    def body_poses(self) -> tuple[Array, Array]:
        """Every body's position (nbody, 3), m, and orientation (nbody, 4), wxyz, in `world`."""
        ...

    def cloth_points(self) -> Array:
        """Every point of all cloths (nflexvert, 3) in `world`, m."""
        ...
