"""Policies that begin like the task's expert and then fail, for corrections."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.policies.evaluate.policy_factory import ExpertPolicy, PrivilegedTrial

OPEN = 0.0375  # m, of each finger


class StopsHalfway(ExpertPolicy):
    """Executes a share of the expert's actions, and holds the last command from there until the trial ends.

    With `opens`, it opens the gripper where it stops. Trials before `fails_from` are completed.
    """

    def __init__(self, share: float = 0.5, opens: int = 0, fails_from: int = 0) -> None:
        super().__init__()
        self._share, self._opens, self._fails_from, self._stop = share, opens, fails_from, 0

    def prepare_trial(self, trial: PrivilegedTrial) -> Array | None:
        """Choose where to stop."""
        start = super().prepare_trial(trial)
        fails = trial.attempt.job.attempt >= self._fails_from
        self._stop = int(self._share * len(self._ctrl)) if fails else len(self._ctrl)
        return start

    def __call__(self, observation: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return the expert's command, or the last one with `done` never set."""
        if self._tick < self._stop:
            return super().__call__(observation)
        ctrl, magnet = self._ctrl[self._stop - 1].copy(), self._weld_on[self._stop - 1]
        if self._opens:
            ctrl[-1], magnet = OPEN, np.zeros_like(magnet)
        return {"ctrl": ctrl, "magnet": magnet}
