"""Composes a rig, with or without a task, and writes the scene to files for other programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import mujoco
import numpy as np

from yamsim_cli.core.attempt_data import AttemptJob
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.sampling import describe_missing_start, sample_attempt
from yamsim_cli.core.episode.simulator import SimulatorCache
from yamsim_cli.core.errors import ResourceError, SimulationError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.files.writing import describe_refusal, move_to_backup, publish_file, staged_directory, write_file
from yamsim_cli.core.geometry.se3 import Array, pose_from_quat
from yamsim_cli.core.scene.blueprint import Blueprint
from yamsim_cli.core.scene.compiled import CompiledScene
from yamsim_cli.core.scene.compose import add_home_key, compose_scene
from yamsim_cli.viewers.show.scene_files import Reader, scene_files, zip_bytes


@dataclass(frozen=True)
class ComposeReport:
    """A written scene: path, files, sizes and bodies of the MuJoCo model, and the backup of an older output."""

    path: Path
    files: tuple[str, ...]
    nq: int
    nu: int
    bodies: tuple[str, ...]
    moved_aside: Path | None


@dataclass(frozen=True)
class HomeKeyframe:
    """Initial state of a composed scene, for its MuJoCo keyframe `home`.

    Attributes:
        T_in_world: object, or piece in an object -> pose (4, 4) in `world`.
        joints: joints of each arm, rad; None for the home posture.
        parts: joint of an articulated object -> joint position, m or rad; other joints are at their closed position.
    """

    T_in_world: Mapping[str, Array] = field(default_factory=dict)
    joints: Sequence[Sequence[float]] | None = None
    parts: Mapping[str, float] = field(default_factory=dict)


def first_attempt_start(session: Session) -> tuple[RecordConfig, HomeKeyframe]:
    """Sample a session's first attempt. Return the config with its objects, and its start state."""
    job = AttemptJob(session.config.seed, 0)
    with SimulatorCache(session.without_meshes()) as simulators:
        simulator = simulators.get(job)
        attempt = sample_attempt(simulator, job)
        config = simulator.config
        if attempt.layout is None or attempt.start is None:
            raise SimulationError(f"task {config.task.name!r}: {describe_missing_start(simulator, attempt)}")
        loose = _piece_poses(simulator.scene, attempt.start)
        parts = [f"{item.name}_{link.name}" for item in config.task.objects for link in item.links]
        opened = {name: float(attempt.start[simulator.scene.model.joint(name).qposadr[0]]) for name in parts}
    # An arm that does not act in the task has the start posture of its model.
    joints = [
        config.start_joints if number in config.acting_indices else arm.robot.start
        for number, arm in enumerate(config.rig.arms)
    ]
    return config, HomeKeyframe({**attempt.layout.T_in_world, **loose}, joints, opened)


def _piece_poses(scene: CompiledScene, qpos: Array) -> dict[str, Array]:
    """Return piece in a filled object -> its pose (4, 4) in `world` at `qpos` (nq,)."""
    joints = [scene.model.joint(k) for ids in scene.pieces.values() for k in ids]
    at = {joint.name: int(joint.qposadr[0]) for joint in joints}
    return {name: pose_from_quat(qpos[k : k + 3], qpos[k + 3 : k + 7]) for name, k in at.items()}


def compose_at_home(
    blueprint: Blueprint, locations: Locations, home: HomeKeyframe | None = None
) -> tuple[mujoco.MjSpec, mujoco.MjModel]:
    """Compose a scene with keyframe `home`, by default without objects. Return spec and compiled model."""
    spec, home = compose_scene(blueprint, locations), home or HomeKeyframe()
    return spec, add_home_key(spec, blueprint.rig, home.T_in_world, home.joints, home.parts)


def write_scene(
    spec: mujoco.MjSpec,
    model: mujoco.MjModel,
    out: Path,
    *,
    as_zip: bool,
    overwrite: bool,
    reader: Reader = "3.3",
) -> ComposeReport:
    """Write a composed scene, which must be stable in MuJoCo, to a folder or one zip file.

    Args:
        overwrite: whether to replace an existing `out`, which is renamed once the new scene is on the disk.
        reader: oldest MuJoCo version that must read the scene.
    """
    _check_stable(model)
    files = scene_files(spec, model, reader)
    try:
        if out.is_dir() and not any(out.iterdir()):
            out.rmdir()
        if (out.exists() or out.is_symlink()) and not overwrite:
            raise UsageError(f"{out} exists; move it aside with --overwrite, or choose another --out")
        out.parent.mkdir(parents=True, exist_ok=True)
        moved = _write_zip(files, out) if as_zip else _replace_folder(files, out)
    except OSError as error:
        raise ResourceError(f"{out} cannot be written: {describe_refusal(error, out)}; choose another --out") from error
    bodies = tuple(model.body(k).name for k in range(1, model.nbody))
    return ComposeReport(out, tuple(files), model.nq, model.nu, bodies, moved)


def _replace_folder(files: dict[str, bytes], out: Path) -> Path | None:
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
        moved = move_to_backup(out) if out.exists() or out.is_symlink() else None
        publish_file(part, out)
    finally:
        part.unlink(missing_ok=True)
    return moved


def _check_stable(model: mujoco.MjModel) -> None:
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_step(model, data, 100)
    if not np.isfinite(data.qpos).all() or np.abs(data.qpos - model.key_qpos[0]).max() > 0.05:
        raise SimulationError("the composed scene does not stay at rest: check whether parts of it overlap")
