"""What the hand would touch is seen before anything moves."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from yamsim_cli.core.planning.clearance import Clearance
from yamsim_cli.core.tasks.plans import Hold, grasp_points, make_plan

from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.geometry.se3 import Array, pose, rotation_z
from yamsim_cli.core.planning.arm_tools import start_stands
from yamsim_cli.core.planning.ik import IkSolution, IkSolver
from yamsim_cli.core.resources import Locations
from yamsim_cli.core.scene.build import build_scene
from yamsim_cli.core.scene.robot import bare_arm
from yamsim_cli.core.session import Session
from yamsim_cli.core.types import Layout, Plan


@pytest.fixture(scope="module")
def friction(make_config: Callable[..., RecordConfig]) -> RecordConfig:
    return make_config({("rig",): "single_linear", ("grasp",): "contact"})


@pytest.fixture(scope="module")
def clearance(friction: RecordConfig, locations: Locations) -> Clearance:
    return Clearance(build_scene(Session(friction, locations)), 0, start_stands(friction))


@pytest.fixture(scope="module")
def ik(friction: RecordConfig, locations: Locations) -> IkSolver:
    return IkSolver(bare_arm(friction.rig.arms[0]), np.eye(4))


def _layout(banana_yaw: float = 0.0, plate: tuple[float, float] = (0.35, 0.15)) -> Layout:
    banana: Array = pose((0.42, -0.1, 0.0167), rotation_z(banana_yaw))
    return Layout({"banana": banana, "plate": pose((*plate, -0.0008))})


def _solved(friction: RecordConfig, ik: IkSolver, layout: Layout, lean: float = 0.0) -> tuple[Plan, list[IkSolution]]:
    plan = make_plan(
        friction.task, "contact", layout, np.eye(4), Hold(grasp_points(friction.task, "contact")[0], False, lean)
    )
    ik.hold(plan.T_object_in_pinch)
    joints, solutions = np.array(friction.task.start_joints), []
    for waypoint in plan.waypoints:
        solutions.append(ik.solve(waypoint.T_object_in_world, joints, 100))
        joints = solutions[-1].joints
    return plan, solutions


def test_a_hand_straight_down_is_clear(friction: RecordConfig, clearance: Clearance, ik: IkSolver) -> None:
    layout = _layout()
    assert clearance.touched(*_solved(friction, ik, layout), layout) is None


def test_a_hand_that_leans_too_far_meets_the_table(friction: RecordConfig, clearance: Clearance, ik: IkSolver) -> None:
    """Only where it leans along the closing axis: one finger is the lower for it."""
    # From the base, the banana lies across, and the fingers close away from the base and towards it.
    across, along = _layout(np.arctan2(-0.1, 0.42)), _layout(np.arctan2(-0.1, 0.42) + np.pi / 2)
    touched = clearance.touched(*_solved(friction, ik, across, 0.9), across)
    assert touched is not None
    assert touched.startswith("grasp: ")
    assert "table" in touched
    assert clearance.touched(*_solved(friction, ik, along, 0.5), along) is None


def test_a_plate_beside_the_object_is_met(friction: RecordConfig, clearance: Clearance, ik: IkSolver) -> None:
    layout = _layout(plate=(0.42 + 0.13, -0.1))
    touched = clearance.touched(*_solved(friction, ik, layout), layout)
    assert touched is not None
    assert "plate" in touched


def test_open_fingers_come_down_beside_the_object(friction: RecordConfig, clearance: Clearance, ik: IkSolver) -> None:
    layout = _layout()
    plan, solutions = _solved(friction, ik, layout)
    beside = Layout(layout.T_in_world | {"banana": pose((0.42, -0.075, 0.0167), rotation_z(0.9))})
    touched = clearance.touched(plan, solutions, beside)
    assert touched is not None
    assert "banana" in touched
