"""What a viewer needs of whatever it shows."""

from __future__ import annotations

from typing import Protocol

import mujoco

from ..geometry.se3 import Array


class Shown(Protocol):
    """A model whose state changes while it is watched. Its methods may be called from any thread.

    Attributes:
        title: for the page's tab.
        model, data: what MuJoCo's own window draws.
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
        """Move on up to `now`, s on a steady clock."""
        ...

    def reset(self) -> None:
        """Back to where it began."""
        ...

    def body_poses(self) -> tuple[Array, Array]:
        """Every body's position (nbody, 3), m, and orientation (nbody, 4), wxyz, in `world`."""
        ...
