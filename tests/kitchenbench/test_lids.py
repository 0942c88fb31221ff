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
    ("instance", "name", "condition", "too_little"),
    [("bottle-cap", "bottle", "lid_torque_nm", 0.95), ("snap-lid", "container", "pry_force_n", 0.4)],
)
def test_a_lid_opens_above_its_torque_or_force_and_not_below(
    instance: str, name: str, condition: str, too_little: float
) -> None:
    built, _ = _build("open_container", instance)
    try:
        effort = float(built.blueprint.conditions[condition])
        for share, opens in ((too_little, False), (1.5, True)):
            motion = SceneStepper(built, 10)
            judge = KitchenJudge(built, motion)
            joint = built.simulator.scene.model.joint(f"{name}_lid")
            assert not judge.evaluate()[0]
            motion.data.qfrc_applied[joint.dofadr[0]] = share * effort
            for _ in range(3):
                motion.execute_action(motion.last_reference)
            assert (judge.world.opening_fraction(name) > 0.7) == opens
            # Dry friction must not creep: MuJoCo's default would let this lid turn.
            assert opens or judge.world.opening_fraction(name) < 0.1
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


@pytest.mark.slow
@pytest.mark.parametrize("instance", ["tilted", "snap-lid"])
def test_the_expert_opens_a_lid_with_one_hand_while_the_other_steadies_the_container(instance: str) -> None:
    built, seed = _build("open_container", instance)
    planning = PlanningScene(built, seed, 10)
    try:
        judge = KitchenJudge(built, planning.motion)
        actions = 0
        while actions < 120 and not judge.evaluate()[0]:
            actions += len(planning.next_actions())
        assert judge.evaluate()[0], judge.evaluate()[1]
        # The container stays on the table, so the lid was not just lifted together with it.
        name = built.blueprint.roles["container"][0]
        assert (
            abs(float(judge.world.scene.pose(name)[2, 3]) - built.start[built.simulator.scene.object_qpos[name] + 2])
            < 0.03
        )
    finally:
        planning.close()


def test_a_jar_wider_than_the_gripper_opens_is_refused_with_the_reason(caplog: pytest.LogCaptureFixture) -> None:
    scene = next(one for one in tasks.TASK_FACTORIES["open_container"]().scenes if one.id.endswith("stiff-jar"))
    seed = next(
        seed for seed in range(50) if any((item.size_cm or 0) > 9.5 for item in build_blueprint(scene, seed).objects)
    )
    planning = PlanningScene(
        build_benchmark_scene(build_blueprint(scene, seed), open_station_session("64x48", images=False)), seed, 10
    )
    try:
        for _ in range(3):
            planning.next_actions()
        assert "no way to open the jar: no two arms reach it and its lid" in caplog.text
    finally:
        planning.close()
