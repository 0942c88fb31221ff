"""Tasks of yamsim as tasks of Inspect Robots, such as `yamsim/tower`."""

from __future__ import annotations

import zlib
from functools import partial

from inspect_robots import Epochs, Scene, Target, Task

from .own import BENCHMARK, GOAL_KIND
from .scene import open_base

_TRIALS = 5  # without `--epochs`; KitchenBench has as many of a scene


def own_task(name: str) -> Task:
    """A yamsim task: one scene, whose trials differ by their seeds, with the task's own goal.

    Raises:
        ConfigError: there is no such task.
    """
    session = open_base("64x48", images=False, task=name)
    task = session.config.task
    return Task(
        name=f"{BENCHMARK}/{name}",
        scenes=[
            Scene(
                id=name,
                instruction=task.language_prompt,
                target=Target(kind=GOAL_KIND, spec={"task": name}),
                init_seed=zlib.crc32(f"{BENCHMARK}/{name}".encode()),
                metadata={"benchmark": BENCHMARK, "task": name},
            )
        ],
        scorer=["success_at_end", "episode_length"],
        max_seconds=task.time_limit_s,
        epochs=Epochs(count=_TRIALS, reducer="mean"),
        metadata={"title": name.replace("_", " ")},
    )


cans_into_bin = partial(own_task, "cans_into_bin")
drawer = partial(own_task, "drawer")
fold_napkin = partial(own_task, "fold_napkin")
fold_napkin_diagonal = partial(own_task, "fold_napkin_diagonal")
fold_napkin_crumpled = partial(own_task, "fold_napkin_crumpled")
fold_napkin_thirds = partial(own_task, "fold_napkin_thirds")
hand_over_and_place = partial(own_task, "hand_over_and_place")
handover = partial(own_task, "handover")
hang_mug = partial(own_task, "hang_mug")
lift_tray = partial(own_task, "lift_tray")
onto_napkin = partial(own_task, "onto_napkin")
pickplace = partial(own_task, "pickplace")
set_upright = partial(own_task, "set_upright")
sort_row = partial(own_task, "sort_row")
swap = partial(own_task, "swap")
tower = partial(own_task, "tower")
