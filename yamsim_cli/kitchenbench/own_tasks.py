"""yamsim's tasks as tasks of the framework Inspect Robots, such as `yamsim/tower`."""

from __future__ import annotations

import zlib
from functools import partial

from inspect_robots import Epochs, Scene, Target, Task

from .benchmark_scene import open_station_session
from .yamsim_scene import BENCHMARK, TASK_GOAL_KIND

_DEFAULT_TRIALS = 5  # without the option `--epochs`, as in KitchenBench's scenes


def make_task(name: str) -> Task:
    """Return a yamsim task: one scene, whose trials differ by their seeds."""
    session = open_station_session("64x48", images=False, task=name)
    task = session.config.task
    return Task(
        name=f"{BENCHMARK}/{name}",
        scenes=[
            Scene(
                id=name,
                instruction=task.language_prompt,
                target=Target(kind=TASK_GOAL_KIND, spec={"task": name}),
                init_seed=zlib.crc32(f"{BENCHMARK}/{name}".encode()),
                metadata={"benchmark": BENCHMARK, "task": name},
            )
        ],
        scorer=["success_at_end", "episode_length"],
        max_seconds=task.time_limit_s,
        epochs=Epochs(count=_DEFAULT_TRIALS, reducer="mean"),
        metadata={"title": name.replace("_", " ")},
    )


cans_into_bin = partial(make_task, "cans_into_bin")
drawer = partial(make_task, "drawer")
fold_napkin = partial(make_task, "fold_napkin")
fold_napkin_diagonal = partial(make_task, "fold_napkin_diagonal")
fold_napkin_crumpled = partial(make_task, "fold_napkin_crumpled")
fold_napkin_thirds = partial(make_task, "fold_napkin_thirds")
hand_over_and_place = partial(make_task, "hand_over_and_place")
handover = partial(make_task, "handover")
hang_mug = partial(make_task, "hang_mug")
lift_tray = partial(make_task, "lift_tray")
onto_napkin = partial(make_task, "onto_napkin")
pickplace = partial(make_task, "pickplace")
set_upright = partial(make_task, "set_upright")
sort_row = partial(make_task, "sort_row")
swap = partial(make_task, "swap")
tower = partial(make_task, "tower")
