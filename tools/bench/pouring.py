"""Build the first realization of each scene of KitchenBench's `pour_pasta`, and hold still for a second.

python -m tools.bench.pouring
"""

from __future__ import annotations

import time

from inspect_robots.rollout import derive_seed
from kitchenbench import tasks
from kitchenbench.sim import build_blueprint

from yamsim_cli.kitchenbench.benchmark_scene import TICK_HZ, build_benchmark_scene, open_station_session
from yamsim_cli.kitchenbench.scene_stepper import SceneStepper
from yamsim_cli.kitchenbench.success_judges import KitchenJudge


def main() -> None:
    base = open_station_session("64x48", images=False)
    for scene in tasks.TASK_FACTORIES["pour_pasta"]().scenes:
        blueprint, begin = build_blueprint(scene, derive_seed(0, scene.init_seed, 0)), time.process_time()
        realized = build_benchmark_scene(blueprint, base)
        built = time.process_time() - begin
        motion = SceneStepper(realized, TICK_HZ)
        judge, begin = KitchenJudge(realized, motion), time.process_time()
        motion.execute_action(motion.last_reference)
        held = time.process_time() - begin
        source, vessel = (
            judge.world.contained_mass_g("pasta", blueprint.roles[role][0]) for role in ("source", "vessel")
        )
        pieces = len(realized.simulator.scene.pieces[blueprint.roles["source"][0]])
        print(f"{scene.id}: {pieces} pieces, {source:.1f} g of {blueprint.success_params['total_g']:.1f} g", end=", ")
        print(f"{vessel:.1f} g in the vessel, success {judge.evaluate()[0]}", end=", ")
        print(f"{built:.1f} s to build, {held:.1f} s for a second")
        realized.simulator.close()


if __name__ == "__main__":
    main()
