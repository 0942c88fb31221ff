"""Joints that a photo was taken with, from the files people have them in."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from ..config.document import load_yaml
from ..config.limits import Stops
from ..config.rig import RigConfig
from ..dataset.lowdim import load_frame
from ..errors import ConfigError, DatasetError
from ..geometry.se3 import Array
from ..resources import Locations
from ..scene.robot import HOME, gripper

# Encoders and calibrations are off by a little: so far outside its range a joint is still believed.
_SLACK = math.radians(3.0)
# Beyond this part of the full opening, which no finger reaches, a file gives shares of the opening and not metres.
_MOST_OPENING = 1.1

_KINDS = (".npy", ".yaml", ".yml", ".pkl")
# Fixed by the real recorder: the left arm's six joints and gripper, then the right arm's.
_SIDES = {"left": slice(0, 7), "right": slice(7, 14)}


def home_joints(rig: RigConfig) -> Array:
    """Every arm at home, grippers closed (1, arms, 7)."""
    return np.tile([*HOME, 0.0], (1, len(rig.arms), 1))


def load_joints(path: Path, rig: RigConfig, locations: Locations) -> Array:
    """Joints of every arm (rows, arms, 7): six in rad, and the opening of one finger in m; a row for each photo.

    What a file may hold: `.npy`, an array of one row or of a row for each photo; `.pkl`, a recorded frame's lowdim;
    YAML, either `joints: [...]` or a list under each arm's name. A row has 6 or 7 numbers for a rig of one arm, and 14
    (left arm's six joints and gripper, then the right arm's) for any. A gripper is the opening of one finger in m;
    where any in the file is more than a tenth above the full opening, all are shares of it.

    Raises:
        ConfigError: unreadable, another shape, not finite, or outside the joints' ranges.
    """
    kind = path.suffix.lower()
    if kind not in _KINDS:
        raise ConfigError(f"--joints {path}: unknown kind of file {path.suffix!r}; valid: {', '.join(_KINDS)}")
    try:
        rows = _yaml_rows(path, rig) if kind in (".yaml", ".yml") else _by_arm(_numbers(path, kind), rig, path)
    except OSError as error:
        raise ConfigError(f"--joints {path}: cannot be read: {error.strerror or error}") from error
    if not np.isfinite(rows).all():
        raise ConfigError(f"--joints {path}: has values that are not finite; give radians")
    _check_ranges(rows, rig, locations, path)
    rows[..., 6] = _openings(rows[..., 6], rig, path)
    return rows


def _openings(values: Array, rig: RigConfig, path: Path) -> Array:
    """Openings (rows, arms) in m, from metres or shares."""
    opened_fully = np.array([gripper(arm).full_opening for arm in rig.arms])
    full = np.ones_like(opened_fully) if (values > _MOST_OPENING * opened_fully).any() else opened_fully
    shares = values / full
    # Drives report a little beyond both ends, and some grippers close beyond 0 to squeeze.
    if shares.min() < -0.15 or shares.max() > _MOST_OPENING:
        worst = values.flat[np.abs(shares - 0.5).argmax()]
        raise ConfigError(
            f"--joints {path}: gripper {worst:.4g} is no opening: give that of one finger, "
            f"0..{opened_fully.max()} m, or a share of it, 0..1"
        )
    opened: Array = np.clip(shares, 0.0, 1.0) * opened_fully
    return opened


def arm_rows(values: Array, rig: RigConfig, source: Path) -> Array:
    """Joints of every arm (rows, arms, 7) from recorded ones (rows, 6, 7 or 14). Raises as `load_joints`."""
    return _by_arm(values, rig, source)


def _numbers(path: Path, kind: str) -> Array:
    if kind == ".npy":
        try:
            # Not `np.load`, which also opens archives.
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


def _yaml_rows(path: Path, rig: RigConfig) -> Array:
    data = load_yaml(path).data
    names = [arm.name for arm in rig.arms]
    if set(data) == {"joints"}:
        return _by_arm(_array(data["joints"], path), rig, path)
    if not data or not set(data) <= set(names):
        raise ConfigError(
            f"--joints {path}: has the keys {', '.join(data)}; valid: joints alone, or {', '.join(names)}"
        )
    rows = home_joints(rig)
    for k, name in enumerate(names):
        if name in data:
            values = _array(data[name], path)
            if values.shape not in ((6,), (7,)):
                raise ConfigError(
                    f"--joints {path}: {name}: has the shape {values.shape}; give 6 joints, or 7 with the gripper"
                )
            rows[0, k, : len(values)] = values
    return rows


def _array(value: object, path: Path) -> Array:
    try:
        return np.asarray(value, dtype=np.float64)
    except (ValueError, TypeError) as error:
        raise ConfigError(f"--joints {path}: not a list of numbers: {error}") from error


def _by_arm(values: Array, rig: RigConfig, path: Path) -> Array:
    rows = np.atleast_2d(values)
    if len(rows) == 0:
        raise ConfigError(f"{path}: holds no row of joints")
    if rows.ndim == 2 and rows.shape[1] == 14:
        return np.stack([rows[:, _SIDES[arm.side]] for arm in rig.arms], axis=1)
    if rows.ndim == 2 and rows.shape[1] in (6, 7) and len(rig.arms) == 1:
        padded = np.zeros((len(rows), 1, 7))
        padded[:, 0, : rows.shape[1]] = rows
        return padded
    valid = "6, 7 or 14" if len(rig.arms) == 1 else "14 (left 6, left gripper, right 6, right gripper)"
    raise ConfigError(f"{path}: joints have the shape {values.shape}; rig {rig.name!r} needs {valid} numbers a row")


def _check_ranges(rows: Array, rig: RigConfig, locations: Locations, path: Path) -> None:
    for k, arm in enumerate(rig.arms):
        if fault := Stops(arm, locations).fault(rows[:, k, :6], _SLACK):
            raise ConfigError(f"--joints {path}: {fault}")
