"""Build the first realization of each scene of `pour_pasta` and `scoop_pasta`, and hold still for a second.

python -m tools.bench.pouring

With `--pour` or `--scoop`, let the expert act, judged by the benchmark's checker in the expert's planning scene after
every motion:

python -m tools.bench.pouring --pour narrow-cup full-box --realizations 0 1 2 3 4 --seed 0
python -m tools.bench.pouring --scoop --realizations 0 1 2 3 4 --seed 0
"""

from __future__ import annotations

import time

from inspect_robots.rollout import derive_seed
from kitchenbench.sim import build_blueprint

from tools.bench.kitchen_expert import run_expert_by_options, scenes_of
from yamsim_cli.kitchenbench.benchmark_scene import TICK_HZ, build_benchmark_scene, open_station_session
from yamsim_cli.kitchenbench.scene_stepper import SceneStepper
from yamsim_cli.kitchenbench.success_judges import KitchenJudge

_TASKS = {"pour": "pour_pasta", "scoop": "scoop_pasta"}  # option -> the benchmark's task


def main() -> None:
    """Measure from the command line."""
    if not run_expert_by_options(__doc__, _TASKS):
        hold_still()


def hold_still() -> None:
    """Build the scenes, and print what is in source and vessel after a second."""
    base = open_station_session("64x48", images=False)
    for scene in (scene for task in _TASKS.values() for scene in scenes_of(task).values()):
        blueprint, begin = build_blueprint(scene, derive_seed(0, scene.init_seed, 0)), time.process_time()
        realized = build_benchmark_scene(blueprint, base)
        built = time.process_time() - begin
        motion = SceneStepper(realized, TICK_HZ)
        judge, begin = KitchenJudge(realized, motion), time.process_time()
        motion.execute_action(motion.last_reference)
        held = time.process_time() - begin
        substance = blueprint.roles["substance"][0]
        source = realized.substances[substance]
        vessel = (blueprint.roles.get("vessel") or blueprint.roles["container"])[0]
        grams = [judge.world.contained_mass_g(substance, name) for name in (source, vessel)]
        pieces = len(realized.simulator.scene.pieces[source])
        print(
            f"{scene.id}: {pieces} pieces, {grams[0]:.1f} g in the {source}, {grams[1]:.1f} g in the vessel", end=", "
        )
        print(f"success {judge.evaluate()[0]}, {built:.1f} s to build, {held:.1f} s for a second")
        realized.simulator.close()


if __name__ == "__main__":
    main()
