"""Small program tasks for tests: a cube and a plate before one arm, or other objects before two."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from yamsim_cli.core.attempt_data import Attempt, AttemptJob
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.expert import arm_sides
from yamsim_cli.core.episode.sampling import sample_attempt
from yamsim_cli.core.episode.simulator import Simulator, SimulatorCache
from yamsim_cli.core.expert.planning.arm_solvers import start_postures
from yamsim_cli.core.expert.skills.planning_context import PlanningContext
from yamsim_cli.core.files.documents.yaml_document import dump_yaml
from yamsim_cli.core.sim.sim_world import make_sim_world
from yamsim_cli.session_opener import SessionOpener

STATION = "yam_station_linear_4310_d405"

# A cube, placed onto a plate by one arm.
ONTO_PLATE: dict[str, Any] = {
    "kind": "program",
    "rig": "single_linear",
    "things": {"plate": {"of": "kitchen_plate"}, "cube": {"of": ["cube_red", "cube_blue"]}},
    "starts": {
        "plate": {"x": [0.38, 0.42], "y": [-0.16, -0.14]},
        "cube": {"x": [0.32, 0.38], "y": [0.10, 0.14], "yaw_deg": [-30, 30]},
    },
    "phrasings": {
        "training": ["put the cube onto the plate", "the cube goes onto the plate"],
        "held_out": ["serve it"],
    },
    "goal": {"all": [{"on": {"thing": "cube", "surface": "plate"}}], "for_s": 0.2},
    "expert": [{"pick": {"thing": "cube"}}, {"place": {"thing": "cube", "on": "plate"}}],
    "timing": {"ticks_per_frame": 8},
}


def changed(changes: dict[tuple[str, ...], Any], task: dict[str, Any] | None = None) -> dict[str, Any]:
    """A task, `ONTO_PLATE` unless given, with some values changed; None removes one."""

    def copied(value: Any) -> Any:
        return {key: copied(inner) for key, inner in value.items()} if isinstance(value, dict) else value

    data = copied(task or ONTO_PLATE)
    for path, value in changes.items():
        here = data
        for key in path[:-1]:
            here = here[key]
        if value is None:
            del here[path[-1]]
        else:
            here[path[-1]] = value
    return data


# A napkin, folded in half by both arms of a station.
FOLD: dict[str, Any] = changed(
    {
        ("rig",): STATION,
        ("things",): {"napkin": {"of": "soft_napkin"}},
        ("starts",): {"napkin": {"x": [0.34, 0.36], "y": [-0.02, 0.02], "yaw_deg": [10, 20]}},
        ("goal",): {"all": [{"folded": {"thing": "napkin"}}], "for_s": 0.2},
        ("expert",): [{"fold": {"thing": "napkin"}}],
        ("timing",): {"timestep": 0.004, "physics_steps_per_tick": 8, "ticks_per_frame": 2},
    }
)


def written(folder: Path, task: dict[str, Any], name: str = "small") -> Path:
    """The file of a task."""
    file = folder / f"{name}.yaml"
    file.write_text(dump_yaml(task), encoding="utf-8")
    return file


def session_of(folder: Path, task: dict[str, Any], **given: Any) -> Session:
    """A session of a task, with primitives instead of meshes."""
    opener = SessionOpener(os.environ, lambda text: None, lambda setting: f"--{setting}")
    where = opener.find_locations()
    given = {"size": "64x48", "quality": "fast", "n": 1, "workers": 1} | given
    session = Session(opener.load_record_config("default", where, task=str(written(folder, task)), **given), where)
    return session.without_meshes()


def first_attempt(simulators: SimulatorCache, number: int = 0) -> tuple[Simulator, Attempt]:
    """An attempt of seed 0, and its simulator."""
    job = AttemptJob(0, number)
    simulator = simulators.get(job)
    return simulator, sample_attempt(simulator, job)


def started(simulators: SimulatorCache) -> tuple[Simulator, Attempt, mujoco.MjData]:
    """The first attempt, and MuJoCo's state at its start."""
    simulator, attempt = first_attempt(simulators)
    assert attempt.start is not None
    data = mujoco.MjData(simulator.scene.model)
    simulator.scene.reset(data, attempt.start)
    return simulator, attempt, data


def bench_at_start(simulators: SimulatorCache) -> PlanningContext:
    """The planning context at the start of the first attempt."""
    simulator, _, data = started(simulators)
    world = make_sim_world(simulator.scene, data, arm_sides(simulator.config))
    stands = list(start_postures(simulator.config))
    return simulator.expert_planner.planning_context(world, stands, np.random.default_rng(0))
