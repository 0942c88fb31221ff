"""Scenes of pouring: their pasta, its mass by piece, and the checker's verdicts."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np
import pytest

pytest.importorskip("inspect_robots", reason="needs yamsim[inspect]")
pytest.importorskip("kitchenbench", reason="needs yamsim[inspect]")

from kitchenbench import tasks

from tests.kitchenbench.realizations import blueprint_of, seed_of
from yamsim_cli.core.config.objects.primitives import Capsule
from yamsim_cli.core.config.task_objects import Role
from yamsim_cli.kitchen_skills.pour import Pour
from yamsim_cli.kitchen_skills.tilting import lip_height
from yamsim_cli.kitchenbench.benchmark_scene import build_benchmark_scene
from yamsim_cli.kitchenbench.pasta import describe_coarse_pieces, fillings_of, is_body, pasta_config_of
from yamsim_cli.kitchenbench.policy import PlanningScene, run_expert
from yamsim_cli.kitchenbench.scene_stepper import SceneStepper
from yamsim_cli.kitchenbench.success_judges import KitchenJudge
from yamsim_cli.loose_pieces import loose_pieces, piece_count, stacked_poses

SCENES = {scene.id: scene for scene in tasks.TASK_FACTORIES["pour_pasta"]().scenes}
CUP, STRANDS = "pour-pasta-narrow-cup", "pour-pasta-long-spaghetti"


@pytest.mark.parametrize("name", SCENES)
def test_every_source_holds_its_pasta(name: str, base: Any) -> None:
    for epoch in range(2):
        blueprint = blueprint_of(SCENES[name], epoch)
        (filled, filling), *others = fillings_of(blueprint, base.locations).items()
        assert (filled, others) == ("source", [])
        assert filling.grams == blueprint.success_params["total_g"]
        assert piece_count(filling)[0] <= 44
        source = next(item for item in blueprint.objects if item.name == filled)
        config = pasta_config_of(source, blueprint, base.locations)
        task = base.config.task.model_copy(update={"things": {filled: Role(of=(config,), filled=filling)}})
        assert len(stacked_poses(task, filled)) == len(loose_pieces(task)[filled])
        if name == STRANDS:
            part: Any = filling.of.collision[0]
            length = np.linalg.norm(np.subtract(part.end, part.start)) + 2 * part.radius
            assert 100 * length == pytest.approx(blueprint.conditions["strand_length_cm"])


def test_pieces_get_thicker_and_not_longer_where_they_would_be_too_many(base: Any) -> None:
    """Longer pieces would wedge themselves between the near walls of a carton."""
    filling = fillings_of(blueprint_of(SCENES["pour-pasta-full-box"]), base.locations)["source"]
    (part,) = filling.of.collision
    assert isinstance(part, Capsule)
    assert np.linalg.norm(np.subtract(part.end, part.start)) + 2 * part.radius == pytest.approx(0.05, abs=1e-4)
    assert part.radius > 0.006
    assert piece_count(filling) == (44, pytest.approx(1.0, abs=0.01))
    line = describe_coarse_pieces("source", filling, blueprint_of(SCENES["pour-pasta-full-box"]), base.locations)
    assert line.startswith("dry_pasta: 427 g are 44 pieces 13.") and line.endswith("thick instead of 8.0 mm")
    thin = blueprint_of(SCENES[CUP])
    assert describe_coarse_pieces("source", fillings_of(thin, base.locations)["source"], thin, base.locations) == ""


@pytest.mark.parametrize("task", ["pour_pasta", "scoop_pasta"])
def test_pasta_has_the_same_friction_everywhere(task: str, base: Any) -> None:
    """MuJoCo takes the larger friction of two objects, so it has to be low on both."""
    for scene in tasks.TASK_FACTORIES[task]().scenes:
        blueprint = blueprint_of(scene)
        (filling,) = fillings_of(blueprint, base.locations).values()
        bodies = [pasta_config_of(item, blueprint, base.locations) for item in blueprint.objects if is_body(item)]
        assert {item.contact.friction[0] for item in (filling.of, *bodies)} == {0.35}


@pytest.mark.parametrize("angle", [0.0, 15.0, 40.0, 75.0, 90.0, 120.0])
def test_the_lip_is_just_so_high_that_the_source_clears_the_rim(angle: float) -> None:
    tilt, tall, behind, gap = math.radians(angle), 0.26, 0.08, 0.02
    height = lip_height(tilt, tall, behind, gap)
    assert height <= tall * max(math.cos(tilt), 0.0) + gap + 1e-9
    # The source's lower side, from the lip down to its bottom; the wall of the vessel stands below (behind, 0).
    along = np.linspace(0.0, tall, 2001)
    back, up = along * math.sin(tilt), height - along * math.cos(tilt)
    distances = np.hypot(back - behind, np.maximum(up, 0.0))
    assert distances.min() >= gap - 1e-4


def test_loose_pieces_may_roll_while_a_scene_is_at_rest(base: Any) -> None:
    realized = build_benchmark_scene(blueprint_of(SCENES[CUP], 4), base)
    try:
        scene, motion = realized.simulator.scene, SceneStepper(realized, 10)
        assert motion.is_at_rest()
        rolling = scene.model.jnt_dofadr[scene.pieces["source"][0]]
        motion.data.qvel[rolling] = 1.0
        assert motion.is_at_rest()
        motion.data.qvel[scene.object_dof["source"]] = 1.0
        assert not motion.is_at_rest()
    finally:
        realized.simulator.close()


@pytest.mark.slow
@pytest.mark.parametrize("name", [CUP, STRANDS])
def test_pasta_counts_by_piece_where_it_is(name: str, base: Any) -> None:
    blueprint = blueprint_of(SCENES[name])
    vessel, total = blueprint.roles["vessel"][0], blueprint.success_params["total_g"]
    realized = build_benchmark_scene(blueprint, base)
    try:
        motion = SceneStepper(realized, 10)
        judge = KitchenJudge(realized, motion)
        mass = judge.world.contained_mass_g
        assert mass("pasta", "source") == pytest.approx(total)
        assert mass("pasta", vessel) == 0.0
        motion.execute_action(motion.last_reference)
        assert not judge.evaluate()[0]
        model, data = realized.simulator.scene.model, motion.data
        middle = realized.simulator.scene.object_qpos[vessel]
        joints = list(realized.simulator.scene.pieces["source"])
        moved = joints[: round(0.85 * len(joints))]
        for address in model.jnt_qposadr[moved]:
            data.qpos[address : address + 3] = data.qpos[middle : middle + 3] + np.array([0.0, 0.0, 0.06])
        mujoco.mj_forward(model, data)
        assert mass("pasta", vessel) == pytest.approx(total * len(moved) / len(joints))
        assert judge.evaluate()[0]
        with pytest.raises(KeyError, match="saucer"):
            mass("pasta", "saucer")
    finally:
        realized.simulator.close()


@pytest.mark.slow
@pytest.mark.parametrize(("name", "epoch"), [(STRANDS, 0), ("pour-pasta-measuring-cup-to-bowl", 2)])
def test_the_expert_pours(name: str, epoch: int, base: Any) -> None:
    blueprint = blueprint_of(SCENES[name], epoch)
    source, vessel, total = "source", blueprint.roles["vessel"][0], blueprint.success_params["total_g"]
    realized = build_benchmark_scene(blueprint, base)
    planning = PlanningScene(realized, int(seed_of(SCENES[name], epoch)), 10)
    try:
        judge = KitchenJudge(realized, planning.motion)
        planning.start_program([Pour(thing=source, into=vessel)], realized.simulator.roles)
        run_expert(planning, judge, 100)
        mass = judge.world.contained_mass_g
        assert judge.evaluate()[0]
        assert mass("pasta", vessel) >= 0.8 * total
        assert judge.world.scene.holding_sides(source)
    finally:
        planning.close()
