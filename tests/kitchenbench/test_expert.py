"""The expert for the benchmark's rigid tasks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("inspect_robots", reason="needs yamsim[inspect]")
pytest.importorskip("kitchenbench", reason="needs yamsim[inspect]")

from inspect_robots import eval as evaluate
from inspect_robots.rollout import derive_seed
from kitchenbench import tasks
from kitchenbench.sim import SceneBlueprint, build_blueprint

from yamsim_cli.core.skills.base import Skill
from yamsim_cli.core.skills.handover import Handover
from yamsim_cli.core.skills.pick import Pick
from yamsim_cli.core.skills.place import Place
from yamsim_cli.kitchenbench.catalog import COMPARTMENT, thing_of
from yamsim_cli.kitchenbench.embodiment import JOINTS, YamsimEmbodiment, open_base
from yamsim_cli.kitchenbench.motion import hands, told_opening, told_share
from yamsim_cli.kitchenbench.policy import YamsimExpert
from yamsim_cli.kitchenbench.programs import program_of

SCENES = {scene.id: scene for factory in tasks.TASK_FACTORIES.values() for scene in factory().scenes}

Program = Callable[[SceneBlueprint], list[Skill]]

# Where the arms stand, as far as a program asks for it, m.
BASES = (np.array([0.0, 0.305]), np.array([0.0, -0.305]))


@pytest.fixture(scope="module")
def program() -> Program:
    """The program of a blueprint whose things are those of the kitchen."""
    base = open_base("64x48", images=False)

    def made(blueprint: SceneBlueprint) -> list[Skill]:
        things = [item for item in blueprint.objects if item.asset != COMPARTMENT]
        items = {item.name: thing_of(item, blueprint.conditions, base.locations) for item in things}
        return program_of(blueprint, items, BASES)

    return made


@pytest.mark.parametrize(
    ("scene", "conditions", "expected_mm"),
    [
        ("cup-narrow", {"slot_index": 1, "slot_width_cm": 6}, -120.0),
        ("cup-narrow", {"slot_index": 5, "slot_width_cm": 6}, 120.0),
        # Slots of 8 cm: three of them have room, and the last is the nearest to the fifth.
        ("cup-narrow", {"slot_index": 5, "slot_width_cm": 8}, 80.0),
        # A bowl over the outermost slot would stand in the bow.
        ("bowl-tilt", {"slot_index": 3}, 35.0),
        ("bowl-tilt", {"slot_index": 1}, -35.0),
    ],
)
def test_a_dish_goes_into_the_slot_that_is_asked_for_or_the_nearest_that_fits(
    scene: str, conditions: dict[str, int], expected_mm: float, program: Program
) -> None:
    blueprint = replace(build_blueprint(SCENES[f"place-in-rack-{scene}"], 0), conditions=conditions)
    place = program(blueprint)[1]
    assert isinstance(place, Place) and place.at is not None
    assert [1000 * x for x in place.at] == pytest.approx([expected_mm, 0.0])


def test_larger_things_are_stacked_first(program: Program) -> None:
    blueprint = build_blueprint(SCENES["stack-mixed-sizes"], 0)
    sizes = {item.name: item.size_cm or 0.0 for item in blueprint.objects}
    placed = [skill for skill in program(blueprint) if isinstance(skill, Place)]
    order = [placed[0].on, *(skill.thing for skill in placed)]
    assert sorted(order) == sorted(sizes) and [skill.on for skill in placed] == order[:-1]
    assert [sizes[name] for name in order] == sorted(sizes.values(), reverse=True)


def test_the_arm_that_receives_is_the_one_that_is_asked_for(program: Program) -> None:
    pick, give = program(build_blueprint(SCENES["handoff-cross-body"], 0))
    assert isinstance(pick, Pick) and pick.arm == "right"
    assert isinstance(give, Handover) and give.to == "left"


def test_what_nobody_can_do_is_named() -> None:
    blueprint = build_blueprint(next(scene for name, scene in SCENES.items() if name.startswith("fold")), 0)
    with pytest.raises(LookupError, match="no expert for goals of kind 'fold'"):
        program_of(blueprint, {}, BASES)


def test_a_gripper_is_told_what_its_share_says() -> None:
    embodiment = YamsimEmbodiment(images=False)
    scene = SCENES["handoff-cup-upright"]
    embodiment.reset(scene, seed=0)
    fingers = hands(embodiment.world.scene.arms)[0]
    shares = np.linspace(0.0, 1.0, 41)
    told = [told_opening(fingers, share) for share in shares]
    assert told[0] == fingers.ctrl_range[0] and told[-1] == pytest.approx(fingers.stroke)
    assert np.diff(told).min() > 0
    assert [told_share(fingers, opening) for opening in told] == pytest.approx(shares)
    embodiment.close()


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
    with pytest.raises(RuntimeError, match=r"the arms are 0\.0100 off where the expert's actions lead"):
        expert.act(type(seen)(state=moved))
    embodiment.close()
    expert.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "scene"),
    [
        ("stack", "stack-tight-spacing"),
        ("place_in_rack", "place-in-rack-bowl-tilt"),
        ("place_in_rack", "place-in-rack-wet-slippery"),
    ],
)
def test_a_scene_is_done(name: str, scene: str, tmp_path: object) -> None:
    """By the benchmark's own task, scored by its own scorer."""
    task = tasks.TASK_FACTORIES[name]()
    task.scenes = [found for found in task.scenes if found.id == scene]
    task.epochs = 1
    (log,) = evaluate(task, policy=YamsimExpert(), embodiment=YamsimEmbodiment(images=False), log_dir=str(tmp_path))
    assert log.status == "success"
    assert [scene.reduced["task_success"] for scene in log.samples] == [1.0]
