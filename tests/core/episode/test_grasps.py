"""Grasps by welds, by friction, and of cloth by constraints; and how objects move in the hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.attempts import start_of
from tests.programs import FOLD, first_attempt, session_of
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.episode import Episode
from yamsim_cli.core.episode.episode_rules import MAX_WELD_DISTANCE, EpisodeRules
from yamsim_cli.core.episode.expert import arm_sides
from yamsim_cli.core.episode.grasps import (
    ClothGraspSimulator,
    FrictionGraspSimulator,
    WeldGraspSimulator,
    is_weld_active,
    make_grasp_simulator,
    set_weld_pose,
)
from yamsim_cli.core.episode.held_objects import SETTLED_TICKS, HeldObjectSlipMonitor
from yamsim_cli.core.episode.simulator import Simulator, SimulatorCache
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array, pose, quat_from_rotation, rotation_from_vector
from yamsim_cli.core.scene.compiled import ArmAddresses, CompiledScene
from yamsim_cli.core.sim.sim_world import make_sim_world

ON, OFF = [True], [False]


@pytest.fixture(scope="module")
def simulator(config: RecordConfig, locations: Locations) -> Simulator:
    return Simulator(Session(config, locations))


@pytest.fixture(scope="module")
def friction(make_config: Callable[..., RecordConfig], locations: Locations) -> Simulator:
    return Simulator(Session(make_config({("rig",): "single_linear", ("grasp",): "contact"}), locations))


def at_hand(simulator: Simulator, below: float, thing: str = "banana") -> mujoco.MjData:
    """Return the start with a thing's origin `below` meters under the hand's pinch point."""
    scene = simulator.scene
    data = mujoco.MjData(scene.model)
    scene.reset(data, start_of(simulator))
    qpos, address = data.qpos.copy(), scene.object_qpos[thing]
    qpos[address : address + 3] = data.site("pinch_site").xpos - (0.0, 0.0, below)
    scene.reset(data, qpos)
    return data


def weld_of(scene: CompiledScene) -> tuple[ArmAddresses, int]:
    assert scene.first_arm.weld is not None
    return scene.first_arm, scene.first_arm.weld


def test_the_grasp_follows_from_the_scene(simulator: Simulator, friction: Simulator, tmp_path: Path) -> None:
    assert isinstance(make_grasp_simulator(simulator.scene, None), WeldGraspSimulator)
    assert isinstance(make_grasp_simulator(friction.scene, None), FrictionGraspSimulator)
    with SimulatorCache(session_of(tmp_path, FOLD)) as simulators:
        assert isinstance(make_grasp_simulator(first_attempt(simulators)[0].scene, None), ClothGraspSimulator)


def test_a_magnet_takes_what_is_near_and_lets_go_of_it(simulator: Simulator) -> None:
    scene, data = simulator.scene, at_hand(simulator, 0.02)
    (arm, weld), grasp = weld_of(scene), make_grasp_simulator(scene, MAX_WELD_DISTANCE)
    ctrl = data.ctrl.copy()
    assert list(grasp.update(data, ctrl, OFF)) == [False] and not is_weld_active(data, arm)
    assert list(grasp.update(data, ctrl, ON)) == [True] and is_weld_active(data, arm)
    assert scene.model.eq_obj2id[weld] == scene.model.body("banana").id
    assert list(grasp.update(data, ctrl, OFF)) == [False] and not is_weld_active(data, arm)


@pytest.mark.parametrize(("reach", "takes"), [(MAX_WELD_DISTANCE, False), (None, True), (0.5, True)])
def test_a_magnet_takes_nothing_out_of_its_reach(simulator: Simulator, reach: float | None, takes: bool) -> None:
    scene, data = simulator.scene, at_hand(simulator, 0.12)
    assert list(make_grasp_simulator(scene, reach).update(data, data.ctrl, ON)) == [takes]


@pytest.mark.parametrize("thing", ["banana", "plate"])
def test_a_magnet_takes_the_nearest_thing(simulator: Simulator, thing: str) -> None:
    scene, data = simulator.scene, at_hand(simulator, 0.04, thing)
    _, weld = weld_of(scene)
    assert list(make_grasp_simulator(scene, None).update(data, data.ctrl, ON)) == [True]
    assert scene.model.body(int(scene.model.eq_obj2id[weld])).name == thing


def test_a_magnet_that_stays_on_keeps_what_it_holds(simulator: Simulator) -> None:
    """Another object that comes nearer changes nothing."""
    scene, data = simulator.scene, at_hand(simulator, 0.03)
    (_, weld), grasp = weld_of(scene), make_grasp_simulator(scene, None)
    grasp.update(data, data.ctrl, ON)
    plate, banana = scene.object_qpos["plate"], scene.object_qpos["banana"]
    data.qpos[plate : plate + 3], data.qpos[banana + 2] = data.site("pinch_site").xpos, 0.5
    mujoco.mj_forward(scene.model, data)
    assert list(grasp.update(data, data.ctrl, ON)) == [True]
    assert scene.model.eq_obj2id[weld] == scene.model.body("banana").id


def test_attaching_moves_nothing(simulator: Simulator) -> None:
    scene, data = simulator.scene, at_hand(simulator, 0.03)
    arm, weld = weld_of(scene)
    before = data.body("banana").xpos.copy()
    set_weld_pose(scene.model, arm, data, scene.model.body("banana").id)
    data.eq_active[weld] = True
    mujoco.mj_step(scene.model, data, 50)
    mujoco.mj_kinematics(scene.model, data)
    # The weld is soft: a banana's weight pulls it down by less than 2 mm.
    np.testing.assert_allclose(data.body("banana").xpos, before, atol=2e-3)


def test_a_magnet_has_no_effect_where_friction_holds(friction: Simulator) -> None:
    data = at_hand(friction, 0.02)
    assert list(make_grasp_simulator(friction.scene, None).update(data, data.ctrl, ON)) == [False]
    task, start = friction.config.task, start_of(friction)
    episode = Episode(friction.scene, start, task.timing, ("right",), None)
    for _ in range(3):
        episode.step(start[friction.scene.first_arm.recorded_qpos][None], ON)
    assert not episode.executed_actions.magnet.any() and episode.welds_active == (False,)


def test_records_say_whether_a_weld_holds_and_not_what_was_commanded(simulator: Simulator) -> None:
    scene, start = simulator.scene, start_of(simulator)
    command = start[scene.first_arm.recorded_qpos][None]
    far = Episode(scene, start, simulator.config.task.timing, ("right",), None, EpisodeRules())
    far.step(command, ON)
    near = Episode(
        scene, at_hand(simulator, 0.03).qpos.copy(), simulator.config.task.timing, ("right",), None, EpisodeRules()
    )
    near.step(command, ON)
    assert (far.executed_actions.magnet[0, 0], near.executed_actions.magnet[0, 0]) == (False, True)
    assert (far.welds_active, near.welds_active) == ((False,), (True,))
    assert near.world.holding_sides("banana") == {"right"}


def test_cloth_is_held_by_fingers_that_press_on_it_and_let_go_when_they_open(tmp_path: Path) -> None:
    with SimulatorCache(session_of(tmp_path, FOLD)) as simulators:
        simulator, attempt = first_attempt(simulators)
        scene, config = simulator.scene, simulator.config
        assert attempt.start is not None
        start, cloth, arm = attempt.start.copy(), scene.cloths["napkin"], scene.first_arm
        assert arm.fingers is not None
        data = mujoco.MjData(scene.model)
        start[arm.fingers.qpos] = 0.004 * arm.fingers.sign
        scene.reset(data, start)
        site = data.site(f"{arm.prefix}pinch_site")
        points = cloth.points(start).copy()
        # The sheet in the plane between the pads, with a corner among them.
        turned = site.xmat.reshape(3, 3)
        flat = points - points[0]
        along, across = flat[8] / np.linalg.norm(flat[8]), flat[72] / np.linalg.norm(flat[72])
        placed = site.xpos + np.outer(flat @ along, turned[:, 0]) + np.outer(flat @ across, turned[:, 2])
        start[cloth.qpos] = placed - cloth.flat_points
        episode = Episode(scene, start, config.task.timing, arm_sides(config), None)
        # Grasped before it falls.
        for opening, ticks, holds in ((0.004, 1, False), (-0.004, 10, True), (0.02, 5, False)):
            command = np.array([start[one.recorded_qpos] for one in scene.arms])
            command[0, -1] = opening
            for _ in range(ticks):
                episode.step(command, [False, False])
            assert bool(episode.executed_actions.magnet[-1, 0]) is holds, opening
            assert episode.world.holding_sides("napkin") == ({arm_sides(config)[0]} if holds else frozenset())
        # No weld, whatever the hand holds.
        assert episode.welds_active == (False, False)


class InHand:
    """A banana welded to the hand, whose pose in the hand the test sets."""

    def __init__(self, simulator: Simulator) -> None:
        self.scene, self.data = simulator.scene, at_hand(simulator, 0.03)
        self.world = make_sim_world(self.scene, self.data, arm_sides(simulator.config))
        self.things = HeldObjectSlipMonitor(self.scene, self.world)
        self.grasp = make_grasp_simulator(self.scene, None)
        self.address = self.scene.object_qpos["banana"]
        self.place: Array = self.data.qpos[self.address : self.address + 3].copy()
        self.R: Array = self.data.body("banana").xmat.reshape(3, 3).copy()

    def watch(self, ticks: int, *, on: bool = True, moved: float = 0.0, tilted: float = 0.0) -> tuple[float, float]:
        """Move the object along x by `moved` (m), tilt it by `tilted` (rad), and step; return slip and tilt."""
        T = pose(self.place + np.array([moved, 0.0, 0.0]), rotation_from_vector([tilted, 0.0, 0.0]) @ self.R)
        self.grasp.update(self.data, self.data.ctrl, [on])
        self.data.qpos[self.address : self.address + 3] = T[:3, 3]
        self.data.qpos[self.address + 3 : self.address + 7] = quat_from_rotation(T[:3, :3])
        mujoco.mj_kinematics(self.scene.model, self.data)
        mujoco.mj_collision(self.scene.model, self.data)
        for _ in range(ticks):
            self.things.measure_tick(self.world.holding_sides_by_object())
        return self.things.slip, self.things.tilt


@pytest.fixture
def in_hand(simulator: Simulator) -> InHand:
    return InHand(simulator)


def test_slip_is_how_far_a_settled_thing_moved_in_the_hand(in_hand: InHand) -> None:
    assert in_hand.watch(SETTLED_TICKS) == (0.0, pytest.approx(0.0, abs=1e-6))
    assert in_hand.watch(1, moved=0.005)[0] == pytest.approx(0.005, abs=1e-6)
    # The largest value counts.
    assert in_hand.watch(3)[0] == pytest.approx(0.005, abs=1e-6)


def test_motion_while_the_fingers_close_is_not_slip(in_hand: InHand) -> None:
    in_hand.watch(SETTLED_TICKS - 1)
    in_hand.watch(1, moved=0.01)
    assert in_hand.watch(5, moved=0.01)[0] == pytest.approx(0.0, abs=1e-6)


def test_an_object_grasped_again_settles_again(in_hand: InHand) -> None:
    in_hand.watch(2 * SETTLED_TICKS)
    in_hand.watch(1, on=False)
    assert in_hand.watch(2 * SETTLED_TICKS, moved=0.02)[0] == pytest.approx(0.0, abs=1e-6)


def test_tilt_is_that_of_a_things_vertical_axis_since_it_was_taken(in_hand: InHand) -> None:
    in_hand.watch(1, tilted=0.3)
    assert in_hand.watch(1, tilted=0.3 + math.radians(10))[1] == pytest.approx(math.radians(10), abs=1e-6)
    assert in_hand.watch(1, tilted=0.3)[1] == pytest.approx(math.radians(10), abs=1e-6)
    in_hand.watch(1, on=False)
    # Without a holding hand, nothing is measured.
    assert in_hand.watch(1, on=False, tilted=1.0)[1] == pytest.approx(math.radians(10), abs=1e-6)
    assert in_hand.watch(1, tilted=1.0)[1] == pytest.approx(math.radians(10), abs=1e-6)
