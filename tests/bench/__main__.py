"""`make bench`: what each part of the main job costs on this machine, in one process.

    python -m tests.bench [--episodes N] [--json FILE]

Every figure is the median over its repetitions, after a warm-up. Nothing here is a test: a slow machine fails nothing.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path

from yamsim_cli.core.gl import choose_backend


def median_seconds(work: Callable[[int], object], repetitions: int) -> float:
    """Median time of `work(k)` for k = 1, 2, ...; call 0 warms up and does not count."""
    work(0)
    times = []
    for k in range(1, repetitions + 1):
        began = time.perf_counter()
        work(k)
        times.append(time.perf_counter() - began)
    return statistics.median(times)


def measure(episodes: int) -> dict[str, float]:
    """Figure -> seconds."""
    os.environ.setdefault("MUJOCO_GL", choose_backend(os.environ) or "")

    import mujoco
    import numpy as np

    from yamsim_cli.core.assets import AssetStore, load_lock
    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.record import RecordConfig
    from yamsim_cli.core.jobs.episode import EpisodeRunner
    from yamsim_cli.core.planning.choice import PathChooser
    from yamsim_cli.core.planning.dynamics import ArmDynamics
    from yamsim_cli.core.planning.ik import IkSolver
    from yamsim_cli.core.resources import Locations
    from yamsim_cli.core.scene.build import build_scene
    from yamsim_cli.core.scene.compose import mesh_sets
    from yamsim_cli.core.scene.robot import arm_spec, bare_arm
    from yamsim_cli.core.sim.rollout import roll_out
    from yamsim_cli.core.tasks.pickplace import OPEN, sample_layout
    from yamsim_cli.core.tasks.plans import phases
    from yamsim_cli.core.tasks.randomness import Stream, generator
    from yamsim_cli.core.types import EpisodeJob
    from yamsim_cli.core.vision.jpeg import encode_jpeg
    from yamsim_cli.core.vision.renderer import SceneRenderer

    where = Locations.find(os.environ)
    config = load_config(RecordConfig, "record", "default", where)
    lock, store = load_lock(where), AssetStore(where.assets)
    meshes = {
        name: store.resolve(lock.sets[name]) for name in mesh_sets(config.rig, (config.task.object, config.task.target))
    }
    arm, task = config.rig.arms[0], config.task
    scene = build_scene(config, where, meshes)
    ik = IkSolver(bare_arm(arm, where), scene.T_base_in_world)
    chooser = PathChooser(ik, ArmDynamics(arm_spec(arm, where, None).compile()), scene, task, config.grasp)
    start = np.array(task.start_joints)

    layouts = []
    for k in range(episodes + 1):
        layout = sample_layout(task, config.table, generator(EpisodeJob(0, k), Stream.LAYOUT))
        assert layout is not None
        layouts.append(layout)

    def plan(k: int) -> object:
        return chooser.choose(layouts[k])

    paths = [chooser.choose(layout)[1] for layout in layouts]
    figures = {"compose and compile the scene": median_seconds(lambda _: build_scene(config, where, meshes), 3)}
    figures["plan a trial (IK and feedforward)"] = median_seconds(plan, episodes)
    figures["simulate a trial"] = median_seconds(
        lambda k: roll_out(scene, layouts[k], paths[k], task.object.name, task.timing, phases(task, config.grasp)),
        episodes,
    )
    with EpisodeRunner(config, where, meshes, draw=False) as runner:
        figures["a whole trial without rendering"] = median_seconds(lambda k: runner.run(EpisodeJob(0, k)), episodes)
    data = mujoco.MjData(scene.model)
    scene.start(data, layouts[0], start, OPEN)
    with SceneRenderer(scene.model, config.image.size_px) as renderer:
        figures["render a frame"] = median_seconds(lambda _: renderer.draw(data, "scene_camera"), 20)
        image = renderer.draw(data, "scene_camera").copy()
        print(f"renderer: {renderer.description}, {image.shape[1]}x{image.shape[0]}")
    figures["encode a frame"] = median_seconds(lambda _: encode_jpeg(image, config.image.jpeg_quality), 50)
    with EpisodeRunner(config, where, meshes, draw=True) as runner:
        figures["a whole episode, rendered"] = median_seconds(lambda k: runner.run(EpisodeJob(0, k)), min(episodes, 3))
    return figures


def main() -> None:
    """Measure, print, and write the figures down when asked to."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--episodes", type=int, default=10)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    figures = measure(arguments.episodes)
    for name, seconds in figures.items():
        print(f"{name:38} {seconds * 1000:9.1f} ms")
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()
