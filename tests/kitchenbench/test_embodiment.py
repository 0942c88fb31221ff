"""The station as an embodiment of Inspect Robots: its declaration, resting scenes, and answers to checkers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

pytest.importorskip("inspect_robots", reason="needs yamsim[inspect]")
pytest.importorskip("kitchenbench", reason="needs yamsim[inspect]")

from inspect_robots import Action, Scene
from inspect_robots.compat import check_compatibility
from inspect_robots.conformance import assert_embodiment_conformant
from kitchenbench import tasks
from kitchenbench.sim import build_blueprint, make_success_checker

from tests.kitchenbench.realizations import blueprint_of, seed_of
from yamsim_cli.core.errors import UsageError
from yamsim_cli.core.geometry.se3 import quat_from_rotation, rotation_from_vector
from yamsim_cli.kitchenbench.asset_configs import COMPARTMENT
from yamsim_cli.kitchenbench.benchmark_scene import build_benchmark_scene, open_station_session
from yamsim_cli.kitchenbench.embodiment import CAMERAS, JOINTS, YamsimEmbodiment
from yamsim_cli.kitchenbench.object_poses import AHEAD, BESIDE
from yamsim_cli.kitchenbench.policy import YamsimExpert
from yamsim_cli.kitchenbench.scene_stepper import SceneStepper
from yamsim_cli.kitchenbench.success_judges import KitchenWorld

REALIZED = ("place_cutlery", "stack", "place_in_rack", "handoff", "sort_cutlery", "fold_cloth")
WITH_LIDS = ("open_container", "seal_container")
PASTA = ("pour_pasta", "scoop_pasta")
SCENES = {scene.id: scene for name in REALIZED for scene in tasks.TASK_FACTORIES[name]().scenes}
FIRST_OF_TASK = {tasks.TASK_FACTORIES[name]().scenes[0].id for name in REALIZED}

# Scenes whose blueprint lets objects overlap, so that they cannot rest at the required place; and mm, distance of
# objects that it puts onto a tray's wall.
APART = {"place-in-rack-plate", "place-in-rack-bowl-tilt", "place-in-rack-cup-narrow", "place-in-rack-rightmost-slot"}
APART |= {"place-in-rack-wet-slippery", "fold-cloth-crumpled-start"}
ON_A_WALL = 25.0


@pytest.fixture(scope="module")
def embodiment() -> Iterator[YamsimEmbodiment]:
    made = YamsimEmbodiment(images=False)
    yield made
    made.close()


def test_the_embodiment_passes_the_conformance_check(embodiment: YamsimEmbodiment) -> None:
    assert_embodiment_conformant(embodiment.info)
    assert embodiment.info.action_space.shape == (14,)


def test_realized_tasks_are_compatible_and_others_are_refused(embodiment: YamsimEmbodiment) -> None:
    expert = YamsimExpert()
    for name, factory in tasks.TASK_FACTORIES.items():
        report = check_compatibility(expert, embodiment, factory())
        assert report.ok == (name in (*REALIZED, *WITH_LIDS, *PASTA)), report
        assert report.ok or {issue.code for issue in report.errors} == {"scene_target"}


def test_rates_that_are_no_whole_ticks_are_refused() -> None:
    with pytest.raises(UsageError, match=r"control_hz=7 is not a whole number of ticks of 1/30 s; give one of 30, 15"):
        YamsimEmbodiment(images=False, control_hz=7)


def test_scenes_of_others_are_refused(embodiment: YamsimEmbodiment) -> None:
    with pytest.raises(LookupError, match="scene 'mine' is not a scene of KitchenBench"):
        embodiment.reset(Scene("mine", "do it"))


def test_a_kind_without_physics_is_refused() -> None:
    blueprint = build_blueprint(tasks.TASK_FACTORIES["stack"]().scenes[0], 0)
    with pytest.raises(LookupError, match="goals of kind 'juggle' are not supported; valid: fold, handoff"):
        build_benchmark_scene(replace(blueprint, target_kind="juggle"), open_station_session("64x48", images=False))


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if name in FIRST_OF_TASK else [pytest.mark.slow]) for name in SCENES]
)
def test_scenes_come_to_rest_and_answer_all_queries(name: str, base: Any) -> None:
    blueprint = blueprint_of(SCENES[name])
    realized = build_benchmark_scene(blueprint, base)
    try:
        if name not in APART:
            assert max(realized.offsets_mm.values()) < (ON_A_WALL if name.startswith("sort") else 5.0)
        for thing, off in realized.offsets_mm.items():
            assert (off >= 5.0) == any(line.startswith(f"{thing}: came to rest") for line in realized.unrealized)
        for condition in set(blueprint.conditions) - {"slot_width_cm", "crumple_level"}:
            assert any(line.startswith(condition) for line in realized.unrealized)
        motion = SceneStepper(realized, 10)
        world = KitchenWorld(realized, motion)
        for item in blueprint.objects:
            low, high = world.aabb(item.name)
            assert (low < high).all()
            assert world.opening_fraction(item.name) == 0.0
            assert 0.0 <= world.contained_fraction(blueprint.objects[0].name, item.name) <= 1.0
            if item.asset != COMPARTMENT:
                # The box of crumpled cloth contains little of the flat cloth.
                assert world.contained_mass_g(item.name, item.name) > (0.1 if "crumple" in name else 1.0)
        verdict = make_success_checker(blueprint, world)(world)
        assert not verdict.success and "unknown" not in verdict.explanation
        start = motion.data.qpos.copy()
        motion.execute_action(motion.measured_state())
        moved = {n: np.abs((motion.data.qpos - start)[k]).max() for n, k in _places(realized).items()}
        assert max(moved.values()) < 0.002, moved
    finally:
        realized.simulator.close()


def _places(realized: Any) -> dict[str, Any]:
    scene = realized.simulator.scene
    stiff = {name: slice(k, k + 3) for name, k in scene.object_qpos.items()}
    return stiff | {name: cloth.qpos for name, cloth in scene.cloths.items()}


def test_cutlery_on_a_wall_of_the_tray_lies_beside_it(embodiment: YamsimEmbodiment) -> None:
    """Spoons side by side from x = -20 cm on, of which one lies on the wall at x = 0: the earlier ones make room."""
    scene = SCENES["sort-cutlery-spoon-heavy"]
    embodiment.reset(scene, seed=seed_of(scene))
    spoons = {item.name: item.x_cm / 100 for item in blueprint_of(scene).objects if item.asset == "spoon"}
    assert 0.0 in spoons.values()
    tray = embodiment.world.aabb("tray")
    for name, asked in spoons.items():
        low, high = embodiment.world.aabb(name)
        assert high[2] - low[2] < 0.04
        lies = BESIDE - (low[1] + high[1]) / 2
        assert -0.025 < lies - asked < 0.005
        assert low[1] > tray[1][1] or high[1] < tray[1][1], name


def test_things_lie_where_the_bench_has_them(embodiment: YamsimEmbodiment) -> None:
    """x to the robot's right is yamsim's -y; the left arm's gripper is at -x."""
    scene = SCENES["stack-tight-spacing"]
    embodiment.reset(scene, seed=seed_of(scene))
    world = embodiment.world
    first, last = (np.mean(world.aabb(name), axis=0) for name in ("cup_1", "cup_2"))
    assert last[1] - first[1] == pytest.approx(-0.10, abs=0.002)
    cup = blueprint_of(scene).objects[0]
    assert first[:2] == pytest.approx((AHEAD, BESIDE - cup.x_cm / 100), abs=0.002)
    low, high = world.aabb("cup_1")
    assert high - low == pytest.approx([0.09, 0.09, 0.10], abs=0.003)
    left, right = (np.mean(world.aabb(f"gripper_{side}"), axis=0) for side in ("left", "right"))
    assert right[1] < BESIDE < left[1]
    for query in (world.aabb, world.opening_fraction, lambda name: world.contained_fraction("cup_1", name)):
        with pytest.raises(KeyError, match="saucer"):
            query("saucer")
    with pytest.raises(KeyError, match="pasta"):
        world.contained_mass_g("pasta", "cup_1")


def test_what_is_inside_is_counted_by_volume(base: Any) -> None:
    """A knife that the test places in a compartment, then half out of it."""
    scene = SCENES["sort-cutlery-sparse"]
    realized = build_benchmark_scene(blueprint_of(scene), base)
    motion = SceneStepper(realized, 10)
    world = KitchenWorld(realized, motion)
    low, high = world.aabb("compartment_knife")
    assert np.sort((high - low)[:2]) == pytest.approx([0.09, 0.36])
    address = realized.simulator.scene.object_qpos["knife_1"]
    shares = []
    for lifted in (0.005, 0.30):
        middle = (low + high) / 2
        motion.data.qpos[address : address + 3] = middle[0], middle[1], low[2] + lifted
        mujoco.mj_forward(realized.simulator.scene.model, motion.data)
        shares.append(world.contained_fraction("knife_1", "compartment_knife"))
    assert shares[0] > 0.9 and shares[1] == 0.0
    realized.simulator.close()


@pytest.mark.parametrize(("lean_deg", "share"), [(90, 0.41), (30, 0.81), (0, 0.98)])
def test_a_plate_is_in_a_rack_of_its_size_only_if_it_lies(
    embodiment: YamsimEmbodiment, lean_deg: int, share: float
) -> None:
    """On the wires of the rack's floor, over its middle: on its edge, leaning, and flat."""
    scene = SCENES["place-in-rack-wet-slippery"]
    embodiment.reset(scene, seed=seed_of(scene))
    world = embodiment.world
    model, data = embodiment.simulator.scene.model, world.scene.data  # type: ignore[union-attr]
    T_rack = world.scene.pose("rack")
    address = model.joint("plate").qposadr[0]
    data.qpos[address + 3 : address + 7] = quat_from_rotation(
        T_rack[:3, :3] @ rotation_from_vector([0.0, np.radians(lean_deg), 0.0])
    )
    mujoco.mj_kinematics(model, data)
    low, high = world.aabb("plate")
    floor = T_rack[:3, 3] + (0.0, 0.0, 0.014)
    data.qpos[address : address + 3] += floor - [*((low + high) / 2)[:2], low[2]]
    mujoco.mj_kinematics(model, data)
    assert world.contained_fraction("plate", "rack") == pytest.approx(share, abs=0.02)


def test_doing_nothing_scores_nothing(embodiment: YamsimEmbodiment) -> None:
    scene = SCENES["stack-tight-spacing"]
    seen = embodiment.reset(scene, seed=seed_of(scene))
    start = seen.state[JOINTS]
    assert not seen.images and seen.instruction == "stack the cups"
    for _ in range(10):
        result = embodiment.step(Action(start))
        assert not result.terminated and not result.info["success"]
    # The drives are springs: the weight of the wrist camera, which gravity compensation omits, deflects them.
    assert np.abs(result.observation.state[JOINTS] - start).max() < 0.02


def test_the_same_actions_give_the_same_bits(embodiment: YamsimEmbodiment) -> None:
    scene, found = SCENES["handoff-cup-upright"], []
    for _ in range(2):
        start = embodiment.reset(scene, seed=7).state[JOINTS]
        target = start + np.linspace(-0.3, 0.2, 14)
        found.append([embodiment.step(Action(target)).observation.state[JOINTS] for _ in range(3)])
    assert np.array_equal(*found)
    arms = np.delete(np.arange(14), (6, 13))
    assert np.abs(found[0][-1] - target)[arms].max() < 0.03


@pytest.mark.render
def test_pictures_of_three_cameras() -> None:
    embodiment = YamsimEmbodiment(size="64x48")
    scene = SCENES["handoff-cup-upright"]
    images = embodiment.reset(scene, seed=0).images
    embodiment.close()
    assert tuple(images) == CAMERAS
    assert all(image.shape == (48, 64, 3) and image.std() > 5 for image in images.values())
