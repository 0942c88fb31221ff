"""The expert for the benchmark's tasks."""

from __future__ import annotations

import gc
import math
import weakref
from collections.abc import Iterator
from dataclasses import replace

import mujoco
import numpy as np
import pytest

pytest.importorskip("inspect_robots", reason="needs yamsim[inspect]")
pytest.importorskip("kitchenbench", reason="needs yamsim[inspect]")

from inspect_robots import (
    Action,
    ActionChunk,
    EmbodimentInfo,
    Observation,
    PolicyConfig,
    PolicyInfo,
    Scene,
)
from inspect_robots import eval as evaluate
from inspect_robots.errors import CompatibilityError
from inspect_robots.rollout import derive_seed
from kitchenbench import tasks
from kitchenbench.policies import NoopKitchenPolicy
from kitchenbench.sim import build_blueprint
from kitchenbench.sim.blueprint import SceneObject

from tests.kitchenbench.realizations import judged_planning_scene
from yamsim_cli.core.attempt_data import FailureCause
from yamsim_cli.core.config.goals.role_assignment import RoleAssignment
from yamsim_cli.core.expert.skills.grasp_candidates import GraspCandidate
from yamsim_cli.core.expert.skills.handover import Handover
from yamsim_cli.core.expert.skills.pick import Pick, ReachableGrasp
from yamsim_cli.core.expert.skills.place import Place
from yamsim_cli.core.expert.skills.planning_context import (
    FingerTarget,
    MotionSegment,
    PlanningContext,
    SkillFailedError,
)
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import quat_from_rotation, rotation_from_vector
from yamsim_cli.core.scene.start_sampling import footprint_corners, footprint_distance
from yamsim_cli.core.sim.sim_world import SimWorld
from yamsim_cli.kitchen_skills.press_level import PressLevel
from yamsim_cli.kitchen_skills.sorting import (
    PickNarrowObject,
    PlaceInCompartment,
    PutBesideTray,
    Slide,
    Sort,
    is_on_side,
)
from yamsim_cli.kitchenbench.asset_configs import object_config_of
from yamsim_cli.kitchenbench.benchmark_scene import build_benchmark_scene, open_station_session
from yamsim_cli.kitchenbench.embodiment import JOINTS, YamsimEmbodiment
from yamsim_cli.kitchenbench.policy import PlanningScene, YamsimExpert, is_still, run_expert, segment_actions
from yamsim_cli.kitchenbench.scene_stepper import SceneStepper, commanded_opening, commanded_share, scene_fingers
from yamsim_cli.kitchenbench.skill_programs import build_scene_program
from yamsim_cli.kitchenbench.success_judges import KitchenWorld

BASES = [np.array((0.0, 0.305)), np.array((0.0, -0.305))]
SCENES = {scene.id: scene for factory in tasks.TASK_FACTORIES.values() for scene in factory().scenes}


def _planning_scene(name: str) -> PlanningScene:
    realized = build_benchmark_scene(build_blueprint(SCENES[name], 0), open_station_session("64x48", images=False))
    return PlanningScene(realized, 0, 10)


@pytest.fixture
def expert_bench() -> Iterator[PlanningContext]:
    planning = _planning_scene("stack-tight-spacing")
    yield planning.context
    planning.close()


def test_larger_things_are_stacked_first() -> None:
    blueprint = build_blueprint(SCENES["stack-mixed-sizes"], 0)
    sizes = {item.name: item.size_cm or 0.0 for item in blueprint.objects}
    placed = [skill for skill in build_scene_program(blueprint, {}, BASES) if isinstance(skill, Place)]
    order = [placed[0].on, *(skill.thing for skill in placed)]
    assert sorted(order) == sorted(sizes) and [skill.on for skill in placed] == order[:-1]
    assert [sizes[name] for name in order] == sorted(sizes.values(), reverse=True)


def test_only_bowls_that_go_into_larger_ones_are_pressed_level() -> None:
    """Bowls of one size rest on each other's rims."""
    for name, pressed in (("stack-mixed-sizes", True), ("stack-bowls", False)):
        program = build_scene_program(build_blueprint(SCENES[name], 0), {}, BASES)
        placed = [skill.thing for skill in program if isinstance(skill, Place)]
        assert [skill.thing for skill in program if isinstance(skill, PressLevel)] == (placed if pressed else [])


@pytest.mark.parametrize("size_cm", [10.24, 16.0])
def test_a_bowl_that_goes_into_another_is_grasped_by_its_wall(size_cm: float, locations: Locations) -> None:
    """A hand could also reach around a bowl of 102 mm, but not in a larger one."""
    item = SceneObject("bowl_1", "bowl", "stack", 0.0, 0.0, 0.0, size_cm=size_cm)
    for is_stacked, thin in ((True, True), (False, size_cm > 12)):
        grasp = object_config_of(item, {}, locations, is_stacked=is_stacked).grasp
        assert grasp is not None and (grasp.opening < 0.005) == thin


@pytest.mark.slow
def test_four_bowls_of_different_sizes_are_stacked_within_the_limit() -> None:
    """A bowl that falls askew into a larger one is pressed level, or the next one would slide off."""
    with judged_planning_scene(SCENES["stack-mixed-sizes"], 2, root=2026) as (planning, judge):
        names = [name for name in planning.context.world.object_names if name.startswith("bowl_")]
        assert len(names) == 4 and run_expert(planning, judge, 80) <= 80 and judge.evaluate()[0]
        assert all(planning.context.world.pose(name)[2, 2] > math.cos(math.radians(4)) for name in names[:-1])


def test_a_stack_stands_where_arms_reach_least_far() -> None:
    """The outermost of plates side by side would be the worst."""
    scene = SCENES["stack-plates"]
    blueprint = build_blueprint(scene, derive_seed(0, scene.init_seed, 2))
    names = [item.name for item in blueprint.objects]
    assert len(names) == 4
    below = next(skill for skill in build_scene_program(blueprint, {}, BASES) if isinstance(skill, Place)).on
    assert below in names[1:3]


def test_references_bear_the_arm_at_the_end_of_a_motion(expert_bench: PlanningContext) -> None:
    """Acceleration torques are not part of them: an arm at rest would be off by their deflection."""
    hand = expert_bench.hands[0]
    goal = hand.ready_joints + np.array((0.5, 0.0, 0.0, 0.0, 0.0, 0.0))
    segment = expert_bench.make_segment({hand: expert_bench.plan_free_path(hand, goal)})
    *_, last = segment_actions(expert_bench, segment, 10)
    # Nothing loads the first joint, whose axis is vertical; braking takes newton metres.
    assert last[7 * hand.number] == pytest.approx(goal[0], abs=0.002)
    assert abs(segment.paths[hand.number].torques[-1][0] / hand.arm.position_gain[0]) > 0.005


def test_only_what_waits_is_still(expert_bench: PlanningContext) -> None:
    hand = expert_bench.hands[0]
    assert is_still(expert_bench.wait_segment(4))
    closing = {hand: FingerTarget(0.0, 10.0)}
    assert not is_still(expert_bench.make_segment({hand: expert_bench.hold_still_motion(hand, 10)}, closing))


@pytest.mark.slow
def test_cutlery_has_places_in_its_compartment_and_beside_the_tray() -> None:
    planning = _planning_scene("sort-cutlery-balanced-pile")
    try:
        bench, roles = planning.context, planning.simulator.roles
        assert roles is not None
        put = PlaceInCompartment(thing="knife_1", into="compartment_knife", beside=("sortable",))
        inside = put.goal_poses(bench, roles, "knife_1")
        assert (
            inside and bench.world.points_inside("compartment_knife", inside[0][None, :3, 3] + (0.0, 0.0, 0.01)).all()
        )
        aside = PutBesideTray(thing="knife_1").goal_poses(bench, roles, "knife_1")
        assert aside and not any(bench.world.points_inside("tray", T[None, :3, 3]).any() for T in aside)
    finally:
        planning.close()


def test_what_lies_in_its_compartment_stays_there_and_the_uppermost_comes_first() -> None:
    """Spoon, fork and knife lie across each other."""
    scene = SCENES["sort-cutlery-sparse"]
    seed = derive_seed(0, scene.init_seed, 1)
    realized = build_benchmark_scene(build_blueprint(scene, seed), open_station_session("64x48", images=False))
    try:
        cast = realized.simulator.roles
        assert cast is not None
        world = KitchenWorld(realized, SceneStepper(realized, 10)).scene
        (sort,) = build_scene_program(realized.blueprint, {}, BASES)
        assert isinstance(sort, Sort)
        left = sort.remaining_objects(world, cast, {})
        assert left[0] == "knife_1" and sorted(left) == ["fork_1", "fork_2", "knife_1", "spoon_1"]
        # After a failure, lower objects still wait.
        after_failure = sort.remaining_objects(world, cast, {"knife_1": 1})
        below = {name for name in after_failure if _overlap(world, name, "knife_1") and name != "knife_1"}
        assert below and all(after_failure.index(name) > after_failure.index("knife_1") for name in below)
        address = realized.simulator.scene.object_qpos["knife_1"]
        tray = world.pose("tray")
        world.data.qpos[address : address + 3] = (tray @ (0.10, 0.0, 0.012, 1.0))[:3]
        world.data.qpos[address + 3 : address + 7] = quat_from_rotation(tray[:3, :3])
        mujoco.mj_kinematics(realized.simulator.scene.model, world.data)
        assert "knife_1" not in sort.remaining_objects(world, cast, {})
    finally:
        realized.simulator.close()


def _overlap(world: SimWorld, one: str, other: str) -> bool:
    """Whether two objects overlap, seen from above."""
    return (
        footprint_distance(*(footprint_corners(world.local_box(name), world.pose(name)) for name in (one, other))) < 0
    )


def test_a_leaning_piece_gets_the_height_of_its_attitude() -> None:
    """At an upright object's height, its lower end would be pressed into the floor."""
    planning = _planning_scene("sort-cutlery-balanced-pile")
    try:
        bench, roles = planning.context, planning.simulator.roles
        assert roles is not None
        address = planning.simulator.scene.object_qpos["knife_1"]
        leaning = rotation_from_vector([0.0, math.radians(15.0), 0.0])
        bench.world.data.qpos[address + 3 : address + 7] = quat_from_rotation(leaning)
        mujoco.mj_kinematics(planning.simulator.scene.model, bench.world.data)
        put = PlaceInCompartment(thing="knife_1", into="compartment_knife", beside=("sortable",))
        for skill, onto in ((put, "compartment_knife"), (PutBesideTray(thing="knife_1"), "table")):
            goals = skill.goal_poses(bench, roles, "knife_1")
            upright = next(T for T in goals if T[2, 2] > 0.999)
            other = next(T for T in goals if T[2, 2] < 0.99)
            for T in (upright, other):
                assert T[2, 3] == pytest.approx(bench.rest_height_of("knife_1", T, onto), abs=5e-4)
            assert other[2, 3] > upright[2, 3] + 0.001
    finally:
        planning.close()


def test_a_grip_that_slipped_is_not_tried_again(expert_bench: PlanningContext, monkeypatch: pytest.MonkeyPatch) -> None:
    hand, thing = expert_bench.hands[0], "cup_1"
    grip = next(expert_bench.grasp_candidates(thing, hand.max_opening))

    def slips(*_: object) -> Iterator[MotionSegment]:
        raise SkillFailedError(FailureCause.SLIPPED, "between the fingers is nothing")
        yield

    monkeypatch.setattr(Pick, "grasp_and_lift", slips)
    grab = PickNarrowObject(thing=thing)
    with pytest.raises(SkillFailedError):
        list(
            grab.grasp_and_lift(
                expert_bench, hand, thing, ReachableGrasp(grip, hand.ready_joints, hand.ready_joints, grip.opening)
            )
        )
    assert hand.is_similar_to_failed_grasp(thing, grip.T_pinch_in_thing)
    assert grab.find_reachable_grasp(expert_bench, hand, thing, grip) is None


@pytest.mark.slow
def test_a_piece_is_put_down_where_it_can_be_taken_on() -> None:
    """Where a hand grasps it by the most reliable grip."""
    planning = _planning_scene("sort-cutlery-balanced-pile")
    try:
        bench, roles = planning.context, planning.simulator.roles
        assert roles is not None

        class Onwards(PutBesideTray):
            def fault(self, *_: object) -> str | None:  # type: ignore[override]
                return None

        nearest = PutBesideTray(thing="spoon_1").goal_poses(bench, roles, "spoon_1")
        taken_on = PutBesideTray(thing="spoon_1", next_place_skill=Onwards(thing="spoon_1")).goal_poses(
            bench, roles, "spoon_1"
        )
        assert len(nearest) == len(taken_on)
        grips = [
            (hand, next(bench.grasp_candidates("spoon_1", hand.max_opening)).T_pinch_in_thing)
            for hand in bench.acting_hands
        ]
        assert any(hand.solve_ik(taken_on[0] @ T_pinch, (hand.ready_joints,)) is not None for hand, T_pinch in grips)
    finally:
        planning.close()


@pytest.fixture
def tray_scene() -> Iterator[PlanningScene]:
    """Cutlery in a tray's compartments, a fork beside the left wall."""
    with judged_planning_scene(SCENES["sort-cutlery-overlapping"]) as (planning, _):
        yield planning


@pytest.mark.slow
def test_beside_a_wall_fingers_come_nearer_than_arms(tray_scene: PlanningScene) -> None:
    """A fork that otherwise has no grip."""
    bench = tray_scene.context
    hand, T = bench.hands[0], bench.world.pose("cutlery_2")

    def free(grip: GraspCandidate, beside: float | None) -> bool:
        at = hand.solve_ik(T @ grip.T_pinch_in_thing, (hand.joints, hand.ready_joints))
        wide = grip.opening + grip.clearance
        return (
            at is not None and bench.find_contact(hand, at, wide, grasped="cutlery_2", finger_clearance=beside) is None
        )

    close = [grip for grip in bench.grasp_candidates("cutlery_2", hand.max_opening) if grip.finger_distance is not None]
    first = next(grip for grip in close if free(grip, grip.finger_distance))
    assert not free(first, None)


def test_a_thing_has_as_much_room_as_there_is_to_the_wall(tray_scene: PlanningScene) -> None:
    """The fork is 30 mm wide, and lies with its middle 22 mm from the wall."""
    bench = tray_scene.context
    room = [
        bench.collision_checker.free_distance(bench.qpos, "cutlery_2", np.array((0.0, side)), 0.04)
        for side in (1.0, -1.0)
    ]
    assert room == pytest.approx([0.008, 0.026], abs=0.003)


@pytest.mark.slow
def test_what_lies_beside_a_wall_is_slid_away_from_it(tray_scene: PlanningScene) -> None:
    before = tray_scene.context.world.pose("cutlery_2")[1, 3]
    cast = RoleAssignment({"cutlery_2": ("cutlery_2",)}, {"cutlery_2": "fork"})
    tray_scene.start_program([Slide(thing="cutlery_2")], cast)
    while len(tray_scene.next_actions()) > 1:
        pass
    assert before - tray_scene.context.world.pose("cutlery_2")[1, 3] > 0.002


@pytest.mark.slow
def test_cutlery_on_its_side_is_made_to_fall_over() -> None:
    with judged_planning_scene(SCENES["sort-cutlery-overlapping"], 4) as (planning, _):
        world = planning.context.world
        assert is_on_side(world, "cutlery_5")
        cast = RoleAssignment({"cutlery_5": ("cutlery_5",)}, {"cutlery_5": "fork"})
        planning.start_program([Slide(thing="cutlery_5")], cast)
        while len(planning.next_actions()) > 1:
            pass
        assert not is_on_side(world, "cutlery_5")


@pytest.mark.slow
def test_fingers_that_open_beside_a_wall_leave_the_tray_where_it_is() -> None:
    """Ten pieces of cutlery lie in the tray and beside it."""
    with judged_planning_scene(SCENES["sort-cutlery-overlapping"]) as (planning, judge):
        before = planning.context.world.pose("tray")[:3, 3].copy()
        assert run_expert(planning, judge, 200) < 200 and judge.evaluate()[0]
        np.testing.assert_allclose(planning.context.world.pose("tray")[:3, 3], before, atol=0.003)


def test_the_arm_that_receives_is_the_one_that_is_asked_for() -> None:
    pick, give = build_scene_program(build_blueprint(SCENES["handoff-cross-body"], 0), {}, BASES)
    assert isinstance(pick, Pick) and pick.arm == "right"
    assert isinstance(give, Handover) and give.to == "left"


@pytest.mark.parametrize(
    ("scene", "conditions", "expected_mm"),
    [
        ("cup-narrow", {"slot_index": 1, "slot_width_cm": 6}, -120.0),
        ("cup-narrow", {"slot_index": 5, "slot_width_cm": 6}, 120.0),
        # Slots of 8 cm: three have room, and the last is the nearest to the fifth.
        ("cup-narrow", {"slot_index": 5, "slot_width_cm": 8}, 80.0),
        # A bowl over the outermost slot would stand in the bow.
        ("bowl-tilt", {"slot_index": 3}, 35.0),
        ("bowl-tilt", {"slot_index": 1}, -35.0),
    ],
)
def test_a_dish_goes_into_the_slot_that_is_asked_for_or_the_nearest_that_fits(
    scene: str, conditions: dict[str, int], expected_mm: float
) -> None:
    blueprint = replace(build_blueprint(SCENES[f"place-in-rack-{scene}"], 0), conditions=conditions)
    where = open_station_session("64x48", images=False).locations
    items = {item.name: object_config_of(item, conditions, where) for item in blueprint.objects}
    place = build_scene_program(blueprint, items, BASES)[1]
    assert isinstance(place, Place) and place.at is not None
    assert [1000 * x for x in place.at] == pytest.approx([expected_mm, 0.0])


def test_a_goal_without_an_expert_is_named() -> None:
    blueprint = replace(build_blueprint(next(iter(SCENES.values())), 0), target_kind="juggle")
    with pytest.raises(LookupError, match="no expert for goals of kind 'juggle'"):
        build_scene_program(blueprint, {}, BASES)


def test_a_gripper_is_told_what_its_share_says() -> None:
    embodiment = YamsimEmbodiment(images=False)
    scene = SCENES["handoff-cup-upright"]
    embodiment.reset(scene, seed=0)
    fingers = scene_fingers(embodiment.world.scene.arms)[0]
    shares = np.linspace(0.0, 1.0, 41)
    told = [commanded_opening(fingers, share) for share in shares]
    assert told[0] == fingers.ctrl_range[0] and told[-1] == pytest.approx(fingers.full_opening)
    assert np.diff(told).min() > 0
    assert [commanded_share(fingers, opening) for opening in told] == pytest.approx(shares)
    embodiment.close()


def test_a_closed_planning_scene_is_freed_without_the_garbage_collector() -> None:
    scene = SCENES["place-cutlery-from-drawer"]
    planning = PlanningScene(
        build_benchmark_scene(build_blueprint(scene, 0), open_station_session("64x48", images=False)), 0, 10
    )
    planning.next_actions()
    bench = weakref.ref(planning.context)
    gc.collect()
    gc.disable()
    try:
        planning.close()
        del planning
        assert bench() is None
    finally:
        gc.enable()


@pytest.mark.slow
def test_actions_that_were_changed_are_noticed() -> None:
    embodiment, expert = YamsimEmbodiment(images=False), YamsimExpert()
    expert.bind(embodiment.info)
    scene = SCENES["place-cutlery-from-drawer"]
    expert.reset(scene)
    seen = embodiment.reset(scene, seed=derive_seed(0, scene.init_seed, 0))
    actions = expert.act(seen).actions
    assert len(actions) > 1
    for action in actions:
        seen = embodiment.step(action).observation
    moved = {**seen.state, JOINTS: seen.state[JOINTS] + 0.01}
    with pytest.raises(RuntimeError, match=r"the arms are 0\.0100 away from where the expert's actions lead"):
        expert.act(type(seen)(state=moved))
    embodiment.close()
    expert.close()


@pytest.mark.slow
def test_who_holds_still_scores_nothing(tmp_path: object) -> None:
    """The benchmark's own `kitchen_noop` is for another station: its actions are 8 numbers."""
    task = tasks.TASK_FACTORIES["place_cutlery"]()
    task.scenes = task.scenes[:1]
    task.epochs, task.max_steps = 1, 10
    embodiment = YamsimEmbodiment(images=False)
    with pytest.raises(CompatibilityError, match="8-D actions"):
        evaluate(task, policy=NoopKitchenPolicy(), embodiment=embodiment, log_dir=str(tmp_path))
    (log,) = evaluate(task, policy=_Still(embodiment.info), embodiment=embodiment, log_dir=str(tmp_path))
    assert [scene.reduced["task_success"] for scene in log.samples] == [0.0]


class _Still:
    """Stays where it is."""

    def __init__(self, info: EmbodimentInfo) -> None:
        self.info = PolicyInfo(name="still", action_space=info.action_space)
        self.config = PolicyConfig()

    def reset(self, scene: Scene) -> None:
        """Do nothing."""

    def act(self, observation: Observation) -> ActionChunk:
        """Hold the present joints."""
        return ActionChunk([Action(observation.state[JOINTS])])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "scene"),
    [
        ("stack", "stack-tight-spacing"),
        ("fold_cloth", "fold-cloth-napkin-half"),
        ("place_in_rack", "place-in-rack-bowl-tilt"),
        ("place_in_rack", "place-in-rack-wet-slippery"),
    ],
)
def test_the_expert_solves_scenes_of_the_benchmark(name: str, scene: str, tmp_path: object) -> None:
    """By the benchmark's own task and scorer."""
    task = tasks.TASK_FACTORIES[name]()
    task.scenes = [one for one in task.scenes if one.id == scene]
    task.epochs = 1
    (log,) = evaluate(task, policy=YamsimExpert(), embodiment=YamsimEmbodiment(images=False), log_dir=str(tmp_path))
    assert log.status == "success"
    assert [one.reduced["task_success"] for one in log.samples] == [1.0]
