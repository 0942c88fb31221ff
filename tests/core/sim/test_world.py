"""Queries of a scene's state: bounding boxes of objects with moving parts, and contents of containers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, cast

import mujoco
import numpy as np
import pytest

from tests.programs import STATION, changed, session_of
from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.config.goals.role_assignment import RoleAssignment
from yamsim_cli.core.episode.expert import arm_sides
from yamsim_cli.core.episode.simulator import Simulator, SimulatorCache
from yamsim_cli.core.expert.planning.arm_solvers import start_postures
from yamsim_cli.core.expert.skills.hand import Hand
from yamsim_cli.core.expert.skills.insert import Insert
from yamsim_cli.core.expert.skills.planning_context import PlanningContext
from yamsim_cli.core.geometry.se3 import Array, pose, rotation_from_vector, rotation_z
from yamsim_cli.core.sim.geom_shapes import body_surface
from yamsim_cli.core.sim.sim_world import SimWorld, make_sim_world

INERTIA = {"mass_g": 5, "diagonal": [1e-6, 1e-6, 1e-6], "quat": [1, 0, 0, 0]}

# A ball of 16 mm, which goes through the loop of a mug's handle.
MARBLE: dict[str, Any] = {
    "name": "marble",
    "mesh": {"set": "made", "file": "marble.stl", "origin": [0, 0, 0], "rgba": [1, 1, 1, 1]},
    "inertia": INERTIA,
    "rest_height": 0.008,
    "collision": [{"type": "sphere", "centre": [0, 0, 0], "radius": 0.008}],
}

# A box of 20 x 20 x 10 cm with a lid hinged along its back, +x, which opens upwards.
BOX: dict[str, Any] = {
    "name": "lidded_box",
    "mesh": {"set": "made", "file": "lidded_box.stl", "origin": [0, 0, 0], "rgba": [1, 1, 1, 1]},
    "inertia": {"mass_g": 500, "centre": [0, 0, 0.05], "diagonal": [3e-3, 3e-3, 3e-3], "quat": [1, 0, 0, 0]},
    "rest_height": 0.0,
    "collision": [
        {"type": "box", "centre": [0, 0, 0.002], "half_size": [0.1, 0.1, 0.002]},
        {"type": "box", "centre": [0.098, 0, 0.05], "half_size": [0.002, 0.1, 0.05]},
        {"type": "box", "centre": [-0.098, 0, 0.05], "half_size": [0.002, 0.1, 0.05]},
        {"type": "box", "centre": [0, 0.098, 0.05], "half_size": [0.1, 0.002, 0.05]},
        {"type": "box", "centre": [0, -0.098, 0.05], "half_size": [0.1, 0.002, 0.05]},
    ],
    "links": [
        {
            "name": "lid",
            "position": [0.1, 0, 0.1],
            "joint": {"type": "hinge", "axis": [0, 1, 0], "range": [0, 1.5707963], "damping": 0.1},
            "inertia": {"mass_g": 200, "centre": [-0.1, 0, 0], "diagonal": [1e-3, 1e-3, 1e-3], "quat": [1, 0, 0, 0]},
            "collision": [{"type": "box", "centre": [-0.1, 0, 0.002], "half_size": [0.1, 0.1, 0.002]}],
        }
    ],
}

THINGS: dict[str, Any] = {
    "mug": "large_mug",
    "scan": "025_mug",
    "bowl": "kitchen_bowl",
    "bin": "bin",
    "tray": "serving_tray",
    "cabinet": "drawer_cabinet",
    "cube": "cube_red",
    "ball": MARBLE,
}


class PlacedScene:
    """A scene in which a test places objects."""

    def __init__(self, simulator: Simulator, world: SimWorld) -> None:
        self.scene, self.world, self._simulator = simulator.scene, world, simulator

    def bench(self) -> PlanningContext:
        """What skills find."""
        stands = list(start_postures(self._simulator.config))
        return self._simulator.expert_planner.planning_context(self.world, stands, np.random.default_rng(0))

    def put(self, name: str, at: tuple[float, float, float], R: Array | None = None) -> None:
        """Set the pose of an object in `world`."""
        data = self.world.data
        self.scene.set_object_pose(data.qpos, name, pose(at, np.eye(3) if R is None else R))
        mujoco.mj_kinematics(self.scene.model, data)

    def open(self, thing: str, part: str, to: float) -> None:
        data = self.world.data
        data.qpos[self.scene.model.joint(f"{thing}_{part}").qposadr[0]] = to
        mujoco.mj_kinematics(self.scene.model, data)


@pytest.fixture(scope="module")
def placed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PlacedScene]:
    things: dict[str, Any] = {name: {"of": kind} for name, kind in THINGS.items()} | {"box": {"of": BOX}}
    starts = {name: {"x": [0.3, 0.5], "y": [-0.3, 0.3]} for name in things}
    goal = {"on": {"thing": "cube", "surface": "tray"}}
    expert = [{"pick": {"thing": "cube"}}, {"place": {"thing": "cube", "on": "tray"}}]
    task = changed({("rig",): STATION, ("things",): things, ("starts",): starts, ("goal",): goal, ("expert",): expert})
    with SimulatorCache(session_of(tmp_path_factory.mktemp("task"), task)) as simulators:
        simulator = simulators.get(AttemptJob(0, 0))
        data = mujoco.MjData(simulator.scene.model)
        yield PlacedScene(simulator, make_sim_world(simulator.scene, data, arm_sides(simulator.config)))


@pytest.mark.parametrize("turn", [0.0, 0.7])
@pytest.mark.parametrize(
    ("container", "at", "share"),
    [
        # In the middle; in the handle's loop, between wall and bow; beside it; and under the whole mug.
        ("mug", (0, 0, 0.012), 1),
        ("mug", (0.054, 0, 0.048), 0),
        ("mug", (0.06, 0.012, 0.048), 0),
        ("mug", (0.06, 0, 0.008), 0),
        ("mug", (0, 0, -0.03), 0),
        ("mug", (0, 0, 0.15), 0),
        ("scan", (0, 0, 0.012), 1),
        ("scan", (0.054, -0.003, 0.008), 0),
        # Beside a bowl's foot, under its wall; in it, near its rim; and half over its rim.
        ("bowl", (0.072, 0, 0.008), 0),
        ("bowl", (0.055, 0, 0.06), 1),
        ("bin", (0.1, 0.07, 0.03), 1),
        ("bin", (0, 0, 0.09), 0.5),
        ("tray", (0.09, 0.15, 0.012), 1),
    ],
)
def test_the_interior_is_what_walls_enclose(
    placed: PlacedScene, container: str, at: tuple[float, float, float], share: float, turn: float
) -> None:
    R = rotation_z(turn)
    placed.put(container, (0.4, 0.1, 0.0), R)
    placed.put("ball", tuple(R @ at + (0.4, 0.1, 0.0)))
    assert placed.world.volume_fraction_inside("ball", container) == pytest.approx(share, abs=0.05)


def test_a_container_may_lie_and_stand_on_its_head(placed: PlacedScene) -> None:
    for tilt in (1.5, 3.1):
        R = rotation_from_vector([tilt, 0.0, 0.0])
        placed.put("mug", (0.4, 0.1, 0.5), R)
        placed.put("ball", tuple(R @ (0, 0, 0.04) + (0.4, 0.1, 0.5)))
        assert placed.world.volume_fraction_inside("ball", "mug") == 1


def test_a_drawer_holds_what_is_in_it_open_and_closed(placed: PlacedScene) -> None:
    placed.put("cabinet", (0.5, 0.0, 0.0))
    for opened in (0.0, 0.06, 0.13):
        placed.open("cabinet", "drawer", opened)
        placed.put("cube", (0.5 - 0.05 - opened, 0.02, 0.017))
        assert placed.world.volume_fraction_inside("cube", "cabinet") > 0.99, opened
        # Before the drawer, under its knob.
        placed.put("cube", (0.5 - 0.15 - opened, 0.0, 0.0))
        assert placed.world.volume_fraction_inside("cube", "cabinet") == 0, opened
    # Behind the open drawer, the cabinet has no front.
    placed.put("cube", (0.5, 0.0, 0.05))
    assert placed.world.volume_fraction_inside("cube", "cabinet") == 0


def test_a_lid_is_part_of_the_block_wherever_it_is(placed: PlacedScene) -> None:
    placed.put("box", (0.4, 0.0, 0.0), rotation_z(0.4))
    placed.open("box", "lid", 0.0)
    closed = placed.world.local_box("box")
    np.testing.assert_allclose(closed, [[-0.1, -0.1, 0.0], [0.1, 0.1, 0.104]], atol=1e-6)
    placed.open("box", "lid", np.pi / 2)
    np.testing.assert_allclose(placed.world.local_box("box"), [[-0.1, -0.1, 0.0], [0.104, 0.1, 0.3]], atol=1e-6)
    placed.put("ball", (0.4, 0.0, 0.06))
    assert placed.world.volume_fraction_inside("ball", "box") == 1
    placed.put("ball", (0.4, 0.0, 0.2))
    assert placed.world.volume_fraction_inside("ball", "box") == 0
    placed.open("box", "lid", 0.0)


def test_things_are_put_within_the_walls_of_a_round_container(placed: PlacedScene) -> None:
    """The corners of the box around a bowl are outside, where the table is lower than the bowl's floor."""
    placed.put("bowl", (0.4, 0.0, 0.0))
    bench = placed.bench()
    goals = Insert(thing="ball", into="bowl").goal_poses(
        bench, RoleAssignment({"ball": ("ball",), "bowl": ("bowl",)}, {}), "ball"
    )
    assert goals
    assert max(float(np.hypot(*(T[:2, 3] - (0.4, 0.0)))) for T in goals) < 0.08


@pytest.mark.slow
def test_a_thing_goes_beside_another_one_in_a_container(placed: PlacedScene) -> None:
    """It stands on the floor. An object that is tilted in the hand may stay tilted."""
    placed.put("bin", (0.4, 0.0, 0.0))
    placed.put("cube", (0.4, 0.0, 0.03))
    bench = placed.bench()
    roles = RoleAssignment({"ball": ("ball",), "bin": ("bin",)}, {})
    goals = Insert(thing="ball", into="bin").goal_poses(bench, roles, "ball")
    assert goals[0][2, 3] < bench.world.aabb("ball")[1][2] - bench.world.aabb("ball")[0][2]
    placed.put("ball", (0.4, 0.3, 0.1), rotation_from_vector([0.2, 0.0, 0.0]))
    leaning = Insert(thing="ball", into="bin").goal_poses(bench, roles, "ball")
    assert len(leaning) == 2 * len(goals) and leaning[-1][2, 2] == pytest.approx(np.cos(0.2))


def test_what_has_no_room_in_a_container_is_not_picked_for_it(placed: PlacedScene) -> None:
    placed.put("bowl", (0.4, 0.0, 0.0))
    bench = placed.bench()
    roles = RoleAssignment({"box": ("box",), "bowl": ("bowl",)}, {})
    insert = Insert(thing="box", into="bowl")
    assert not insert.goal_poses(bench, roles, "box")
    fault = insert.infeasibility_reason(bench, roles, cast(Hand, None), "box", np.eye(4), np.zeros(6))
    assert fault == "there is no room for it on or in the bowl"


def test_the_volume_of_a_thing_moves_with_its_parts(placed: PlacedScene) -> None:
    placed.put("box", (0.4, 0.0, 0.0))
    placed.put("bin", (0.4, 0.0, -0.2))
    placed.put("cabinet", (1.0, 0.0, 0.0))
    placed.open("cabinet", "drawer", 0.13)
    low, high = placed.world.local_box("cabinet")
    np.testing.assert_allclose(low, [-0.26, -0.12, 0.0], atol=1e-6)
    inside = placed.world.volume_fraction_in_box("cabinet", "cabinet")
    assert inside == 1 and high[2] == pytest.approx(0.11)
    points = np.concatenate([points for points, _ in placed.world.volume_samples("cabinet")])
    assert points[:, 0].min() < 1.0 - 0.25


def test_the_surface_of_a_mesh_is_the_meshs_own() -> None:
    """And not that of a primitive of its size, by which a vessel of hulls would have another interior."""
    vertices = " ".join(f"{x} {y} {z}" for x, y, z in ((0, 0, 0), (0.1, 0, 0), (0, 0.2, 0), (0, 0, 0.3)))
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><asset><mesh name="wedge" vertex="{vertices}"/></asset>'
        '<worldbody><body><geom type="mesh" mesh="wedge"/></body></worldbody></mujoco>'
    )
    points, faces = body_surface(model, [0])
    assert (len(points), len(faces)) == (4, 4)
    # MuJoCo rotates a mesh into its principal axes, and its geom back.
    assert np.ptp(points, axis=0) == pytest.approx([0.1, 0.2, 0.3], abs=1e-6)
