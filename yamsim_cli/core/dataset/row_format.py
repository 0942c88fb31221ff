"""Joints and commands as rows of numbers with names, as recordings and exports have them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..attempt_data import WeldStates
from ..config.recording import RecordConfig
from ..config.rig import RigConfig
from ..geometry.se3 import Array
from .lowdim import with_opening_shares

Row = NDArray[np.float32]


def arm_prefixes(rig: RigConfig) -> tuple[str, ...]:
    """The prefix of the names of each arm's parts, in the order of recordings; empty for a lone arm."""
    return tuple(f"{rig.arms[k].side}_" for k in rig.recording_order) if len(rig.arms) > 1 else ("",)


def drive_names(rig: RigConfig) -> tuple[str, ...]:
    """Names of all drives, which are those of the numbers in `joints`, in the order of recordings."""
    return tuple(
        prefix + name
        for prefix, k in zip(arm_prefixes(rig), rig.recording_order, strict=True)
        for name in rig.arms[k].robot.drives
    )


def weld_names(config: RecordConfig) -> tuple[str, ...]:
    """Names of an action's numbers for each arm's weld; empty where actions are joints."""
    return () if config.action == "joints" else tuple(f"{prefix}magnet" for prefix in arm_prefixes(config.rig))


@dataclass(frozen=True)
class RowFormat:
    """States as rows of joints and grippers; actions as rows of the drives' commands, followed by the welds.

    Attributes:
        drives: names of a state's numbers, and of an action's commands.
        welds: names of an action's welds.
        full: largest opening of one finger of each arm in use (arms,), m. With it, grippers are shares of this
            opening, 0 closed .. 1 open; with None, grippers are openings of one finger, m.
    """

    drives: tuple[str, ...]
    welds: tuple[str, ...]
    arms: int
    full: tuple[float, ...] | None

    @classmethod
    def from_config(cls, config: RecordConfig) -> RowFormat:
        """The rows that a config records."""
        rig = config.rig
        fingers = [rig.arms[k].robot.fingers for k in rig.recording_order]
        full = tuple(each.full_opening for each in fingers if each is not None)
        shares = config.action == "joints"
        return cls(drive_names(rig), weld_names(config), len(rig.recording_order), full if shares else None)

    @property
    def actions(self) -> tuple[str, ...]:
        """Names of an action's numbers."""
        return self.drives + self.welds

    def state(self, joints: Array) -> Row:
        """The row of each arm's joints in rad and its finger's opening in m, (arms, drives)."""
        return self._with_shares(joints).ravel().astype(np.float32)

    def action(self, ctrl: Array, holds: WeldStates) -> Row:
        """The row of each arm's commands (arms, drives), rad and m, and whether its weld is on (arms,)."""
        row = self._with_shares(ctrl).ravel()
        return (np.append(row, holds) if self.welds else row).astype(np.float32)

    def command(self, row: NDArray[np.floating]) -> tuple[Array, WeldStates]:
        """An action's commands of each arm (arms, drives), rad and m, and whether its weld is on (arms,)."""
        count = len(self.drives)
        ctrl = np.array(row[:count], dtype=np.float64).reshape(self.arms, -1)
        if self.full is not None:
            ctrl[:, -1] *= self.full
        welds = row[count:] > 0.5 if self.welds else np.zeros(self.arms, bool)
        return ctrl, np.asarray(welds, bool)

    def _with_shares(self, values: Array) -> Array:
        return values if self.full is None else with_opening_shares(values, self.full)
