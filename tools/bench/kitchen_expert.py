"""Let the expert act in scenes of KitchenBench, judged by the benchmark's checker; for `lids` and `pouring`."""

from __future__ import annotations

import argparse
import time
from collections.abc import Mapping
from typing import Any

from inspect_robots.rollout import derive_seed
from kitchenbench import tasks
from kitchenbench.sim import build_blueprint

from yamsim_cli.kitchenbench.benchmark_scene import TICK_HZ, build_benchmark_scene, open_station_session
from yamsim_cli.kitchenbench.policy import PlanningScene, run_expert
from yamsim_cli.kitchenbench.success_judges import KitchenJudge


def run_expert_by_options(doc: str, options: Mapping[str, str]) -> bool:
    """Let the expert act in the scenes that the command line names, and return whether it names any.

    Args:
        doc: the tool's documentation; its first line is the description.
        options: option -> the benchmark's task.
    """
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    scenes = {option: scenes_of(task) for option, task in options.items()}
    for option, found in scenes.items():
        parser.add_argument(f"--{option}", nargs="*", metavar="SCENE", help=f"all, or some of: {', '.join(found)}")
    parser.add_argument("--realizations", nargs="*", type=int, help="of each scene; the first by default")
    parser.add_argument("--seed", type=int, help="root seed of the realizations; 0 by default")
    given = vars(parser.parse_args())
    chosen = [option for option in options if given[option] is not None]
    if not chosen and (given["realizations"] or given["seed"] is not None):
        parser.error(f"--realizations and --seed need one of {', '.join(f'--{option}' for option in options)}")
    for option in chosen:
        task = options[option]
        if unknown := set(given[option]) - scenes[option].keys():
            parser.error(f"unknown scene {', '.join(sorted(unknown))}; valid: {', '.join(scenes[option])}")
        solved = [
            solve(
                scenes[option][name],
                int(derive_seed(given["seed"] or 0, scenes[option][name].init_seed, number)),
                number,
            )
            for name in given[option] or scenes[option]
            for number in given["realizations"] or [0]
        ]
        print(f"{task}: {sum(solved)} of {len(solved)}")
    return bool(chosen)


def scenes_of(task: str) -> dict[str, Any]:
    """Return short name -> scene of a task."""
    return {scene.id.removeprefix(f"{task.replace('_', '-')}-"): scene for scene in tasks.TASK_FACTORIES[task]().scenes}


def solve(scene: Any, seed: int, number: int) -> bool:
    """Let the expert act in a realization, print the verdict, and return whether it succeeded."""
    blueprint, begin = build_blueprint(scene, seed), time.process_time()
    realized = build_benchmark_scene(blueprint, open_station_session("64x48", images=False))
    planning = PlanningScene(realized, seed, TICK_HZ // 3)
    judge = KitchenJudge(realized, planning.motion)
    max_actions = tasks.TASK_FACTORIES[scene.metadata["task"]]().max_steps
    assert max_actions is not None, "KitchenBench's tasks limit the number of actions"
    actions = run_expert(planning, judge, max_actions)
    reached, explanation = judge.evaluate()
    reached &= actions <= max_actions
    tools = "".join(f" {item.asset}" for item in blueprint.objects if item.role == "tool")
    print(f"{scene.id} {number}{tools}: {reached}, {explanation}", end=", ")
    print(f"{actions} actions, {time.process_time() - begin:.0f} s", flush=True)
    planning.close()
    return reached
