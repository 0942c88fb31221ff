"""The benchmark's cloth: its config, its start, and the expert's folds."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import pytest

pytest.importorskip("inspect_robots", reason="needs yamsim[inspect]")
pytest.importorskip("kitchenbench", reason="needs yamsim[inspect]")

from inspect_robots.rollout import derive_seed
from kitchenbench import tasks
from kitchenbench.sim import build_blueprint, make_success_checker

from tests.kitchenbench.realizations import judged_planning_scene
from yamsim_cli.core.expert.skills.common_motions import unparked_hands
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.scene.cloth import grid_edges
from yamsim_cli.kitchen_skills.fold_small import FoldSmall, bounding_box_area, possible_folds
from yamsim_cli.kitchenbench.benchmark_scene import BenchmarkScene, build_benchmark_scene, open_station_session
from yamsim_cli.kitchenbench.policy import PlanningScene, run_expert
from yamsim_cli.kitchenbench.scene_stepper import SceneStepper
from yamsim_cli.kitchenbench.skill_programs import build_scene_program
from yamsim_cli.kitchenbench.success_judges import KitchenWorld

SCENES = {scene.id: scene for scene in tasks.TASK_FACTORIES["fold_cloth"]().scenes}


def realized(name: str, epoch: int = 0) -> BenchmarkScene:
    scene = SCENES[name]
    return build_benchmark_scene(
        build_blueprint(scene, derive_seed(0, scene.init_seed, epoch)), open_station_session("64x48", images=False)
    )


def sheet(turned_deg: float = 0.0) -> Array:
    """40 x 60 cm, points every 5 cm."""
    x, y = np.meshgrid(np.linspace(-0.2, 0.2, 9), np.linspace(-0.3, 0.3, 13))
    c, s = math.cos(math.radians(turned_deg)), math.sin(math.radians(turned_deg))
    return np.stack([c * x - s * y, s * x + c * y, np.zeros_like(x)], axis=-1)


def folded(points: Array) -> Array:
    """In half, the first rows over the last ones."""
    half = points.copy()
    middle = points[6]
    half[:6] = 2 * middle - points[:6] + (0.0, 0.0, 0.005)
    return half


@pytest.mark.parametrize("turned_deg", [0.0, 30.0, 77.0])
def test_a_flat_cloth_is_folded_through_lines_of_points(turned_deg: float) -> None:
    points = sheet(turned_deg)
    whole = [way for way in possible_folds(points, single=True) if len(way.corners) == 2 and way.folded_share > 0.49]
    assert len(whole) == 4 and all(way.layers == way.points_beneath == 0 for way in whole)
    corners = {point for way in whole for point, _ in way.corners}
    assert corners == {(0, 0), (0, 8), (12, 0), (12, 8)}
    for way in whole:
        for point, to in way.corners:
            # One corner comes onto another one.
            off = np.linalg.norm(points[[0, 0, 12, 12], [0, 8, 0, 8]] - to, axis=1)
            assert off.min() < 1e-9 and np.linalg.norm(points[point] - to) > 0.3
    if not turned_deg:
        assert sorted(way.area for way in whole) == pytest.approx([0.12] * 4)
        assert bounding_box_area(points) == pytest.approx(0.24)


def test_of_several_layers_all_are_counted() -> None:
    ways = possible_folds(folded(sheet()), single=False)
    halves = {frozenset(point for point, _ in way.corners): way for way in ways if way.folded_share > 0.49}
    crease, opening = halves[frozenset({(6, 0), (6, 8)})], halves[frozenset({(0, 0), (0, 8)})]
    assert (crease.layers, crease.points_beneath) == (1, 0)
    assert (opening.layers, opening.points_beneath) == (1, 2)
    assert crease.area == pytest.approx(0.4 * 0.15)


def test_layers_are_laid_farther_than_what_has_a_wrinkle() -> None:
    wrinkled = sheet()
    wrinkled[2, 3, 2] = 0.02

    def farther(single: bool) -> list[float]:
        """How much farther along y than its mirrored points each end of a whole side is laid."""
        ways = [
            way
            for way in possible_folds(wrinkled, single)
            if way.grasped_points == ((0, 0), (0, 8)) and way.folded_share > 0.49
        ]
        return [float(to[1] - wrinkled[12, 0, 1]) for way in ways for _, to in way.corners]

    assert farther(single=True) == pytest.approx([0.02, 0.02])
    assert farther(single=False) == pytest.approx([0.04, 0.04])


@pytest.mark.parametrize(
    "name",
    [
        "fold-cloth-dish-towel",
        "fold-cloth-napkin-half",
        pytest.param("fold-cloth-crumpled-start", marks=pytest.mark.slow),
    ],
)
def test_what_the_expert_aims_at_is_what_the_checker_asks(name: str) -> None:
    scene = realized(name)
    try:
        item = scene.blueprint.objects[0]
        cloth = scene.object_configs[item.name].cloth
        assert cloth is not None and cloth.release == "clear"
        world = KitchenWorld(scene, SceneStepper(scene, 10))
        checker = make_success_checker(scene.blueprint, world)
        (skill,) = build_scene_program(scene.blueprint, scene.object_configs, scene.base_positions)
        assert isinstance(skill, FoldSmall)
        area = skill.largest_area(world.scene, item.name)
        said = checker(_Square(world, math.sqrt(area) + 2 * cloth.half_thickness))
        assert said.success, said.explanation
        assert not checker(_Square(world, 1.03 * math.sqrt(area) + 2 * cloth.half_thickness)).success
    finally:
        scene.simulator.close()


class _Square:
    """A world in which every cloth lies flat, a square with this side, m."""

    def __init__(self, world: KitchenWorld, side: float) -> None:
        self._side = side
        for query in ("contained_fraction", "contained_mass_g", "opening_fraction"):
            setattr(self, query, getattr(world, query))

    def aabb(self, name: str) -> tuple[Array, Array]:
        """A square of that side."""
        return np.zeros(3), np.array((self._side, self._side, 0.005))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "epoch", "most_actions"),
    [
        # Turned by 46 degrees, so that one corner is folded over. The hand must leave the corner without lifting it.
        ("dish-towel", 0, 80),
        # As before, but larger: the crease stands 8 cm high, and is pressed down.
        ("dish-towel", 3, 60),
        # Fingers pass through the two layers that they hold. The layers must not hang on the fingers.
        ("napkin-half", 3, 60),
    ],
)
def test_a_folded_cloth_lies_flat(name: str, epoch: int, most_actions: int) -> None:
    with judged_planning_scene(SCENES[f"fold-cloth-{name}"], epoch, root=2026) as (planning, judge):
        assert run_expert(planning, judge, 120) < most_actions and judge.evaluate()[0]
        for _ in range(12):  # until the hands have left
            planning.next_actions()
        assert judge.evaluate()[0]
        assert not unparked_hands(planning.context)


@pytest.mark.long
@pytest.mark.slow
def test_crumpled_cloth_starts_the_same_way_each_time_and_not_folded() -> None:
    first, again = realized("fold-cloth-crumpled-start"), realized("fold-cloth-crumpled-start")
    try:
        assert np.array_equal(first.start, again.start)
        (cloth,) = first.simulator.scene.cloths.values()
        # Cells are half as wide as those of flat cloth, and hands hold it by layers.
        assert cloth.grid == (17, 25) and cloth.held_by_layers
        assert first.simulator.scene.model.opt.solver == mujoco.mjtSolver.mjSOL_CG
        points = cloth.points(first.start)
        assert np.ptp(points[:, 2]) > 0.02
        lengths = np.linalg.norm(np.diff(points.reshape(*cloth.grid[::-1], 3), axis=1), axis=-1)
        rest = np.linalg.norm(np.diff(cloth.flat_points.reshape(*cloth.grid[::-1], 3), axis=1), axis=-1)
        assert np.abs(lengths / rest - 1).max() < 0.08
    finally:
        first.simulator.close()
        again.simulator.close()


@pytest.mark.slow
@pytest.mark.client_heavy  # a minute or three
def test_crumpled_cloth_is_spread_out_slid_and_folded() -> None:
    """By the benchmark's checker, within its 120 actions."""
    scene = realized("fold-cloth-crumpled-start", epoch=1)
    seed = derive_seed(0, SCENES["fold-cloth-crumpled-start"].init_seed, 1)
    planning = PlanningScene(scene, seed, 10)
    try:
        world = KitchenWorld(scene, planning.motion)
        checker = make_success_checker(scene.blueprint, world)
        assert not checker(world).success
        actions = 0
        while actions < 120 and not checker(world).success:
            actions += len(planning.next_actions())
        assert checker(world).success and actions <= 120
        (cloth,) = scene.simulator.scene.cloths.values()
        points, ends = cloth.points(planning.motion.data.qpos), grid_edges(*cloth.grid)
        lengths, rest = (np.linalg.norm(np.diff(x[ends], axis=1)[:, 0], axis=1) for x in (points, cloth.flat_points))
        assert (lengths / rest).max() < 1.08
    finally:
        planning.close()
