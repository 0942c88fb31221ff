"""Read and write motions as CSV: a row per sample, in s, rad, and m of one finger's opening.

Columns are `t`, `command_joint1`, `position_gripper` and so on, or `position_left_joint3` for two arms.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.recorded_motion import ArmMotion, RecordedMotion

from .recording import motion_sides

TIME_COLUMN = "t"
_COMMAND, _POSITION, _VELOCITY = "command", "position", "velocity"
_GRIPPER_COLUMN = "gripper"

_MAX_BYTES = 1 << 30  # three hours at 250 Hz are 0.6 GB


def csv_columns(rig: RigConfig) -> list[str]:
    """Return the columns that yamsim writes: time, all commands, all measured positions."""
    robots = [rig.arms[k].robot for k in rig.recording_order]
    return [
        TIME_COLUMN,
        *(
            _column_name(kind, side, joint)
            for kind in (_COMMAND, _POSITION)
            for side, robot in zip(motion_sides(rig), robots, strict=True)
            for joint in (*robot.joint_names, *([_GRIPPER_COLUMN] if robot.fingers else []))
        ),
    ]


def read_csv(path: Path, rig: RigConfig) -> RecordedMotion:
    """Read the motion of a rig's arms; other columns are ignored.

    Raises:
        DatasetError: the file cannot be read, lacks columns, or has an invalid row.
    """
    names, rows = _read_table(path)
    if TIME_COLUMN not in names:
        raise DatasetError(f"{path}: line 1: has no column {TIME_COLUMN!r}; the header is {','.join(csv_columns(rig))}")
    values = np.array(rows, dtype=np.float64).reshape(len(rows), len(names))
    if len(values) < 2:
        raise DatasetError(f"{path}: has {len(values)} samples; a motion needs at least two")
    columns: dict[str, Array] = {name: values[:, k] for k, name in enumerate(names)}
    times = columns.pop(TIME_COLUMN)
    back = np.flatnonzero(np.diff(times) <= 0)
    if len(back):
        line = int(back[0]) + 3
        raise DatasetError(
            f"{path}: line {line}: t is {times[back[0] + 1]:g}, and {times[back[0]]:g} in the line before: times "
            "must increase; sort the rows, or remove duplicate rows"
        )
    return RecordedMotion(str(path), times - times[0], _arm_motions(columns, rig, path))


def encode_csv(rig: RigConfig, times: Sequence[float] | Array, columns: Array) -> bytes:
    """Encode times (n,), s, and columns (n, m), in the order of `csv_columns`, without loss for `read_csv`."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(csv_columns(rig))
    for time, row in zip(times, columns, strict=True):
        writer.writerow([repr(float(time)), *(repr(float(value)) for value in row)])
    return stream.getvalue().encode()


def _read_table(path: Path) -> tuple[list[str], list[list[float]]]:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise DatasetError(f"{path}: has {path.stat().st_size / 1e9:.1f} GB; valid: up to {_MAX_BYTES / 1e9:.1f}")
        with path.open(newline="", encoding="utf-8-sig") as file:
            lines = csv.reader(file)
            names = [name.strip() for name in next(lines, [])]
            if len(set(names)) < len(names):
                twice = next(name for name in names if names.count(name) > 1)
                raise DatasetError(f"{path}: line 1: column {twice!r} appears twice")
            return names, list(_parse_rows(path, names, lines))
    except OSError as error:
        raise DatasetError(f"{path} cannot be read: {error.strerror or error}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise DatasetError(f"{path} is not valid CSV: {error}") from error


def _parse_rows(path: Path, names: Sequence[str], lines: Iterator[list[str]]) -> Iterator[list[float]]:
    for number, cells in enumerate(lines, start=2):
        if not cells:
            continue
        if len(cells) != len(names):
            raise DatasetError(
                f"{path}: line {number}: has {len(cells)} of {len(names)} values: was the recording cut off? "
                "Remove the line"
            )
        row = []
        for name, cell in zip(names, cells, strict=True):
            try:
                value = float(cell)
            except ValueError:
                value = math.nan
            if not math.isfinite(value):
                raise DatasetError(f"{path}: line {number}: {name} is {cell!r}; valid: a finite number")
            row.append(value)
        yield row


def _arm_motions(columns: Mapping[str, Array], rig: RigConfig, path: Path) -> tuple[ArmMotion, ...]:
    columns = {_normalized_column_name(name, motion_sides(rig)): values for name, values in columns.items()}
    motions = []
    for side, k in zip(motion_sides(rig), rig.recording_order, strict=True):
        joints = rig.arms[k].robot.joint_names
        measured = _stack_joint_values(columns, _POSITION, side, joints, path)
        if measured is None:
            raise DatasetError(
                f"{path}: has no column {_column_name(_POSITION, side, joints[0])!r}; its columns are "
                f"{', '.join(columns)}; rig {rig.name!r} needs {', '.join(csv_columns(rig))}"
            )
        motions.append(
            ArmMotion(
                side,
                measured,
                _stack_joint_values(columns, _COMMAND, side, joints, path),
                columns.get(_column_name(_POSITION, side, _GRIPPER_COLUMN)),
                columns.get(_column_name(_COMMAND, side, _GRIPPER_COLUMN)),
                _stack_joint_values(columns, _VELOCITY, side, joints, path),
            )
        )
    return tuple(motions)


def _column_name(kind: str, side: str, joint: str) -> str:
    return "_".join(part for part in (kind, side, joint) if part)


def _normalized_column_name(name: str, arms: Sequence[str]) -> str:
    """Return `left_command_joint1` as `command_left_joint1`; other names stay."""
    side, _, rest = name.partition("_")
    kind, _, joint = rest.partition("_")
    return _column_name(kind, side, joint) if side in arms and kind in (_COMMAND, _POSITION, _VELOCITY) else name


def _stack_joint_values(
    columns: Mapping[str, Array], kind: str, side: str, joints: Sequence[str], path: Path
) -> Array | None:
    names = [_column_name(kind, side, joint) for joint in joints]
    missing = [name for name in names if name not in columns]
    if len(missing) == len(names):
        return None
    if missing:
        raise DatasetError(f"{path}: has no column {missing[0]!r}, but has others of its kind; give all of {names}")
    return np.column_stack([columns[name] for name in names])
