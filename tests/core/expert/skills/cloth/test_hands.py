"""How hands take cloth."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.programs import FOLD, first_attempt, session_of
from yamsim_cli.core.episode.execution import simulate_expert
from yamsim_cli.core.episode.simulator import SimulatorCache
from yamsim_cli.core.expert.skills.cloth import cloth_motions as hands
from yamsim_cli.core.expert.skills.cloth import point_grasps as reach


@pytest.mark.slow
def test_hands_that_come_too_high_feel_for_cloth(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # An arm that reaches far comes to rest that much higher than commanded.
    monkeypatch.setattr(reach, "HALF_PAD", reach.HALF_PAD + 0.0018)
    with SimulatorCache(session_of(tmp_path, FOLD)) as simulators:
        simulator, attempt = first_attempt(simulators)
        felt = simulate_expert(simulator, attempt)
        monkeypatch.setattr(hands, "RETRY_DEPTHS", ())
        missed = simulate_expert(simulator, attempt)
    assert felt.outcome.success, felt.outcome.detail
    assert "missed its corner" in missed.outcome.detail
