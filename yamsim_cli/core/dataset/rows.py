"""Joints and commands as rows of numbers with names, as recordings and exports have them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..config.recording import RecordConfig
from ..config.rig import RigConfig
from ..geometry.se3 import Array
from ..types import Holds

Row = NDArray[np.float32]


def prefixes(rig: RigConfig) -> tuple[str, ...]:
    """The prefix of the names of each arm's parts, in the order of recordings; empty for a lone arm."""
    return tuple(f"{rig.arms[k].side}_" for k in rig.recorded) if len(rig.arms) > 1 else ("",)


def drive_names(rig: RigConfig) -> tuple[str, ...]:
    """Names of all drives, and of what `joints` holds, in the order of recordings."""
    return tuple(
        prefix + name
        for prefix, k in zip(prefixes(rig), rig.recorded, strict=True)
        for name in rig.arms[k].robot.drives
    )


def weld_names(config: RecordConfig) -> tuple[str, ...]:
    """Names of what an action says of each arm's weld; none where actions are joints."""
    return () if config.action == "joints" else tuple(f"{prefix}magnet" for prefix in prefixes(config.rig))


@dataclass(frozen=True)
class Rows:
    """A state is a row of joints and grippers; an action one of what drives are told, and then of welds if it has any.

    Attributes:
        drives: names of a state's numbers, and of an action's first ones.
        welds: names of an action's last ones.
        full: how far one finger of each arm opens in use (arms,), m: grippers are shares of it, 0 closed .. 1 open;
            None where they are openings of one finger, m.
    """

    drives: tuple[str, ...]
    welds: tuple[str, ...]
    arms: int
    full: tuple[float, ...] | None

    @classmethod
    def of(cls, config: RecordConfig) -> Rows:
        """Those that a config records."""
        rig = config.rig
        fingers = [rig.arms[k].robot.fingers for k in rig.recorded]
        full = tuple(each.full_opening for each in fingers if each is not None)
        shares = config.action == "joints"
        return cls(drive_names(rig), weld_names(config), len(rig.recorded), full if shares else None)

    @property
    def actions(self) -> tuple[str, ...]:
        """Names of an action's numbers."""
        return self.drives + self.welds

    def state(self, joints: Array) -> Row:
        """The row of each arm's joints in rad and its finger's opening in m, (arms, drives)."""
        return self._shared(joints).ravel().astype(np.float32)

    def action(self, ctrl: Array, holds: Holds) -> Row:
        """The row of what each arm's drives are told (arms, drives), rad and m, and whether its weld holds (arms,)."""
        row = self._shared(ctrl).ravel()
        return (np.append(row, holds) if self.welds else row).astype(np.float32)

    def command(self, row: NDArray[np.floating]) -> tuple[Array, Holds]:
        """What each arm's drives are told (arms, drives), rad and m, and whether its weld is to hold (arms,)."""
        count = len(self.drives)
        ctrl = np.array(row[:count], dtype=np.float64).reshape(self.arms, -1)
        if self.full is not None:
            ctrl[:, -1] *= self.full
        welds = row[count:] > 0.5 if self.welds else np.zeros(self.arms, bool)
        return ctrl, np.asarray(welds, bool)

    def _shared(self, values: Array) -> Array:
        if self.full is None:
            return values
        shared = values.copy()
        shared[:, -1] = np.clip(shared[:, -1] / np.asarray(self.full), 0.0, 1.0)
        return shared
