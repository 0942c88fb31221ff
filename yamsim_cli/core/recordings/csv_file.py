"""Motions as CSV: a header, then a row for each sample; s, rad, and m of one finger's opening."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from ..config.rig import RigConfig
from ..errors import DatasetError
from ..geometry.se3 import Array
from ..motion import Motion
from .columns import TIME, arm_motions, header

# A file of three hours at 250 Hz is 0.6 GB; what is larger is no recording of one motion.
_MOST_BYTES = 1 << 30


def read_csv(path: Path, rig: RigConfig) -> Motion:
    """The motion in a CSV.

    Raises:
        DatasetError: it cannot be read, has other columns, or a row that is no sample.
    """
    names, rows = _table(path)
    if TIME not in names:
        raise DatasetError(f"{path}: line 1: has no column {TIME!r}; the header is {','.join(header(rig))}")
    values = np.array(rows, dtype=np.float64).reshape(len(rows), len(names))
    if len(values) < 2:
        raise DatasetError(f"{path}: has {len(values)} samples; a motion needs two at least")
    columns: dict[str, Array] = {name: values[:, k] for k, name in enumerate(names)}
    times = columns.pop(TIME)
    back = np.flatnonzero(np.diff(times) <= 0)
    if len(back):
        line = int(back[0]) + 3
        raise DatasetError(
            f"{path}: line {line}: t is {times[back[0] + 1]:g}, and {times[back[0]]:g} in the line before: times "
            "increase; sort the rows, or take out those that are there twice"
        )
    return Motion(str(path), times - times[0], arm_motions(columns, rig, str(path)))


def csv_bytes(rig: RigConfig, times: Sequence[float] | Array, columns: Array) -> bytes:
    """A CSV of a motion that `read_csv` reads again to the same numbers.

    Args:
        times: of the samples (n,), s.
        columns: (n, m), in the order of `header` after its first.
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(header(rig))
    for time, row in zip(times, columns, strict=True):
        writer.writerow([repr(float(time)), *(repr(float(value)) for value in row)])
    return stream.getvalue().encode()


def _table(path: Path) -> tuple[list[str], list[list[float]]]:
    """The header's names, and the rows below."""
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise DatasetError(f"{path}: has {path.stat().st_size / 1e9:.1f} GB; valid: up to {_MOST_BYTES / 1e9:.1f}")
        with path.open(newline="", encoding="utf-8-sig") as file:
            lines = csv.reader(file)
            names = [name.strip() for name in next(lines, [])]
            if len(set(names)) < len(names):
                twice = next(name for name in names if names.count(name) > 1)
                raise DatasetError(f"{path}: line 1: column {twice!r} is there twice")
            return names, list(_rows(path, names, lines))
    except OSError as error:
        raise DatasetError(f"{path} cannot be read: {error.strerror or error}") from error
    except (UnicodeDecodeError, csv.Error) as error:
        raise DatasetError(f"{path} is no CSV: {error}") from error


def _rows(path: Path, names: Sequence[str], lines: Iterator[list[str]]) -> Iterator[list[float]]:
    for number, cells in enumerate(lines, start=2):
        if not cells:
            continue
        if len(cells) != len(names):
            raise DatasetError(
                f"{path}: line {number}: has {len(cells)} of {len(names)} values: was the recording cut off? "
                "Take the line out"
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
