"""Handing a banana over by friction: hands that hold it near to each other meet side by side."""

from __future__ import annotations

import os
from itertools import islice

import mujoco
import numpy as np
import pytest

from tests.programs import STATION
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.engine import demonstrate
from yamsim_cli.core.episode.expert import sides
from yamsim_cli.core.episode.sampling import sample
from yamsim_cli.core.episode.simulator import Simulators
from yamsim_cli.core.expert.planning.arm_tools import start_stands
from yamsim_cli.core.expert.skills.handover import Handover
from yamsim_cli.core.expert.skills.pick import Pick, Reach
from yamsim_cli.core.expert.skills.place import Place
from yamsim_cli.core.expert.skills.program import program_of
from yamsim_cli.core.geometry.se3 import inverse
from yamsim_cli.core.sim.world import world_of
from yamsim_cli.core.types import EpisodeJob
from yamsim_cli.opener import Opener


@pytest.mark.slow
def test_hands_meet_side_by_side_where_they_do_not_meet_face_to_face() -> None:
    """None of the first grips of this attempt lets hands meet face to face."""
    opener = Opener(os.environ, lambda text: None, "--{}".format)
    where = opener.locations()
    config = opener.config("default", where, task="handover", rig=STATION, grasp="contact")
    job = EpisodeJob(21, 24)
    with Simulators(Session(config, where).without_meshes()) as simulators:
        simulator = simulators.of(job)
        attempt, cast = sample(simulator, job), simulator.cast
        assert attempt.start is not None
        data = mujoco.MjData(simulator.scene.model)
        simulator.scene.reset(data, attempt.start)
        world = world_of(simulator.scene, data, sides(config))
        bench = simulator.expert_tools.bench(world, list(start_stands(config)), np.random.default_rng(0))
        pick, handover, place = program_of(config.task, cast)
        assert isinstance(pick, Pick) and isinstance(handover, Handover) and isinstance(place, Place)
        [giver], banana = bench.free_hands(pick.arm), cast.one("object")
        taken = (pick.reach(bench, giver, banana, grip) for grip in bench.grips(banana, giver.max_opening))
        first = islice((reach for reach in taken if isinstance(reach, Reach)), 12)
        held = ((inverse(reach.grip.T_pinch_in_thing), reach.at) for reach in first)
        assert any(handover.fault(bench, cast, giver, banana, T, at, [place]) is None for T, at in held)
        outcome = demonstrate(simulator, attempt).outcome
    assert outcome.success, outcome.detail
