"""Handing a banana over by friction: hands that are near to each other meet side by side."""

from __future__ import annotations

import os

import pytest

from tests.programs import STATION
from yamsim_cli.core.attempt.engine import demonstrate
from yamsim_cli.core.attempt.sampling import sample
from yamsim_cli.core.attempt.simulators import Simulators
from yamsim_cli.core.opener import Opener
from yamsim_cli.core.session import Session
from yamsim_cli.core.types import EpisodeJob


@pytest.mark.slow
def test_hands_meet_side_by_side_where_they_do_not_meet_face_to_face() -> None:
    opener = Opener(os.environ, lambda text: None, "--{}".format)
    where = opener.locations()
    config = opener.config("default", where, task="handover_program", rig=STATION, grasp="contact")
    job = EpisodeJob(21, 24)
    with Simulators(Session(config, where).without_meshes()) as simulators:
        simulator = simulators.of(job)
        outcome = demonstrate(simulator, sample(simulator, job)).outcome
    assert outcome.success, outcome.detail
