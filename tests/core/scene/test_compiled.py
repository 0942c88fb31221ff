"""Steps of a compiled scene."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.scene.build import build_scene
from yamsim_cli.core.scene.compiled import newton_failed


@pytest.mark.parametrize("failures", [1, 2])
def test_a_step_that_ends_far_from_a_solution_is_repeated(
    config: RecordConfig, locations: Locations, monkeypatch: pytest.MonkeyPatch, failures: int
) -> None:
    """The first repetition starts without the last accelerations, and the second one takes the other solver."""
    scene = build_scene(Session(config, locations).without_meshes())
    step, newton, solvers = mujoco.mj_step, scene.model.opt.solver, list[int]()
    first = 3

    def step_that_fails(model: mujoco.MjModel, data: mujoco.MjData) -> None:
        solvers.append(model.opt.solver)
        step(model, data)
        if first <= len(solvers) < first + failures:
            data.qvel[-1] = 23_000.0
            assert data.solver_niter[0] > 0
            data.solver.gradient[data.solver_niter[0] - 1] = 67.0

    data, expected = mujoco.MjData(scene.model), mujoco.MjData(scene.model)
    for state in (data, expected):
        scene.reset(state, scene.model.qpos0)
    monkeypatch.setattr(mujoco, "mj_step", step_that_fails)
    scene.step(data, 5)
    last = newton if failures == 1 else int(mujoco.mjtSolver.mjSOL_CG)
    assert solvers == [newton] * (2 + failures) + [last, newton, newton] and scene.model.opt.solver == newton
    monkeypatch.undo()
    for number in range(1, 6):
        if number == first:
            expected.qacc_warmstart[:] = 0.0
        scene.model.opt.solver = last if number == first else newton
        step(scene.model, expected)
    np.testing.assert_array_equal(data.qpos, expected.qpos)
    np.testing.assert_array_equal(data.qvel, expected.qvel)
    assert data.time == expected.time


def test_only_newtons_method_can_fail(config: RecordConfig, locations: Locations) -> None:
    """The CG solver often stops after its last iteration, near a solution."""
    scene = build_scene(Session(config, locations).without_meshes())
    data = mujoco.MjData(scene.model)
    scene.reset(data, scene.model.qpos0)
    mujoco.mj_step(scene.model, data)
    assert not newton_failed(scene.model, data)
    data.solver.gradient[data.solver_niter[0] - 1] = 67.0
    assert newton_failed(scene.model, data)
    scene.model.opt.solver = mujoco.mjtSolver.mjSOL_CG
    assert not newton_failed(scene.model, data)
