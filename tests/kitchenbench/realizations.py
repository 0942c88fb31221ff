"""Realizations of KitchenBench's scenes, with the seeds that Inspect Robots derives."""

from __future__ import annotations

from typing import Any

from inspect_robots import Scene
from inspect_robots.rollout import derive_seed
from kitchenbench.sim import build_blueprint


def seed_of(scene: Scene, epoch: int = 0) -> int:
    return derive_seed(0, scene.init_seed, epoch)


def blueprint_of(scene: Scene, epoch: int = 0) -> Any:
    return build_blueprint(scene, seed_of(scene, epoch))
