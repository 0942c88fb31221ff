from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import pytest
from yamsim_cli.core.tasks.kinds import KINDS, kind_of

from tests.core.attempts import planned as planned_attempt
from yamsim_cli.core.attempt.simulator import Simulator
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.errors import ConfigError
from yamsim_cli.core.resources import Locations
from yamsim_cli.core.session import Session
from yamsim_cli.core.tasks import kinds
from yamsim_cli.core.types import Cause, Outcome


def test_an_unknown_kind_of_task_is_told_with_those_there_are(config: RecordConfig) -> None:
    task = config.task.model_copy(update={"kind": "pickplce"})
    with pytest.raises(ConfigError) as caught:
        kind_of(task)
    assert "unknown kind 'pickplce'; did you mean 'pickplace'? valid: " in str(caught.value)


def test_a_kind_decides_what_an_attempt_is(
    make_config: Callable[..., RecordConfig], locations: Locations, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A kind that was added is used throughout, without a change elsewhere."""

    def judge(*of: object, planned: bool) -> Outcome:
        return Outcome(False, Cause.UNSTABLE, "by the new kind's judgement")

    more: Mapping[str, kinds.TaskKind] = {**KINDS, "strict": replace(KINDS["pickplace"], judge=judge)}
    monkeypatch.setattr(kinds, "KINDS", more)
    config = make_config({("task", "kind"): "strict"})
    with Simulator(Session(config, locations)) as simulator:
        assert planned_attempt(simulator, 2).outcome.detail == "by the new kind's judgement"
