"""Joint values and commands as flat rows of named numbers, as in recordings and exports."""

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
    """Return the name prefix of each arm, in recording order. A single arm has the prefix ""."""
    return tuple(f"{rig.arms[k].side}_" for k in rig.recording_order) if len(rig.arms) > 1 else ("",)


def drive_names(rig: RigConfig) -> tuple[str, ...]:
    """Return the names of all drives, in recording order. They name the elements of `joints` in frames."""
    return tuple(
        prefix + name
        for prefix, k in zip(arm_prefixes(rig), rig.recording_order, strict=True)
        for name in rig.arms[k].robot.drive_names
    )


def weld_names(config: RecordConfig) -> tuple[str, ...]:
    """Return the names of the weld states in an action row, one per arm; empty if actions are joints."""
    return () if config.action == "joints" else tuple(f"{prefix}magnet" for prefix in arm_prefixes(config.rig))


@dataclass(frozen=True)
class RowFormat:
    """Format of states and actions as rows. A state has joints and grippers, an action drive commands and weld states.

    Attributes:
        drives: names of the elements of a state, and of the commands in an action.
        welds: names of the weld states in an action: whether the weld of each arm holds an object.
        full_openings: largest opening of one finger of each arm (arms,), m. If given, gripper values are shares of this
            opening, 0 closed to 1 open. If None, gripper values are openings of one finger, m.
    """

    drives: tuple[str, ...]
    welds: tuple[str, ...]
    arms: int
    full_openings: tuple[float, ...] | None

    @classmethod
    def from_config(cls, config: RecordConfig) -> RowFormat:
        """Return the row format of the recordings of a config."""
        rig = config.rig
        fingers = [rig.arms[k].robot.fingers for k in rig.recording_order]
        full = tuple(each.full_opening for each in fingers if each is not None)
        shares = config.action == "joints"
        return cls(drive_names(rig), weld_names(config), len(rig.recording_order), full if shares else None)

    @property
    def action_names(self) -> tuple[str, ...]:
        """Names of the elements of an action row: drive commands, then weld states."""
        return self.drives + self.welds

    def make_state_row(self, joints: Array) -> Row:
        """Convert joints in rad and finger openings in m, given as (arms, drives), to a state row."""
        return self._with_shares(joints).ravel().astype(np.float32)

    def make_action_row(self, ctrl: Array, holds: WeldStates) -> Row:
        """Convert commands (arms, drives), rad and m, and weld states (arms,) to an action row."""
        row = self._with_shares(ctrl).ravel()
        return (np.append(row, holds) if self.welds else row).astype(np.float32)

    def split_action_row(self, row: NDArray[np.floating]) -> tuple[Array, WeldStates]:
        """Convert an action row to commands (arms, drives), rad and m, and weld states (arms,)."""
        count = len(self.drives)
        ctrl = np.array(row[:count], dtype=np.float64).reshape(self.arms, -1)
        if self.full_openings is not None:
            ctrl[:, -1] *= self.full_openings
        welds = row[count:] > 0.5 if self.welds else np.zeros(self.arms, bool)
        return ctrl, np.asarray(welds, bool)

    def _with_shares(self, values: Array) -> Array:
        return values if self.full_openings is None else with_opening_shares(values, self.full_openings)
