"""Lids of KitchenBench's containers: measured opening, torque to open, and sealing by the expert."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("kitchenbench")

from inspect_robots.rollout import derive_seed
from kitchenbench import tasks
from kitchenbench.sim import build_blueprint

from yamsim_cli.kitchenbench.benchmark_scene import BenchmarkScene, build_benchmark_scene, open_station_session
from yamsim_cli.kitchenbench.policy import PlanningScene
from yamsim_cli.kitchenbench.scene_stepper import SceneStepper
from yamsim_cli.kitchenbench.success_judges import KitchenJudge


def _build(task: str, instance: str) -> tuple[BenchmarkScene, int]:
    scene = next(one for one in tasks.TASK_FACTORIES[task]().scenes if one.id.endswith(instance))
    seed = int(derive_seed(0, scene.init_seed, 0))
    return build_benchmark_scene(build_blueprint(scene, seed), open_station_session("64x48", images=False)), seed


@pytest.mark.parametrize(
    ("instance", "name", "condition"),
    [("bottle-cap", "bottle", "lid_torque_nm"), ("snap-lid", "container", "pry_force_n")],
)
def test_a_lid_opens_above_its_torque_or_force_and_not_below(instance: str, name: str, condition: str) -> None:
    built, _ = _build("open_container", instance)
    try:
        effort = float(built.blueprint.conditions[condition])
        for share, opens in ((0.4, False), (1.5, True)):
            motion = SceneStepper(built, 10)
            judge = KitchenJudge(built, motion)
            joint = built.simulator.scene.model.joint(f"{name}_lid")
            assert not judge.evaluate()[0]
            motion.data.qfrc_applied[joint.dofadr[0]] = share * effort
            for _ in range(3):
                motion.execute_action(motion.last_reference)
            assert (judge.world.opening_fraction(name) > 0.7) == opens
            assert judge.evaluate()[0] == opens
    finally:
        built.simulator.close()


def test_the_expert_seals_a_pot_that_is_not_sealed_at_the_start() -> None:
    built, seed = _build("seal_container", "snap-on-pot")
    planning = PlanningScene(built, seed, 10)
    try:
        judge = KitchenJudge(built, planning.motion)
        assert not judge.evaluate()[0]
        for _ in range(12):
            planning.next_actions()
        assert judge.evaluate() == (True, "pot sealed with lid")
        T_lid, T_pot = judge.world.scene.pose("lid"), judge.world.scene.pose("pot")
        assert np.linalg.norm(T_lid[:2, 3] - T_pot[:2, 3]) < 0.02
    finally:
        planning.close()
