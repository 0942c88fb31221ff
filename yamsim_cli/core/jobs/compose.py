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
from ..files import move_aside, publish_directory, refusal, write_file
from ..resources import Locations
from ..scene.build import SCENE_CAMERA, add_fixed_camera, add_grasp_weld
from ..scene.compose import Contents, Meshes, add_home_key, compose
from ..scene.export import scene_files, zip_bytes
from ..tasks.kinds import draw_layout
from ..types import EpisodeJob

_STAGING = ".yamsim-staging"


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
    task, scene = config.task, config.surroundings
    layout = draw_layout(config, EpisodeJob(config.seed, 0))
    if layout is None:
        raise SimulationError(f"task {task.name!r}: the sampling box has no room for both objects")
    spec = compose(config.rig, scene, contents, locations, meshes)
    spec.option.timestep = task.timing.timestep
    for arm in config.rig.arms:
        add_grasp_weld(spec, task.object.name, arm.prefix)
    assert scene.scene_camera is not None  # checked when the config was loaded
    add_fixed_camera(spec, SCENE_CAMERA, scene.scene_camera)
    return spec, add_home_key(spec, config.rig, layout.T_in_world, task.start_joints)


def write_scene(
    spec: mujoco.MjSpec, model: mujoco.MjModel, out: Path, *, as_zip: bool, overwrite: bool
) -> ComposeReport:
    """Write a composed scene to a folder, or to one zip file.

    Raises:
        UsageError: `out` is in the way.
        ResourceError: it cannot be written.
        SimulationError: the result is not stable: plain MuJoCo, reading it, would see it fly apart.
    """
    _check_stable(model)
    files = scene_files(spec)
    moved = None
    try:
        # An empty directory is as good as none.
        if out.is_dir() and not any(out.iterdir()):
            out.rmdir()
        if out.exists() or out.is_symlink():
            if not overwrite:
                raise UsageError(f"{out} exists; move it aside with --overwrite, or choose another --out")
            moved = move_aside(out)
        out.parent.mkdir(parents=True, exist_ok=True)
        if as_zip:
            write_file(out, zip_bytes(files, out.stem))
        else:
            staging = out.parent / _STAGING
            publish_directory(out, files, staging)
            staging.rmdir()
    except OSError as error:
        raise ResourceError(f"{out} cannot be written: {refusal(error, out)}; choose another --out") from error
    bodies = tuple(model.body(k).name for k in range(1, model.nbody))
    return ComposeReport(out, tuple(files), model.nq, model.nu, bodies, moved)


def _check_stable(model: mujoco.MjModel) -> None:
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, 100)
    if not np.isfinite(data.qpos).all() or np.abs(data.qpos - model.key_qpos[0]).max() > 0.05:
        raise SimulationError("the composed scene does not stay where it is put: do parts of it overlap?")
