"""Where hands meet for a handover: side by side if they are near to each other, and level between uneven bases."""

from __future__ import annotations

import os
from itertools import islice
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.programs import STATION
from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.execution import simulate_expert
from yamsim_cli.core.episode.expert import arm_sides
from yamsim_cli.core.episode.sampling import sample_attempt
from yamsim_cli.core.episode.simulator import SimulatorCache
from yamsim_cli.core.expert.planning.arm_solvers import start_postures
from yamsim_cli.core.expert.skills.handover import Handover
from yamsim_cli.core.expert.skills.pick import Pick, ReachableGrasp
from yamsim_cli.core.expert.skills.place import Place
from yamsim_cli.core.expert.skills.program import build_program
from yamsim_cli.core.files.documents.yaml_document import dump_yaml, load_yaml
from yamsim_cli.core.geometry.se3 import invert_pose
from yamsim_cli.core.sim.sim_world import make_sim_world
from yamsim_cli.session_opener import SessionOpener


@pytest.mark.slow
def test_hands_meet_side_by_side_where_they_do_not_meet_face_to_face() -> None:
    """None of the first grips of this attempt lets hands meet face to face."""
    opener = SessionOpener(os.environ, lambda text: None, "--{}".format)
    where = opener.find_locations()
    config = opener.load_record_config("default", where, task="handover", rig=STATION, grasp="contact")
    job = AttemptJob(21, 24)
    with SimulatorCache(Session(config, where).without_meshes()) as simulators:
        simulator = simulators.get(job)
        attempt, cast = sample_attempt(simulator, job), simulator.roles
        assert attempt.start is not None
        data = mujoco.MjData(simulator.scene.model)
        simulator.scene.reset(data, attempt.start)
        world = make_sim_world(simulator.scene, data, arm_sides(config))
        bench = simulator.expert_planner.planning_context(world, list(start_postures(config)), np.random.default_rng(0))
        pick, handover, place = build_program(config.task, cast)
        assert isinstance(pick, Pick) and isinstance(handover, Handover) and isinstance(place, Place)
        [giver], banana = bench.free_hands(pick.arm), cast.object_of("object")
        taken = (
            pick.find_reachable_grasp(bench, giver, banana, grip)
            for grip in bench.grasp_candidates(banana, giver.max_opening)
        )
        first = islice((reach for reach in taken if isinstance(reach, ReachableGrasp)), 12)
        held = ((invert_pose(reach.candidate.T_pinch_in_thing), reach.grasp_joints) for reach in first)
        assert any(handover.infeasibility_reason(bench, cast, giver, banana, T, at, [place]) is None for T, at in held)
        outcome = simulate_expert(simulator, attempt).outcome
    assert outcome.success, outcome.detail


@pytest.mark.parametrize("height", [-0.0044, 0.02])
def test_hands_meet_between_bases_of_unequal_height(height: float, tmp_path: Path) -> None:
    opener = SessionOpener(os.environ, lambda text: None, "--{}".format)
    where = opener.find_locations()
    rig = load_yaml(where.config_file("rigs", "bimanual")).data
    rig["arms"][0]["base"] = {"position": [0, 0, height]}
    (tmp_path / "uneven.yaml").write_text(dump_yaml(rig))
    config = opener.load_record_config("default", where, task="handover", rig=str(tmp_path / "uneven.yaml"))
    job = AttemptJob(1, 0)
    with SimulatorCache(Session(config, where).without_meshes()) as simulators:
        simulator = simulators.get(job)
        outcome = simulate_expert(simulator, sample_attempt(simulator, job)).outcome
    assert outcome.success, outcome.detail
