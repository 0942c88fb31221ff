"""Realizations of KitchenBench's scenes, with the seeds that Inspect Robots derives."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from inspect_robots import Scene
from inspect_robots.rollout import derive_seed
from kitchenbench.sim import build_blueprint

from yamsim_cli.kitchenbench.benchmark_scene import build_benchmark_scene, open_station_session
from yamsim_cli.kitchenbench.policy import PlanningScene
from yamsim_cli.kitchenbench.success_judges import KitchenJudge


def seed_of(scene: Scene, epoch: int = 0, root: int = 0) -> int:
    return derive_seed(root, scene.init_seed, epoch)


def blueprint_of(scene: Scene, epoch: int = 0) -> Any:
    return build_blueprint(scene, seed_of(scene, epoch))


@contextmanager
def judged_planning_scene(scene: Scene, epoch: int = 0, root: int = 0) -> Iterator[tuple[PlanningScene, KitchenJudge]]:
    """Open a realization in the expert's planning scene, with the benchmark's judge."""
    seed = seed_of(scene, epoch, root)
    realized = build_benchmark_scene(build_blueprint(scene, seed), open_station_session("64x48", images=False))
    planning = PlanningScene(realized, seed, 10)
    try:
        yield planning, KitchenJudge(realized, planning.motion)
    finally:
        planning.close()
