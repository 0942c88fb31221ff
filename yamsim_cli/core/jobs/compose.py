"""Compose a rig, with or without a task, into a folder or a zip file for other programs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from ..config.record import RecordConfig
from ..config.rig import RigConfig
from ..config.scene import SceneConfig
from ..errors import ResourceError, SimulationError, UsageError
from ..files import move_aside, publish_file, refusal, staged_directory, write_file
from ..resources import Locations
from ..scene.build import add_scene_camera, add_task_physics
from ..scene.compose import Contents, Meshes, add_home_key, compose
from ..scene.export import Reader, scene_files, zip_bytes
from ..tasks.kinds import draw_layout
from ..types import EpisodeJob


@dataclass(frozen=True)
class ComposeReport:
    """What was composed: where it is, its files, and the compiled model's size and bodies."""

    path: Path
    files: tuple[str, ...]
    nq: int
    nu: int
    bodies: tuple[str, ...]
    moved_aside: Path | None


def rig_spec(
    rig: RigConfig, scene: SceneConfig, contents: Contents, locations: Locations, meshes: Meshes
) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    """A rig alone, with keyframe `home`: what `compose-xml`, `render-views` and `view` start from."""
    spec = compose(rig, scene, contents, locations, meshes)
    return spec, add_home_key(spec, rig, {})


def task_spec(
    config: RecordConfig, contents: Contents, locations: Locations, meshes: Meshes
) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    """A task's scene, its objects where the seed's first attempt has them, with keyframe `home`.

    Raises:
        SimulationError: the sampling box has no room for both objects.
    """
    layout = draw_layout(config, EpisodeJob(config.seed, 0))
    if layout is None:
        raise SimulationError(f"task {config.task.name!r}: the sampling box has no room for both objects")
    spec = compose(config.rig, config.surroundings, contents, locations, meshes)
    add_task_physics(spec, config)
    add_scene_camera(spec, config)
    return spec, add_home_key(spec, config.rig, layout.T_in_world, config.task.start_joints)


def write_scene(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    out: Path,
    *,
    as_zip: bool,
    overwrite: bool,
    reader: Reader = "3.3",
) -> ComposeReport:
    """Write a composed scene to a folder, or to one zip file.

    Args:
        overwrite: move what is at `out` aside, once the new scene is on the disk.

    Raises:
        UsageError: `out` is in the way, or the scene holds something that `reader` does not know.
        ResourceError: it cannot be written; what was at `out` is still there.
        SimulationError: the result is not stable: plain MuJoCo, reading it, would see it fly apart.
    """
    _check_stable(model)
    files = scene_files(spec, model, reader)
    try:
        # An empty directory is as good as none.
        if out.is_dir() and not any(out.iterdir()):
            out.rmdir()
        if (out.exists() or out.is_symlink()) and not overwrite:
            raise UsageError(f"{out} exists; move it aside with --overwrite, or choose another --out")
        out.parent.mkdir(parents=True, exist_ok=True)
        moved = _write_zip(files, out) if as_zip else _write_folder(files, out)
    except OSError as error:
        raise ResourceError(f"{out} cannot be written: {refusal(error, out)}; choose another --out") from error
    bodies = tuple(model.body(k).name for k in range(1, model.nbody))
    return ComposeReport(out, tuple(files), model.nq, model.nu, bodies, moved)


def _write_folder(files: dict[str, bytes], out: Path) -> Path | None:
    with staged_directory(out, overwrite=True) as stage:
        for name, data in files.items():
            path = stage.path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
    return stage.moved_aside


def _write_zip(files: dict[str, bytes], out: Path) -> Path | None:
    part = out.with_name(f".{out.name}.part")
    try:
        write_file(part, zip_bytes(files, out.stem))
        moved = move_aside(out) if out.exists() or out.is_symlink() else None
        publish_file(part, out)
    finally:
        part.unlink(missing_ok=True)
    return moved


def _check_stable(model: mujoco.MjModel) -> None:
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, 100)
    if not np.isfinite(data.qpos).all() or np.abs(data.qpos - model.key_qpos[0]).max() > 0.05:
        raise SimulationError("the composed scene does not stay where it is put: do parts of it overlap?")
