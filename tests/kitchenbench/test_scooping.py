"""Scenes of scooping: their dish and pieces, strokes of the tools, the mass by piece, and the checker's verdicts."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import mujoco
import numpy as np
import pytest

pytest.importorskip("inspect_robots", reason="needs yamsim[inspect]")
pytest.importorskip("kitchenbench", reason="needs yamsim[inspect]")

from kitchenbench import tasks

from tests.kitchenbench.realizations import blueprint_of, seed_of
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.objects.object_config import ObjectConfig
from yamsim_cli.core.config.task_objects import Role
from yamsim_cli.core.expert.skills.planning_context import SkillFailedError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import pose, rotation_z
from yamsim_cli.kitchen_skills import scoop, scoop_strokes
from yamsim_cli.kitchen_skills.scoop_strokes import is_free_step, pieces_on_spoon, stroke_heading, tool_of
from yamsim_cli.kitchen_skills.tilting import Tilt, straight_tilt, tilt_path
from yamsim_cli.kitchenbench.benchmark_scene import build_benchmark_scene
from yamsim_cli.kitchenbench.object_poses import feasible_poses, origin_in_world
from yamsim_cli.kitchenbench.pasta import fillings_of, is_body, is_pile, pasta_config_of
from yamsim_cli.kitchenbench.policy import PlanningScene, run_expert
from yamsim_cli.kitchenbench.scene_stepper import SceneStepper
from yamsim_cli.kitchenbench.success_judges import KitchenJudge
from yamsim_cli.loose_pieces import loose_pieces, piece_count, stacked_poses

SCENES = {scene.id: scene for scene in tasks.TASK_FACTORIES["scoop_pasta"]().scenes}
LEVEL, SHALLOW, MIXED = "scoop-pasta-measuring-cup-level", "scoop-pasta-shallow-pile", "scoop-pasta-spoon-penne"


@pytest.mark.parametrize("name", SCENES)
def test_every_dish_holds_its_pile_and_more_than_is_asked_for(name: str, base: Any) -> None:
    for epoch in range(3):
        blueprint = blueprint_of(SCENES[name], epoch)
        ((filled, filling),) = fillings_of(blueprint, base.locations).items()
        assert filled == blueprint.roles["substance"][0]
        assert filling.grams > blueprint.success_params["target_g"] * 1.4
        with_cup = any(one.asset == "measuring_cup" for one in blueprint.objects)
        assert piece_count(filling) == (44 if with_cup else 36, pytest.approx(1.0, abs=0.01))
        item = next(one for one in blueprint.objects if one.name == filled)
        assert is_pile(item) and is_body(item)
        config = pasta_config_of(item, blueprint, base.locations)
        task = base.config.task.model_copy(update={"things": {filled: Role(of=(config,), filled=filling)}})
        places = stacked_poses(task, filled)
        assert len(places) == len(loose_pieces(task)[filled])
        # One end of the dish is free for the tool.
        free = config.shape.size_mm[1] / 2000 - config.shape.wall_mm / 1000 - places[:, 1].max()
        assert free > 0.05


@pytest.mark.parametrize("epoch", [0, 1])
def test_tool_and_container_stand_beside_the_dish(epoch: int, base: Any) -> None:
    blueprint = blueprint_of(SCENES[MIXED], epoch)
    realized = build_benchmark_scene(blueprint, base)
    try:
        world = realized.new_episode().world
        low, high = world.aabb("pile")
        assert world.aabb("tool")[0][1] > high[1]
        assert world.aabb("container")[1][1] < low[1]
        is_cup = any(one.asset == "measuring_cup" for one in blueprint.objects)
        assert set(feasible_poses(realized.simulator, blueprint)) == {"container", "pile", "tool"}
        text, (pieces, size) = (
            " ".join(realized.unrealized),
            (44, "110 x 250 x 34") if is_cup else (36, "156 x 230 x 36"),
        )
        assert f"{pieces} solid pieces" in text and f"in a dish of {size} mm" in text
        cup, spoon = "diameter_mm=84 instead of 78, foot_mm=58 instead of 62", "grip_mm=20 instead of 12"
        assert f"tool: {cup if is_cup else spoon}" in text
    finally:
        realized.simulator.close()


@pytest.mark.parametrize(("name", "epoch", "is_spoon"), [(SHALLOW, 0, True), (LEVEL, 0, False)])
def test_a_stroke_stays_between_the_walls_of_the_dish(name: str, epoch: int, is_spoon: bool, base: Any) -> None:
    blueprint = blueprint_of(SCENES[name], epoch)
    configs = {
        item.name: pasta_config_of(item, blueprint, base.locations) for item in blueprint.objects if is_body(item)
    }
    grasp = pose((0.0, 0.0, 0.05), [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    tool = tool_of(configs["tool"], grasp)
    assert tool is not None and tool.is_spoon == is_spoon
    T_dish = pose((0.3, 0.4, 0.0), rotation_z(0.3))
    heading = stroke_heading(T_dish)
    for before in (0.0, 0.04):
        tips = [T @ np.array([*tool.tip, 1.0]) for T in tool.stroke(configs["pile"], T_dish, heading, 0.0, before)]
        along = np.array([(tip[:3] - T_dish[:3, 3]) @ (math.cos(heading), math.sin(heading), 0.0) for tip in tips])
        half, floor = configs["pile"].shape.size_mm[1] / 2000, configs["pile"].shape.wall_mm / 1000
        assert (np.abs(along) < half).all() and along.max() <= half - configs[
            "pile"
        ].shape.wall_mm / 1000 - before + 1e-9
        assert (before or np.argmax(along) in (3, 4)) and along[1] < 0.0
        # A cup's command is up to 2 mm below the floor's surface, a third of the floor's thickness.
        assert min(tip[2] for tip in tips) >= floor - (0.0 if is_spoon else 0.002) - 1e-9
        assert tips[-1][2] > 0.1


def test_a_cup_fits_only_in_the_middle_of_its_dish(base: Any) -> None:
    reached = {}
    for name in (LEVEL, SHALLOW):
        blueprint = blueprint_of(SCENES[name])
        configs = {
            item.name: pasta_config_of(item, blueprint, base.locations) for item in blueprint.objects if is_body(item)
        }
        tool = tool_of(configs["tool"], pose(rotation=[[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]))
        assert tool is not None
        # The dishes are 98 and 144 mm wide inside. The cup's radius is 42 mm, and half of the spoon's width 20 mm.
        reached[name] = [aside for aside in (0.0, 0.008, -0.024, 0.045) if tool.fits(configs["pile"], aside)]
    assert reached == {LEVEL: [0.0], SHALLOW: [0.0, 0.008, -0.024, 0.045]}


def test_the_dish_of_a_cup_has_a_higher_wall_where_the_pieces_lie(base: Any) -> None:
    blueprint = blueprint_of(SCENES[LEVEL])
    dish = next(pasta_config_of(item, blueprint, base.locations) for item in blueprint.objects if is_pile(item))
    high = [part for part in dish.collision if part.type == "box" and part.centre[2] + part.half_size[2] > 0.034001]
    assert [part.centre[1] < 0.0 for part in high] == [True]
    assert high[0].centre[2] + high[0].half_size[2] == pytest.approx(0.056)
    (filling,) = fillings_of(blueprint, base.locations).values()
    task = base.config.task.model_copy(update={"things": {"pile": Role(of=(dish,), filled=filling)}})
    along = stacked_poses(task, "pile")[:, 1]
    # The inside is 238 mm long, and the pieces lie on the first 125 mm.
    assert along.min() > -0.119 and along.max() < 0.125 - 0.119


def test_a_stroke_of_a_cup_ends_where_it_has_passed_enough_pieces(base: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    blueprint = blueprint_of(SCENES[LEVEL])
    configs = {
        item.name: pasta_config_of(item, blueprint, base.locations) for item in blueprint.objects if is_body(item)
    }
    world = SimpleNamespace(
        pose=lambda name: np.eye(4), points_inside=lambda name, points: np.ones(len(points), dtype=bool)
    )
    context: Any = SimpleNamespace(world=world, object_configs=configs)
    # The heading is -y: 40 pieces of 5 g, every 2 mm from y = 0 to the far wall.
    centres = np.column_stack([np.zeros(40), -0.002 * np.arange(40), np.full(40, 0.02)])
    pieces: Any = SimpleNamespace(centres=centres, grams_each=5.0)
    monkeypatch.setattr(scoop, "plan_knots", lambda *args: np.zeros((len(args[4]), 6)))
    job, hand = scoop._Job(context, "tool", "pile", "container", pieces), Mock()
    tool = tool_of(configs["tool"], pose(rotation=[[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]))
    job.use(hand, tool)
    assert tool is not None

    def furthest(grams: float) -> float:
        stroke = job.best_stroke(np.eye(4), np.zeros(6), 0.0, grams)
        assert stroke is not None
        return max(float(-(T @ [*tool.tip, 1.0])[1]) for T in stroke.poses)

    assert furthest(50.0) == pytest.approx(0.002 * scoop._PASSED * 50.0 / 5.0)
    assert furthest(math.inf) > 0.11


def test_a_cup_that_holds_too_much_tilts_slowly_until_enough_is_in_the_container(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    inside, steps = [10.0], list[bool]()
    pieces: Any = SimpleNamespace(grams_in=lambda name: inside[0] if name == "container" else 100.0)
    held = SimpleNamespace(T_thing_in_pinch=np.eye(4))
    context: Any = SimpleNamespace(measure_held_object=lambda hand: held)
    job = scoop._Job(context, "tool", "pile", "container", pieces)
    job.use(Mock(), Mock(is_spoon=False))
    for name in ("travel", "sweep"):
        monkeypatch.setattr(job, name, lambda *args: iter(()))
    monkeypatch.setattr(job, "best_stroke", lambda *args: Mock(joints=[None], line=0.0))
    monkeypatch.setattr(job, "release", lambda *args: Mock(joints=[None]))

    def tilt(motion: Any, is_done: Any, slowly: bool) -> Any:
        while not is_done():
            inside[0] += 10.0
            steps.append(slowly)
            yield None

    monkeypatch.setattr(job, "tilt", tilt)
    list(job.scoop_once(60.0, 15.0))
    # 10 g are in the container, and 60 g less 15 g are enough.
    assert steps == [True] * 5


def test_the_origin_is_nearer_to_the_arms_where_the_container_is_far_from_the_pile() -> None:
    ahead = {name: origin_in_world(blueprint_of(scene))[0] for name, scene in SCENES.items()}
    assert ahead.pop("scoop-pasta-far-container") == 0.22
    assert set(ahead.values()) == {0.28}


def test_a_cup_tilts_towards_the_direction_of_the_grasp(base: Any) -> None:
    blueprint = blueprint_of(SCENES[LEVEL])
    item = next(one for one in blueprint.objects if one.name == "tool")
    config = pasta_config_of(item, blueprint, base.locations)
    tool = tool_of(config, pose((0.0, 0.0, 0.05), [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]))
    assert tool is not None
    lying = tool.pose_at(np.array((0.0, 0.0, 0.1)), math.pi / 2, math.radians(90))
    assert lying[:3, 2] == pytest.approx((0.0, 1.0, 0.0), abs=1e-9)
    assert (lying @ [*tool.tip, 1.0])[:3] == pytest.approx((0.0, 0.0, 0.1))


@pytest.mark.parametrize("is_spoon", [True, False])
def test_a_stroke_is_planned_for_a_cup_as_it_turned_in_the_hand(is_spoon: bool) -> None:
    """The cup turns by 0.1 rad in each motion; poses and joints are turns about z, and the stroke's joints are 9."""
    turns, reached = [0.1, 0.2], []
    hand: Any = SimpleNamespace(joints=np.zeros(6), opening=0.0, side="left")
    hand.solve_ik = lambda T, starts: np.full(6, math.atan2(T[1, 0], T[0, 0]))
    context: Any = SimpleNamespace(
        measure_held_object=lambda hand: SimpleNamespace(
            T_thing_in_pinch=pose(rotation=rotation_z(turns[len(reached)]))
        ),
        find_contact=lambda *args: None,
    )
    pieces: Any = None
    job = scoop._Job(context, "tool", "pile", "container", pieces)
    job.use(hand, Mock(is_spoon=is_spoon))
    job.follow = lambda rows: iter(reached.extend(rows[:, 0]) or ())  # type: ignore[method-assign, assignment]
    poses = [pose(rotation=rotation_z(angle)) for angle in (0.0, 0.5, 0.9)]
    list(job.sweep(scoop._Stroke(np.full((3, 6), 9.0), poses, 0.0, 0.0)))
    assert reached == pytest.approx([9.0, 9.0] if is_spoon else [0.4, 0.7])


def test_pieces_over_the_head_of_a_spoon_count_as_carried() -> None:
    T = pose((0.2, 0.1, 0.3), rotation_z(1.0))
    local = np.array([[0.0, 0.06, 0.01], [0.0, -0.05, 0.01], [0.05, 0.06, 0.01], [0.0, 0.06, 0.12]])
    centres = local @ T[:3, :3].T + T[:3, 3]
    assert pieces_on_spoon(T, centres).tolist() == [True, False, False, False]


def test_a_failed_line_has_a_worse_score_after_the_stroke_pushed_the_dish(
    base: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    blueprint = blueprint_of(SCENES[SHALLOW])
    configs = {
        item.name: pasta_config_of(item, blueprint, base.locations) for item in blueprint.objects if is_body(item)
    }
    places, local = [pose((0.3, 0.4, 0.0), rotation_z(0.3))], np.array([[0.0, 0.05, 0.02], [0.03, 0.05, 0.02]])
    world = SimpleNamespace(
        pose=lambda name: places[-1], points_inside=lambda name, points: np.ones(len(points), dtype=bool)
    )
    context: Any = SimpleNamespace(world=world, object_configs=configs)
    pieces: Any = Mock()
    monkeypatch.setattr(scoop, "plan_knots", lambda *args: np.zeros((len(args[4]), 6)))
    job = scoop._Job(context, "tool", "pile", "container", pieces)
    hand: Any = SimpleNamespace()
    job.use(hand, tool_of(configs["tool"], np.eye(4)))

    def best_line() -> Any:
        T_dish = places[-1]
        pieces.centres = local @ T_dish[:3, :3].T + T_dish[:3, 3]
        stroke = job.best_stroke(np.eye(4), np.zeros(6), 0.0)
        assert stroke is not None
        return stroke.line

    first = best_line()
    places.append(pose((0.31, 0.41, 0.0), rotation_z(0.35)))
    assert best_line() == first
    job.failed.add(first)
    assert best_line() != first


@pytest.mark.parametrize(("inside", "message"), [(60.0, ""), (80.0, "30 g too much are in the container")])
def test_too_much_at_the_start_is_no_success(inside: float, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scoop, "LoosePieces", lambda *args: SimpleNamespace(grams_in=lambda container: inside))
    context: Any = SimpleNamespace(world=SimpleNamespace(pose=lambda name: np.eye(4)), object_configs={})
    roles: Any = SimpleNamespace(object_of=lambda role: role)
    skill = scoop.Scoop(tool="tool", source="pile", into="container", grams=50.0, tolerance=15.0)
    if not message:
        assert list(skill.run(context, roles, ())) == []
        return
    with pytest.raises(SkillFailedError, match=message):
        list(skill.run(context, roles, ()))


def test_a_cup_is_weighed_before_every_step_of_a_tilt_and_after_the_last() -> None:
    events = []
    context: Any = SimpleNamespace(make_segment=lambda *args, **options: events.append("step"))
    pieces: Any = SimpleNamespace(weigh=lambda: events.append("weigh"))
    job, cup = scoop._Job(context, "tool", "pile", "container", pieces), Mock(is_spoon=False)
    job.use(Mock(), cup)
    angles = np.radians([65.0, 85.0, 105.0])
    list(job.tilt(Tilt(angles, np.zeros((3, 6))), lambda: events.count("step") == 2))
    assert events == ["weigh", "step", "weigh", "step", "weigh"]


def test_a_cup_that_holds_too_much_tilts_by_small_steps_where_pieces_slide() -> None:
    goals = list[float]()
    context: Any = SimpleNamespace(make_segment=lambda motions, **options: goals.append(float(motions[hand][-1, 0])))
    hand, pieces = Mock(), Mock()
    job = scoop._Job(context, "tool", "pile", "container", pieces)
    job.use(hand, Mock(is_spoon=False))
    angles = np.radians(np.arange(65.0, 126.0, 10.0))
    tilt = Tilt(angles, np.tile(angles[:, None], 6))
    list(job.tilt(tilt, lambda: len(goals) == 3, slowly=True))
    assert np.degrees(goals) == pytest.approx([90.0, 93.0, 96.0])
    goals.clear()
    list(job.tilt(tilt, lambda: len(goals) == 2))
    assert np.degrees(goals) == pytest.approx([95.0, 125.0])


def test_a_straight_tilt_is_a_line_of_joints_where_the_tilt_bends() -> None:
    tilt = Tilt(np.radians([0.0, 15.0, 30.0]), np.array([[0.0] * 6, [0.3] * 6, [0.4] * 6]))
    bent, straight = (make(tilt, 0.0, math.radians(30)) for make in (tilt_path, straight_tilt))
    assert straight.shape == bent.shape
    assert straight[[0, -1]] == pytest.approx(bent[[0, -1]])
    assert np.diff(straight, axis=0) == pytest.approx(0.04)
    assert np.abs(bent - straight).max() > 0.09


def test_a_way_rises_over_an_obstacle_before_a_search(monkeypatch: pytest.MonkeyPatch) -> None:
    ways, heights = list[str](), list[float]()

    def plan_knots(context: Any, hand: Any, opening: Any, load: Any, poses: Any, start: Any) -> Any:
        heights.append(poses[0][2, 3])
        return np.zeros((len(poses) if heights[-1] > 0.05 else 0, 6))

    monkeypatch.setattr(scoop, "plan_knots", plan_knots)
    context: Any = SimpleNamespace(
        find_contact=lambda *args: None,
        plan_free_path=lambda *args: ways.append("search"),
        make_segment=lambda *args, **options: ways.append("follow"),
    )
    hand = Mock(joints=np.zeros(6), opening=0.0, pinch_pose=lambda joints: np.eye(4))
    hand.held_object.T_thing_in_pinch = np.eye(4)
    job = scoop._Job(context, "tool", "pile", "container", Mock(grams_in=lambda holder: 7.0))
    job.use(hand, Mock(is_spoon=True))
    list(job.travel(np.ones(6)))
    assert heights == sorted(heights) and heights[0] == 0.0 and heights[-1] > 0.05
    assert set(ways) == {"follow"}


@pytest.mark.parametrize(("blocked", "way"), [(9.0, "follow"), (0.1, "search"), (0.75, "search")])
def test_a_way_with_a_contact_at_its_start_or_end_is_searched(
    blocked: float, way: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The joints go from 0 to 1 by way of 0.2 and 0.5."""
    ways = []

    def plan_free_path(*args: Any) -> Any:
        ways.append("search")
        return np.zeros((2, 6))

    context: Any = SimpleNamespace(
        find_contact=lambda hand, joints, opening, load: "wall" if abs(joints[0] - blocked) < 0.01 else None,
        plan_free_path=plan_free_path,
        make_segment=lambda *args, **options: ways.append("follow"),
    )
    hand = Mock(joints=np.zeros(6), opening=0.0, pinch_pose=lambda joints: np.eye(4))
    hand.held_object.T_thing_in_pinch = np.eye(4)
    monkeypatch.setattr(scoop, "plan_knots", lambda *args: np.array([np.full(6, 0.2), np.full(6, 0.5)]))
    pieces: Any = None
    job = scoop._Job(context, "tool", "pile", "container", pieces)
    job.use(hand, Mock())
    list(job.travel(np.ones(6)))
    assert ways[0] == way


@pytest.mark.parametrize(("is_spoon", "grams", "poses"), [(False, 0.0, 1), (False, 7.0, 2), (True, 0.0, 2)])
def test_an_empty_cup_returns_by_one_pose(
    is_spoon: bool, grams: float, poses: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    counts = []

    def plan_knots(*args: Any) -> Any:
        counts.append(len(args[4]))
        return np.zeros((len(args[4]), 6))

    monkeypatch.setattr(scoop, "plan_knots", plan_knots)
    context: Any = SimpleNamespace(find_contact=lambda *args: None, make_segment=lambda *args, **options: None)
    hand = Mock(joints=np.zeros(6), opening=0.0, pinch_pose=lambda joints: np.eye(4))
    hand.held_object.T_thing_in_pinch = np.eye(4)
    job = scoop._Job(context, "tool", "pile", "container", Mock(grams_in=lambda holder: grams))
    job.use(hand, Mock(is_spoon=is_spoon))
    list(job.travel(np.ones(6)))
    assert counts == [poses]


def test_a_cup_tilts_with_its_lip_where_the_tilt_is_largest(monkeypatch: pytest.MonkeyPatch) -> None:
    context: Any = None
    source: Any = Mock(joints=np.zeros(6))
    tool: Any = Mock(is_spoon=False)
    monkeypatch.setattr(scoop_strokes, "_cup_release", lambda *args: [args[5]])
    for best in (0.02, 0.045):
        monkeypatch.setattr(
            scoop_strokes,
            "plan_knots",
            lambda *args, best=best: np.full((7 if args[4][0] == best else 5, 6), args[4][0]),
        )
        found = scoop_strokes.plan_release(context, source, tool, "container", 0.0)
        assert found is not None and found.joints[0, 0] == best
    monkeypatch.setattr(scoop_strokes, "plan_knots", lambda *args: np.zeros((4, 6)))
    assert scoop_strokes.plan_release(context, source, tool, "container", 0.0) is None


def test_without_a_free_hand_the_message_says_so(locations: Locations) -> None:
    spoon = load_config(ObjectConfig, "objects", "kitchen_spoon", locations)
    context: Any = SimpleNamespace(
        world=SimpleNamespace(pose=lambda name: np.eye(4)), object_configs={"tool": spoon}, free_hands=lambda arm: []
    )
    skill = scoop.Scoop(tool="tool", source="pile", into="container", grams=50.0, tolerance=15.0)
    pieces: Any = None
    with pytest.raises(SkillFailedError, match="no grasp to scoop with the tool: no hand is free"):
        skill._find_grasp(context, scoop._Job(context, "tool", "pile", "container", pieces))


def test_a_step_is_free_in_one_posture_without_contact_on_the_way() -> None:
    def is_free(end: float, blocked: float) -> bool:
        context: Any = SimpleNamespace(
            find_contact=lambda hand, joints, opening, load: "wall" if abs(joints[0] - blocked) < 0.1 else None
        )
        hand: Any = None
        return is_free_step(context, hand, 0.0, hand, np.zeros(6), np.full(6, end))

    assert is_free(1.0, blocked=2.0)
    assert not is_free(1.0, blocked=0.5) and not is_free(1.0, blocked=1.0)
    assert not is_free(1.6, blocked=3.0)


@pytest.mark.slow
def test_scooped_mass_counts_by_piece_and_too_much_is_no_success(base: Any) -> None:
    blueprint = blueprint_of(SCENES[LEVEL])
    target, tolerance = (float(blueprint.success_params[key]) for key in ("target_g", "tol_g"))
    realized = build_benchmark_scene(blueprint, base)
    try:
        motion = SceneStepper(realized, 30)
        judge = KitchenJudge(realized, motion)
        mass = judge.world.contained_mass_g
        motion.execute_action(motion.last_reference)
        assert mass("pile", "pile") == pytest.approx(280.0)
        assert mass("pile", "container") == 0.0 and not judge.evaluate()[0]
        model, data = realized.simulator.scene.model, motion.data
        middle = realized.simulator.scene.object_qpos["container"]
        joints = list(realized.simulator.scene.pieces["pile"])
        verdicts = []
        for count in range(1, len(joints) + 1):
            address = model.jnt_qposadr[joints[count - 1]]
            data.qpos[address : address + 3] = data.qpos[middle : middle + 3] + np.array([0.0, 0.0, 0.05])
            mujoco.mj_forward(model, data)
            grams = mass("pile", "container")
            assert grams == pytest.approx(280.0 * count / len(joints))
            verdicts.append(judge.evaluate()[0])
            assert verdicts[-1] == (abs(grams - target) <= tolerance)
        assert any(verdicts) and not verdicts[-1]
    finally:
        realized.simulator.close()


@pytest.mark.slow
@pytest.mark.parametrize(("name", "epoch"), [(SHALLOW, 4), (MIXED, 1)])
def test_the_expert_scoops(name: str, epoch: int, base: Any) -> None:
    """With a spoon, then with a measuring cup."""
    blueprint = blueprint_of(SCENES[name], epoch)
    realized = build_benchmark_scene(blueprint, base)
    planning = PlanningScene(realized, int(seed_of(SCENES[name], epoch)), 10)
    try:
        judge = KitchenJudge(realized, planning.motion)
        assert run_expert(planning, judge, 120) <= 120
        assert judge.evaluate()[0]
        arrived = judge.world.contained_mass_g("pile", "container")
        assert abs(arrived - blueprint.success_params["target_g"]) <= 15.0
        assert judge.world.scene.holding_sides("tool")
    finally:
        planning.close()
