"""Scenes of pouring: their pasta, its mass by piece, and the checker's verdicts."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

pytest.importorskip("inspect_robots", reason="needs yamsim[inspect]")
pytest.importorskip("kitchenbench", reason="needs yamsim[inspect]")

from inspect_robots.rollout import derive_seed
from kitchenbench import tasks
from kitchenbench.sim import build_blueprint

from yamsim_cli.core.config.program_task import Role
from yamsim_cli.kitchenbench.asset_configs import fillings_of, pouring_config_of
from yamsim_cli.kitchenbench.benchmark_scene import build_benchmark_scene, open_station_session
from yamsim_cli.kitchenbench.scene_stepper import SceneStepper
from yamsim_cli.kitchenbench.skill_programs import build_scene_program
from yamsim_cli.kitchenbench.success_judges import KitchenJudge
from yamsim_cli.loose_pieces import loose_pieces, piece_count, stacked_poses

SCENES = {scene.id: scene for scene in tasks.TASK_FACTORIES["pour_pasta"]().scenes}
CUP, STRANDS = "pour-pasta-narrow-cup", "pour-pasta-long-spaghetti"


@pytest.fixture(scope="module")
def base() -> Any:
    return open_station_session("64x48", images=False)


def blueprint_of(name: str, epoch: int = 0) -> Any:
    return build_blueprint(SCENES[name], derive_seed(0, SCENES[name].init_seed, epoch))


@pytest.mark.parametrize("name", SCENES)
def test_every_source_holds_its_pasta(name: str, base: Any) -> None:
    for epoch in range(2):
        blueprint = blueprint_of(name, epoch)
        (filled, filling), *others = fillings_of(blueprint, base.locations).items()
        assert (filled, others) == ("source", [])
        assert filling.grams == blueprint.success_params["total_g"]
        assert piece_count(filling)[0] <= 44
        source = next(item for item in blueprint.objects if item.name == filled)
        config = pouring_config_of(source, blueprint, base.locations)
        task = base.config.task.model_copy(update={"things": {filled: Role(of=(config,), filled=filling)}})
        assert len(stacked_poses(task, filled)) == len(loose_pieces(task)[filled])
        if name == STRANDS:
            part: Any = filling.of.collision[0]
            length = np.linalg.norm(np.subtract(part.end, part.start)) + 2 * part.radius
            assert 100 * length == pytest.approx(blueprint.conditions["strand_length_cm"])


def test_no_expert_pours() -> None:
    with pytest.raises(LookupError, match="no expert for goals of kind 'pour_into'"):
        build_scene_program(blueprint_of(CUP), {}, [])


@pytest.mark.slow
@pytest.mark.parametrize("name", [CUP, STRANDS])
def test_pasta_counts_by_piece_where_it_is(name: str, base: Any) -> None:
    blueprint = blueprint_of(name)
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
