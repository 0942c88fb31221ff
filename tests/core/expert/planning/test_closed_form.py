"""Analytic inverse kinematics: complete and exact, for arms whose axes point either way."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import ArrayLike

from tests.made_up_robot import RIG, write_robot
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.expert.planning.analytic_ik import AnalyticIk, find_analytic_ik
from yamsim_cli.core.expert.planning.ik import IkSolver, Tolerance
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array, pose, rotation_from_vector, rotation_vector
from yamsim_cli.core.scene.arm_model import kinematic_model

WHERE = Locations.from_environment({})
SHIPPED = ["single" if name == "i2rt_yam" else f"{name}+linear_4310" for name in WHERE.config_names("robots")]
ANYHOW = Tolerance(1e-3, math.radians(1.0), joint_limit_margin=0.0)


def _model(rig: str, where: Locations = WHERE) -> mujoco.MjModel:
    return kinematic_model(load_config(RigConfig, "rigs", rig, where).arms[0])


def _solver(model: mujoco.MjModel) -> AnalyticIk:
    solver = find_analytic_ik(model)
    assert solver is not None
    return solver


class Forward:
    """Forward kinematics of an arm's flange."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model, self._data = model, mujoco.MjData(model)
        self._flange = int(model.site("tool").bodyid[0])

    def __call__(self, joints: ArrayLike) -> Array:
        self._data.qpos[:] = joints
        mujoco.mj_kinematics(self._model, self._data)
        return pose(self._data.xpos[self._flange], self._data.xmat[self._flange].reshape(3, 3))


def _require_exact(model: mujoco.MjModel, solutions: Array, T: Array) -> None:
    (low, high), forward = model.jnt_range.T, Forward(model)
    assert solutions.shape[1:] == (6,)
    assert ((solutions >= low) & (solutions <= high)).all()
    for joints in solutions:
        reached = forward(joints)
        assert np.linalg.norm(reached[:3, 3] - T[:3, 3]) <= 1e-6
        assert np.linalg.norm(rotation_vector(reached[:3, :3].T @ T[:3, :3])) <= 1e-6


def _require_complete(model: mujoco.MjModel, number: int) -> None:
    solver, forward = _solver(model), Forward(model)
    for joints in np.random.default_rng(7).uniform(*model.jnt_range.T, (number, 6)):
        T = forward(joints)
        solutions = solver.all_solutions(T)
        _require_exact(model, solutions, T)
        assert np.abs(solutions - joints).max(axis=1).min() <= 1e-9


@pytest.mark.parametrize("number", [300, pytest.param(1000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("rig", SHIPPED)
def test_all_joints_of_a_pose_are_found(rig: str, number: int) -> None:
    _require_complete(_model(rig), number)


@pytest.mark.parametrize("margin", [0.0, 0.15])
@pytest.mark.parametrize("rig", SHIPPED)
def test_many_poses_are_looked_at_together_as_one_by_one(rig: str, margin: float) -> None:
    model = _model(rig)
    solver, forward, (low, high) = _solver(model), Forward(model), model.jnt_range.T
    rng = np.random.default_rng(5)
    poses = [forward(joints) for joints in rng.uniform(low, high, (150, 6))]
    places, turns = rng.uniform((-0.2, -0.6, -0.1), (0.7, 0.6, 0.7), (150, 3)), rng.uniform(-2, 2, (150, 3))
    poses += [pose(place, rotation_from_vector(turn)) for place, turn in zip(places, turns, strict=True)]
    # At zero, the last axis is parallel to three others: joints 4 and 6 are not determined.
    poses.append(forward(np.clip(np.zeros(6), low, high)))
    margins = [np.minimum(found - low, high - found).min(axis=1) for found in map(solver.all_solutions, poses)]
    reached = np.array([bool((one >= margin).any()) for one in margins])
    asked = solver.may_be_reachable(np.array(poses), margin)
    assert not (reached & ~asked).any()
    # Rounding, and undetermined joints, may add a pose that is out of reach.
    assert (asked & ~reached).sum() <= 2
    assert 50 < reached.sum() < 250


@pytest.mark.parametrize("rig", SHIPPED)
def test_a_pose_out_of_reach_has_no_joints(rig: str) -> None:
    solver = _solver(_model(rig))
    rng = np.random.default_rng(1)
    for place in rng.normal(size=(50, 3)):
        R = rotation_from_vector(rng.normal(size=3))
        far, within = 1.5 * place / np.linalg.norm(place), np.array([0.0, 0.0, 0.02])
        assert solver.all_solutions(pose(far, R)).shape == (0, 6)
        # In its own base, where the links are too long to fold, or joints beyond their limits.
        assert solver.all_solutions(pose(within, np.diag([1.0, -1.0, -1.0]))).shape == (0, 6)


_CHAIN = """\
<mujoco><compiler angle="radian" boundmass="0.1" boundinertia="0.1"/><worldbody>
  <body pos="0.01 0.02 0.07" quat="0.9 0.1 0.3 0.2">{0}<body pos="0.02 0.03 0.05">{1}<body pos="-0.26 0.01 0.02">{2}
  <body pos="0.24 -0.02 0.06">{3}<body pos="{wrist}">{4}<body pos="{last}">{5}<site name="tool"/>
  </body></body></body></body></body></body></worldbody></mujoco>
"""
_AXES = ("0 0 1", "0 1 0", "0 1 0", "0 1 0", "0 0 1", "1 0 0")


def _chain(
    axes: Sequence[str], wrist: str = "0.07 0.01 0.03", last: str = "0 0 0", sixth: str = 'range="-3 3"'
) -> mujoco.MjModel:
    """An arm of six joints about given axes; the last two axes meet where `last` is along one of them."""
    joints = [f'<joint axis="{axis}" range="-3 3"/>' for axis in axes[:5]] + [f'<joint axis="{axes[5]}" {sixth}/>']
    return mujoco.MjModel.from_xml_string(_CHAIN.format(*joints, wrist=wrist, last=last))


@pytest.mark.parametrize("signs", list(itertools.product((1, -1), repeat=3)))
def test_parallel_axes_may_point_in_opposite_directions(signs: tuple[int, ...]) -> None:
    _require_complete(_chain(["0 0 1", *(f"0 {sign} 0" for sign in signs), "0 0 -1", "1 0 0"]), 50)


def test_axes_need_not_be_at_right_angles() -> None:
    _require_complete(_chain(["0.1 0.2 1", *["0.3 1 0.2"] * 3, "0.2 0.1 -1", "1 0.5 0.1"]), 200)


def test_every_whole_turn_in_a_joints_range_counts() -> None:
    model = _chain(_AXES, sixth='range="-9 9"')
    joints = np.array([0.3, 0.4, 1.0, 0.5, 0.7, 0.2])
    last = sorted(
        solution[5]
        for solution in _solver(model).all_solutions(Forward(model)(joints))
        if abs(solution[4] - 0.7) < 1e-6
    )
    for turn in (-math.tau, 0.0, math.tau):
        assert min(abs(angle - 0.2 - turn) for angle in last) < 1e-9


@pytest.mark.parametrize(
    "axes",
    [
        ["0 0 1", "0 1 0", "0 1 0.01", "0 1 0", "0 0 1", "1 0 0"],
        ["0 0 1", "0 1 0", "1 0 0", "0 1 0", "0 0 1", "1 0 0"],
        ["0 0 1", "0 1 0", "0 1 0", "0 1 0", "1 0 0", "1 0 0"],
        ["0 0 1", "0 1 0", "0 1 0", "0 1 0", "0 1 0", "1 0 0"],
    ],
)
def test_other_arms_have_no_closed_solution(axes: list[str]) -> None:
    assert find_analytic_ik(_chain(axes)) is None


def test_wrists_whose_axes_pass_each_other_have_none() -> None:
    assert find_analytic_ik(_chain(_AXES, last="0.05 0 0.04")) is not None
    assert find_analytic_ik(_chain(_AXES, last="0.05 0.01 0.04")) is None


def test_a_sliding_joint_has_none() -> None:
    assert find_analytic_ik(_chain(_AXES, sixth='type="slide" range="-3 3"')) is None


@pytest.mark.parametrize("rig", SHIPPED)
def test_singular_poses_are_solved(rig: str) -> None:
    """A stretched arm, a folded one, a wrist whose axes are parallel, and joints at their limits."""
    model = _model(rig)
    solver = _solver(model)
    low, high = model.jnt_range.T
    bends = [
        solver.distance_from_singularity(np.array([0.0, 0.0, angle, 0.0, 0.0, 0.0]))
        for angle in np.linspace(2.5, 3.1, 601)
    ]
    straight = 2.5 + 0.001 * int(np.argmin(bends))
    cases = [
        (0.3, 1.0, straight, 0.2, 0.1, 0.4),
        (0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        (0.2, 1.2, 1.0, -0.5, math.pi / 2, 0.3),
        (0.2, 1.2, 1.0, -0.5, -math.pi / 2, 0.3),
        tuple(low),
        tuple(high),
    ]
    for joints in cases:
        T = Forward(model)(np.clip(joints, low, high))
        solutions = solver.all_solutions(T)
        assert len(solutions) > 0
        _require_exact(model, solutions, T)
    # Both at once: few or no samples of the last joint leave the rest of the arm long enough.
    T = Forward(model)((0.3, 1.0, straight, 0.2, math.pi / 2, 0.4))
    _require_exact(model, solver.all_solutions(T), T)


def test_a_wrist_on_the_first_axis_leaves_that_joint_free() -> None:
    """The bodies' offsets along y add up to zero, so that the wrist can lie on the first axis."""
    model = _chain(_AXES, wrist="0.07 -0.02 0.03")
    solver, data = _solver(model), mujoco.MjData(model)
    for joints in np.random.default_rng(3).uniform(-1.0, 1.0, (20, 6)):
        data.qpos[:] = [joints[0], 0.0, *joints[2:]]
        mujoco.mj_kinematics(model, data)
        x, _, z = data.xmat[1].reshape(3, 3).T @ (data.xanchor[4] - data.xanchor[1])
        # Joint 2 rotates about y, until the wrist is as far behind joint 1 as it was before it.
        joints[1] = math.atan2(z, x) - math.acos(-0.02 / math.hypot(x, z))
        T = Forward(model)(joints)
        _require_exact(model, solver.all_solutions(T), T)


def test_of_several_solutions_the_nearest_is_taken() -> None:
    model = _model("single")
    solver, ik = _solver(model), IkSolver(model, np.eye(4))
    several = 0
    for joints in np.random.default_rng(2).uniform(*model.jnt_range.T, (200, 6)):
        solutions = solver.all_solutions(Forward(model)(joints))
        several += len(solutions) > 1
        for start in solutions:
            near = start + 1e-4
            np.testing.assert_allclose(ik.solve(ik.forward_kinematics(joints), near, 0).joints, start, atol=1e-6)
            found = ik.solve_from(ik.forward_kinematics(joints), [near, near + 1.0], ANYHOW)
            assert found is not None
            np.testing.assert_allclose(found, start, atol=1e-6)
    assert several > 20


def test_solutions_too_near_to_a_stop_are_not_reached() -> None:
    model = _model("single")
    ik, low = IkSolver(model, np.eye(4)), model.jnt_range[:, 0]
    joints = np.array([0.2, 1.2, 1.0, low[3] + 0.03, 0.1, 0.3])
    T = ik.forward_kinematics(joints)
    assert ik.solve_from(T, [joints], Tolerance(1e-3, 0.02, joint_limit_margin=0.05)) is None
    found = ik.solve_from(T, [joints], Tolerance(1e-3, 0.02, joint_limit_margin=0.02))
    assert found is not None
    np.testing.assert_allclose(found, joints, atol=1e-9)


def test_a_path_does_not_change_to_another_branch() -> None:
    """Where the followed branch ends at a limit, the search continues near it, though other joints would be exact."""
    model = _model("single")
    ik, solver = IkSolver(model, np.eye(4)), _solver(model)
    changes = 0
    for joints in np.random.default_rng(4).uniform(*model.jnt_range.T, (200, 6)):
        solutions = solver.all_solutions(Forward(model)(joints))
        for start in solutions:
            others = solutions[np.abs(solutions - start).max(axis=1) > 0.5]
            changes += len(others) > 0
            for other in others:
                assert (
                    np.abs(ik.solve_next(ik.forward_kinematics(other), ik.solution_at(start), 8).joints - start).max()
                    < 0.35
                )
    assert changes > 10


def test_an_arm_of_five_joints_is_searched(tmp_path: Path) -> None:
    write_robot(tmp_path)
    model = _model(RIG, Locations.from_environment({"YAMSIM_DATA_DIR": str(tmp_path)}))
    assert model.nq == 5
    assert find_analytic_ik(model) is None
    ik = IkSolver(model, np.eye(4))
    joints = np.array([0.3, 0.4, 1.2, 1.0, 0.2])
    T = ik.forward_kinematics(joints)
    assert ik.solve(T, joints + 0.1, 100).position_error < 1e-5
    assert ik.solve_next(T, ik.solution_at(joints + 0.1), 100).position_error < 1e-5
    found = ik.solve_from(T, [np.zeros(5), joints + 0.1], ANYHOW)
    assert found is not None
    np.testing.assert_allclose(ik.forward_kinematics(found), T, atol=2e-3)
    assert ik.solve_from(pose((2.0, 0.0, 0.2)), [joints], ANYHOW) is None
