"""What acted in a recorded episode, put together from its frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DatasetError
from ..geometry.se3 import Array
from ..types import Actions, Holds
from .lowdim import has_simulation


def recorded_actions(frames: Sequence[Mapping[str, Any]], nq: int, nu: int) -> tuple[Array, Actions] | None:
    """Where an episode began and what acted in it, exactly as it did.

    Args:
        frames: the episode's, each without faults, see `checks.lowdim.frame_faults`.
        nq, nu: how many positions and drives the scene has.

    Returns:
        MuJoCo's positions (nq,) at the first frame, and the actions; None where any frame holds no simulation data, as
        in a recording of real arms.

    Raises:
        DatasetError: the episode is of another scene.
    """
    if not frames or not all(map(has_simulation, frames)):
        return None
    for k, frame in enumerate(frames):
        found = len(frame["sim_qpos"]), frame["sim_ctrl"].shape[1]
        if found != (nq, nu):
            raise DatasetError(
                f"frame {k} has {found[0]} positions and {found[1]} drives, and its scene {nq} and {nu}: "
                "the episode was made with another robot model or scene than its dataset says"
            )
    counts = [len(frame["sim_ctrl"]) for frame in frames]
    actions = Actions(
        ctrl=np.concatenate([frame["sim_ctrl"] for frame in frames]),
        magnet=tuple(_holds(row) for frame in frames for row in frame["sim_magnet"]),
        joints=np.repeat([np.asarray(frame["action_joints"], dtype=float) for frame in frames], counts, axis=0),
    )
    return frames[0]["sim_qpos"], actions


def _holds(row: NDArray[np.bool_]) -> Holds:
    """One tick's entry of `sim_magnet`."""
    return tuple(map(bool, row)) if row.ndim else bool(row)
