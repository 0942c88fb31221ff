"""Read the arms' joints in photos from .npy, YAML and .pkl files."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from yamsim_cli.core.attempt_data import ArmPosture
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.dataset.lowdim import load_frame
from yamsim_cli.core.errors import ConfigError, DatasetError
from yamsim_cli.core.files.documents.yaml_document import load_yaml
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.robots.joint_limits import describe_limit_violation

_LIMIT_TOLERANCE = math.radians(3.0)  # rad beyond a limit, for errors of encoders and calibrations
_MAX_OPENING_SHARE = 1.1  # ratio of an opening to the full opening

_SUFFIXES = (".npy", ".yaml", ".yml", ".pkl")

# Joints (rad) and opening (m) of each arm, in the rig's order.
ArmPostures = tuple[ArmPosture, ...]


def home_postures(rig: RigConfig) -> ArmPostures:
    """Return home joints with closed grippers."""
    return tuple(ArmPosture(np.array(arm.robot.home), 0.0) for arm in rig.arms)


def load_postures(path: Path, rig: RigConfig) -> list[ArmPostures]:
    """Read one element for all photos, or one per photo.

    An `.npy` file holds a row, or a row per photo; a `.pkl` file, a recorded frame's `joints`; a YAML file, `joints:
    [...]` or a list per arm name. A row has each arm's joints (rad) and, with fingers, one finger's opening (m), left
    arm first. For a rig of one arm, a row may omit the opening, or hold two arms. If a value exceeds 1.1 full openings,
    all are shares 0..1.

    Raises:
        ConfigError: the file is unreadable, or its shape or values are wrong.
    """
    kind = path.suffix.lower()
    if kind not in _SUFFIXES:
        raise ConfigError(f"--joints {path}: unknown kind of file {path.suffix!r}; valid: {', '.join(_SUFFIXES)}")
    try:
        values = (
            _yaml_rows(path, rig) if kind in (".yaml", ".yml") else _split_by_arm(_load_numbers(path, kind), rig, path)
        )
    except OSError as error:
        raise ConfigError(f"--joints {path}: cannot be read: {error.strerror or error}") from error
    if not all(np.isfinite(rows).all() for rows in values):
        raise ConfigError(f"--joints {path}: has values that are not finite; give radians")
    for arm, rows in zip(rig.arms, values, strict=True):
        if fault := describe_limit_violation(arm.name, arm.robot, rows, _LIMIT_TOLERANCE):
            raise ConfigError(f"--joints {path}: {fault}")
    return _arm_postures(_openings_in_metres(values, rig, path), rig)


def recorded_postures(joints: Array, rig: RigConfig, source: Path) -> ArmPostures:
    """Return postures from a recorded frame's `joints`. Raises ConfigError for a wrong shape."""
    return _arm_postures(_split_by_arm(joints, rig, source), rig)[0]


def _arm_postures(values: list[Array], rig: RigConfig) -> list[ArmPostures]:
    dofs = [arm.robot.dof for arm in rig.arms]
    return [
        tuple(
            ArmPosture(row[:dof], float(row[dof]) if len(row) > dof else 0.0)
            for dof, row in zip(dofs, rows, strict=True)
        )
        for rows in zip(*values, strict=True)
    ]


def _openings_in_metres(values: list[Array], rig: RigConfig, path: Path) -> list[Array]:
    fingers = [(arm.robot.fingers.full_opening, k) for k, arm in enumerate(rig.arms) if arm.robot.fingers]
    are_shares = any((values[k][:, -1] > _MAX_OPENING_SHARE * full).any() for full, k in fingers)
    for full, k in fingers:
        given = values[k][:, -1]
        shares = given if are_shares else given / full
        # Drives report values beyond both limits; some grippers close beyond 0 for force.
        if shares.min() < -0.15 or shares.max() > _MAX_OPENING_SHARE:
            worst = given[np.abs(shares - 0.5).argmax()]
            raise ConfigError(
                f"--joints {path}: gripper {worst:.4g} is not an opening; valid: the opening of one finger, "
                f"0..{full} m, or a share of it, 0..1"
            )
        values[k][:, -1] = np.clip(shares, 0.0, 1.0) * full
    return values


def _load_numbers(path: Path, kind: str) -> Array:
    if kind == ".npy":
        try:
            # `np.load` would accept .npz archives.
            with path.open("rb") as stream:
                return np.asarray(np.lib.format.read_array(stream, allow_pickle=False), dtype=np.float64)
        except (ValueError, TypeError, EOFError, MemoryError) as error:
            raise ConfigError(f"--joints {path}: not an array of numbers: {error}") from error
    try:
        frame = load_frame(path.read_bytes())
        return np.asarray(frame["joints"], dtype=np.float64)
    except KeyError:
        raise ConfigError(f"--joints {path}: the frame has no key 'joints'") from None
    except (DatasetError, ValueError, TypeError) as error:
        raise ConfigError(f"--joints {path}: {error}") from error


def _yaml_rows(path: Path, rig: RigConfig) -> list[Array]:
    data = load_yaml(path).data
    names = [arm.name for arm in rig.arms]
    if set(data) == {"joints"}:
        return _split_by_arm(_float_array(data["joints"], path), rig, path)
    if not data or not set(data) <= set(names):
        raise ConfigError(
            f"--joints {path}: has the keys {', '.join(data)}; valid: joints alone, or {', '.join(names)}"
        )
    found = []
    for arm in rig.arms:
        values = _float_array(data[arm.name], path) if arm.name in data else np.array(arm.robot.home)
        dof, width = arm.robot.dof, len(arm.robot.drive_names)
        if values.shape not in ((dof,), (width,)):
            with_gripper = f", or {width} with the gripper" if width > dof else ""
            raise ConfigError(
                f"--joints {path}: {arm.name}: has the shape {values.shape}; give {dof} joints{with_gripper}"
            )
        found.append(_pad_columns(values[None], width))
    return found


def _float_array(value: object, path: Path) -> Array:
    try:
        return np.asarray(value, dtype=np.float64)
    except (ValueError, TypeError) as error:
        raise ConfigError(f"--joints {path}: not a list of numbers: {error}") from error


def _split_by_arm(values: Array, rig: RigConfig, path: Path) -> list[Array]:
    rows = np.atleast_2d(values)
    if len(rows) == 0:
        raise ConfigError(f"{path}: holds no row of joints")
    count = rows.shape[1] if rows.ndim == 2 else 0
    each, dof, alone = rig.drive_count, rig.arms[0].robot.dof, len(rig.arms) == 1
    if alone and count in (dof, each):
        return [_pad_columns(rows, each)]
    if count == 2 * each:
        # The recorder of a real station stores two arms.
        return [rows[:, :each].copy() if arm.side == "left" else rows[:, each:].copy() for arm in rig.arms]
    valid = " or ".join(map(str, dict.fromkeys((dof, each, 2 * each)))) if alone else _describe_columns(rig)
    raise ConfigError(f"{path}: joints have the shape {values.shape}; rig {rig.name!r} needs {valid} numbers a row")


def _pad_columns(rows: Array, width: int) -> Array:
    padded = np.zeros((len(rows), width))
    padded[:, : rows.shape[1]] = rows
    return padded


def _describe_columns(rig: RigConfig) -> str:
    arms = [rig.arms[k] for k in rig.recording_order]
    parts = []
    for arm in arms:
        parts += [f"{arm.side} {arm.robot.dof}"] + [f"{arm.side} gripper"] * bool(arm.robot.fingers)
    return f"{len(arms) * rig.drive_count} ({', '.join(parts)})"
