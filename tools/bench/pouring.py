"""Build the first realization of each scene of KitchenBench's `pour_pasta`, and hold still for a second.

python -m tools.bench.pouring

With `--pour`, let the expert pour, judged by the benchmark's checker in the expert's planning scene after every motion:

python -m tools.bench.pouring --pour narrow-cup full-box --realizations 0 1 2 3 4 --seed 0
"""

from __future__ import annotations

import argparse
import time
from typing import Any

from inspect_robots.rollout import derive_seed
from kitchenbench import tasks
from kitchenbench.sim import build_blueprint

from yamsim_cli.kitchenbench.benchmark_scene import TICK_HZ, build_benchmark_scene, open_station_session
from yamsim_cli.kitchenbench.policy import PlanningScene
from yamsim_cli.kitchenbench.scene_stepper import SceneStepper
from yamsim_cli.kitchenbench.success_judges import KitchenJudge

MAX_ACTIONS = 100  # of a trial, as in the benchmark


def main() -> None:
    """Measure from the command line."""
    scenes = {scene.id.removeprefix("pour-pasta-"): scene for scene in tasks.TASK_FACTORIES["pour_pasta"]().scenes}
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pour", nargs="*", metavar="SCENE", help=f"all, or some of: {', '.join(scenes)}")
    parser.add_argument("--realizations", nargs="*", type=int, default=[0])
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    if unknown := set(given.pour or ()) - scenes.keys():
        parser.error(f"unknown scene {', '.join(sorted(unknown))}; the scenes are {', '.join(scenes)}")
    if given.pour is None:
        hold_still()
        return
    for name in given.pour or scenes:
        for number in given.realizations:
            pour(scenes[name], int(derive_seed(given.seed, scenes[name].init_seed, number)), number)


def pour(scene: Any, seed: int, number: int) -> None:
    """Let the expert pour in a realization, and print the verdict."""
    blueprint, begin = build_blueprint(scene, seed), time.process_time()
    realized = build_benchmark_scene(blueprint, open_station_session("64x48", images=False))
    planning = PlanningScene(realized, seed, TICK_HZ // 3)
    judge, actions = KitchenJudge(realized, planning.motion), 0
    while actions < MAX_ACTIONS and not judge.evaluate()[0]:
        actions += len(planning.next_actions())
    reached, explanation = judge.evaluate()
    print(f"{scene.id} {number}: {reached}, {explanation} of {blueprint.success_params['total_g']:.0f} g", end=", ")
    print(f"{actions} actions, {time.process_time() - begin:.0f} s", flush=True)
    planning.close()


def hold_still() -> None:
    """Build the scenes, and print what is in source and vessel after a second."""
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
