"""Common code of benchmarks: a stopwatch, and the default recording at some quality, with full meshes."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.scene.assets import AssetStore, find_reduced, load_lock
from yamsim_cli.gl import find_backend


class Stopwatch:
    """Adds up the seconds spent inside its `with` blocks."""

    def __init__(self) -> None:
        self.seconds = 0.0
        self._began = 0.0

    def __enter__(self) -> Stopwatch:
        self._began = time.perf_counter()
        return self

    def __exit__(self, *_: object) -> None:
        self.seconds += time.perf_counter() - self._began


def median_seconds(work: Callable[[int], object], repetitions: int) -> float:
    """Median time of `work(k)` for k = 1, 2, ...; call 0 warms up and does not count."""
    work(0)
    times = []
    for k in range(1, repetitions + 1):
        with Stopwatch() as watch:
            work(k)
        times.append(watch.seconds)
    return statistics.median(times)


def use_gl() -> str:
    """Choose a backend before MuJoCo is imported, and return OpenGL's name for it."""
    backend = find_backend(os.environ)
    if backend.name is not None:
        os.environ["MUJOCO_GL"] = backend.name
    return backend.renderer


def setting(quality: str) -> Session:
    """The default recording, rendered with a quality."""
    where = Locations.from_environment(os.environ)
    config = load_config(RecordConfig, "record", "default", where, {("render",): ("--quality", quality)})
    # After the choice of a backend, because it imports MuJoCo.
    from yamsim_cli.core.scene.blueprint import recording_blueprint
    from yamsim_cli.core.scene.compose import visual_mesh_sets

    lock, store = load_lock(where), AssetStore(where.assets)
    meshes: dict[str, Path | None] = {}
    for name in visual_mesh_sets(recording_blueprint(config)):
        reduced = find_reduced(store, lock.sets[name]) if config.render.reduced_meshes else None
        meshes[name] = reduced.directory if reduced else store.find_verified_folder(lock.sets[name])
    return Session(config, replace(where, meshes=meshes))
