"""Run a trial of a policy, and if it fails, let the expert take over from a state before its end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from ..core.attempt_data import ActionSequence, AttemptJob, AttemptPayload, Outcome, StepState
from ..core.closable import Closable
from ..core.config.session import Session
from ..core.dataset.dataset_paths import lowdim_path
from ..core.dataset.lowdim import content_hash, dump_frame, load_frame
from ..core.dataset.records import OutcomeRecord
from ..core.episode.attempt_payload import build_payload
from ..core.episode.execution import simulate_expert
from ..core.episode.runner import require_stated_meshes
from ..core.episode.simulator import Simulator
from ..correction_record import POLICY_SUCCEEDED, CorrectionRecord, with_who
from ..policies.evaluate.policy_choice import PolicyChoice
from ..policies.evaluate.policy_trial import MEASURED_ENDS, TrialResult, TrialRunner
from .takeover import ExpertTakeover, takeover_frame


@dataclass(frozen=True)
class CorrectionPayload(AttemptPayload):
    """The payload of a trial.

    Attributes:
        correction: None if the expert did not take over.
        ledger_outcome: outcome in the ledger if the expert did not take over. Its `success` is False even if the policy
            succeeded, because the trial has no episode.
    """

    correction: CorrectionRecord | None = None
    ledger_outcome: OutcomeRecord | None = None


class CorrectionRunner(Closable):
    """Runs trials of a policy, and corrections of those that fail. Raises as `TrialRunner` and `require_stated_meshes`.

    Args:
        session: with stated meshes, see `require_stated_meshes`.
        choice: the policy, and how it is called.
        rewind_s: as in `takeover_frame`.
    """

    def __init__(self, session: Session, choice: PolicyChoice, rewind_s: float) -> None:
        require_stated_meshes(session)
        self._choice, self._rewind_s = choice, rewind_s
        self._trials = TrialRunner(session, choice)

    def run(self, job: AttemptJob) -> CorrectionPayload:
        """Run one trial, and correct it if it fails. Only a successful correction has files."""
        trial, states = self._trials.run_with_states(job)
        if trial.outcome.success:
            detail = "the policy succeeded, so there was nothing to correct"
            update = {"success": False, "cause": POLICY_SUCCEEDED, "detail": detail}
            return _without_correction(trial, trial.outcome.model_copy(update=update))
        if trial.actions is None or trial.ended not in MEASURED_ENDS:
            return _without_correction(trial, trial.outcome)
        return self._correct(self._trials.simulators.get(job), trial, trial.actions, states)

    def _correct(
        self, simulator: Simulator, trial: TrialResult, actions: ActionSequence, states: Sequence[StepState]
    ) -> CorrectionPayload:
        timing = simulator.config.task.timing
        every = timing.ticks_per_frame
        frame = takeover_frame(states, self._rewind_s, timing.tick_seconds * every)
        tick = frame * every
        before = ActionSequence(actions.ctrl[:tick], actions.magnet[:tick], actions.joints[:tick])
        takeover = ExpertTakeover(before, simulator.config.task, simulator.roles)
        corrected = simulate_expert(simulator, trial.attempt, disturbed=False, after=takeover)
        outcome = trial.outcome
        record = CorrectionRecord(
            self._choice.name, tick, frame, trial.ended.value, outcome.cause or "", outcome.detail, trial.ticks
        )
        return _with_correction(build_payload(simulator, corrected), record)

    def close(self) -> None:
        """Close the policy, and free the renderers."""
        self._trials.close()


def _without_correction(trial: TrialResult, outcome: OutcomeRecord) -> CorrectionPayload:
    return CorrectionPayload(trial.attempt, Outcome(False), ledger_outcome=outcome)


def _with_correction(payload: AttemptPayload, correction: CorrectionRecord) -> CorrectionPayload:
    """Return a payload whose frames state who acts."""
    made = CorrectionPayload(
        payload.attempt,
        payload.outcome,
        payload.files,
        payload.frames,
        payload.content_sha256,
        payload.versions,
        payload.renderer,
        correction,
    )
    if not payload.files:
        return made
    frames: list[Mapping[str, Any]] = [load_frame(payload.files[lowdim_path(k)]) for k in range(payload.frames)]
    marked = with_who(frames, correction)
    files = {lowdim_path(k): dump_frame(frame) for k, frame in enumerate(marked)}
    return replace(made, files={**payload.files, **files}, content_sha256=content_hash(marked))
