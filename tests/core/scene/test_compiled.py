"""Steps of a compiled scene."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.scene.build import build_scene


def test_a_step_without_a_solution_is_made_again_with_another_solver(
    config: RecordConfig, locations: Locations, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = build_scene(Session(config, locations).without_meshes())
    step, newton, solvers = mujoco.mj_step, scene.model.opt.solver, list[int]()
    failing = 3

    def step_that_fails_once(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        solvers.append(model.opt.solver)
        step(model, data)
        if len(solvers) == failing:
            data.qvel[-1] = 23_000.0

    data, expected = mujoco.MjData(scene.model), mujoco.MjData(scene.model)
    for state in (data, expected):
        scene.reset(state, scene.model.qpos0)
    monkeypatch.setattr(mujoco, "mj_step", step_that_fails_once)
    scene.step(data, 5)
    cg = int(mujoco.mjtSolver.mjSOL_CG)
    assert solvers == [newton, newton, newton, cg, newton, newton] and scene.model.opt.solver == newton
    monkeypatch.undo()
    for number in range(1, 6):
        scene.model.opt.solver = cg if number == failing else newton
        step(scene.model, expected)
    np.testing.assert_array_equal(data.qpos, expected.qpos)
    np.testing.assert_array_equal(data.qvel, expected.qvel)
    assert data.time == expected.time
