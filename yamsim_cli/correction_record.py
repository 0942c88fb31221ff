"""Who acted in each frame of a correction: a policy, and from the takeover on the expert."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

WHO = "who"  # frame key; only in corrections
EXPERT, POLICY = 0, 1  # its values
POLICY_SUCCEEDED = "policy_succeeded"  # cause in the ledger of a trial in which there was nothing to correct
Actor = Literal["expert", "policy"]


@dataclass(frozen=True)
class CorrectionRecord:
    """Origin of an episode of `yamsim correct`, in `episode.json`.

    Attributes:
        policy: the policy as given to `--policy`.
        tick: first control tick of the expert; earlier commands are the policy's.
        frame: first recorded frame in which the expert acts.
        ended: how the policy's own trial ended, see `policies.evaluate.policy_trial.TrialEnd`.
        cause, detail: why that trial failed.
        trial_ticks: number of control ticks of that trial.
    """

    policy: str
    tick: int
    frame: int
    ended: str
    cause: str
    detail: str
    trial_ticks: int

    def who(self, frame: int) -> int:
        """Return who acts in a frame: `EXPERT` or `POLICY`."""
        return EXPERT if frame >= self.frame else POLICY


def with_who(frames: Sequence[Mapping[str, Any]], correction: CorrectionRecord | None) -> list[dict[str, Any]]:
    """Return all frames of an episode with the key `who`; without a correction, unchanged."""
    if correction is None:
        return [dict(frame) for frame in frames]
    return [{**frame, WHO: correction.who(k)} for k, frame in enumerate(frames)]
