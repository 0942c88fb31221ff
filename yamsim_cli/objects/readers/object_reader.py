"""Read an object file in a child process, and convert it to metres with z up."""

from __future__ import annotations

import json
import stat
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from yamsim_cli.core.errors import ResourceError, UsageError
from yamsim_cli.core.files.untrusted.confined_folder import MAX_BYTES
from yamsim_cli.core.files.untrusted.refusals import RefusedError
from yamsim_cli.core.files.writing import scratch_directory
from yamsim_cli.core.geometry.se3 import Array, pose
from yamsim_cli.core.scene.assets.child_process import python_call_command, run_child
from yamsim_cli.core.scene.assets.sources import SourceError

from . import OBJECT_SUFFIXES, reader_process
from .object_parts import ObjectDescription
from .reader_process import REFUSAL_FILE, read_written_object

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}  # unit -> m

_MAX_SIZE, _MIN_SIZE = 2.0, 0.003  # m, of objects that an arm can handle
_PLAUSIBLE_SIZES = (0.01, 0.8)  # m; the error for a missing unit suggests units that give these sizes
_CPU_SECONDS, _CPU_SECONDS_PER_MB = 15.0, 0.7  # s of CPU time, and per megabyte of the file
_WALL_CLOCK_FACTOR = 4.0  # elapsed over CPU time, for a busy machine
_IMPORT_EXTRA_PACKAGES = ("trimesh", "PIL", "defusedxml", "collada")  # of the extra `import`; binary STL needs none


@dataclass(frozen=True)
class UnitOptions:
    """A file's unit (a key of `UNITS`), up axis (x, y or z) and scale, each of which overrides the file."""

    unit: str | None = None
    up: str | None = None
    scale: float = 1.0


def read_object(path: Path, units: UnitOptions) -> ObjectDescription:
    """Return the object in a file, in metres, z up.

    Raises:
        UsageError: unit or up axis are unknown, or the size is implausible.
        ResourceError: the file is refused, with one of `untrusted.refusals.CODES`; or the extra is not installed.
    """
    try:
        return convert_to_metres(_read_in_file_units(path), units)
    except RefusedError as error:
        kind = UsageError if error.code in ("unit", "up", "size") else ResourceError
        raise kind(f"{path}: {error} [{error.code}]") from error


def _read_in_file_units(path: Path) -> ObjectDescription:
    missing = [name for name in _IMPORT_EXTRA_PACKAGES if find_spec(name) is None]
    if missing and path.suffix.lower() != ".stl":
        raise ResourceError(f"reading {path.name} needs {' and '.join(missing)}: pip install 'yamsim[import]'")
    if path.suffix.lower() not in OBJECT_SUFFIXES:
        raise RefusedError(
            "unknown-kind",
            f"files with the suffix {path.suffix!r} are not supported; valid: {', '.join(OBJECT_SUFFIXES)}",
        )
    try:
        status = path.stat()
    except OSError as error:
        raise RefusedError("missing", f"it cannot be read: {error.strerror}") from error
    if not stat.S_ISREG(status.st_mode):
        raise RefusedError("not-a-file", "it is not a regular file")
    if status.st_size > MAX_BYTES:
        raise RefusedError("too-large", f"it has {status.st_size / 1e6:.0f} MB; at most {MAX_BYTES // 10**6}")
    seconds = _CPU_SECONDS + _CPU_SECONDS_PER_MB * status.st_size / 1e6
    with scratch_directory("yamsim-read-") as scratch:
        return _read_in_child(path.resolve(), scratch, seconds)


def _read_in_child(path: Path, scratch: Path, seconds: float) -> ObjectDescription:
    out = scratch / "out"
    out.mkdir()
    call = python_call_command(reader_process.main, str(path), str(path.parent), str(out), int(np.ceil(seconds)))
    # Each thread would reserve memory.
    quiet = ["env", "OPENBLAS_NUM_THREADS=1", "OMP_NUM_THREADS=1", "MUJOCO_GL=off"]
    limit = _WALL_CLOCK_FACTOR * seconds
    try:
        result = run_child([*quiet, *call], scratch, limit_s=limit, idle_s=limit)
    except SourceError as error:
        raise RefusedError("too-slow", f"reading it is {error}: reduce it first") from error
    if (out / REFUSAL_FILE).is_file():
        refusal = json.loads((out / REFUSAL_FILE).read_bytes())
        raise RefusedError(refusal["code"], refusal["text"])
    if result.returncode == 0:
        try:
            return read_written_object(out)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise RefusedError("crashed", f"the reader's result is incomplete ({error})") from error
    last = (result.stderr.strip().splitlines() or ["no message"])[-1]
    if "MemoryError" in last or "Cannot allocate" in result.stderr or "bad_alloc" in result.stderr:
        raise RefusedError("too-much-memory", "reading it takes too much memory for a file of its size")
    if result.returncode in (-24, -9):
        raise RefusedError("too-slow", f"reading it takes more than {seconds:.0f} s of CPU time: reduce it first")
    raise RefusedError("crashed", f"the reader crashed on it ({result.returncode}: {last[:160]})")


def convert_to_metres(thing: ObjectDescription, units: UnitOptions) -> ObjectDescription:
    """Convert to metres, z up. Raises `RefusedError` for an unknown unit or up axis, or an absurd size."""
    size = _object_extent(thing)
    no_up = units.up is None and thing.up is None
    if units.unit is None and thing.unit_m is None:
        sizes = {unit: size * metre * units.scale for unit, metre in UNITS.items()}
        likely = [
            unit for unit, lengths in sizes.items() if _PLAUSIBLE_SIZES[0] <= lengths.max() <= _PLAUSIBLE_SIZES[1]
        ]
        shown = " or ".join(f"--unit {unit} ({_format_size(sizes[unit])})" for unit in likely or UNITS)
        also = ", and --up z, y or x" if no_up else ""
        raise RefusedError("unit", f"it does not state its unit: add {shown}{also}")
    if no_up:
        raise RefusedError("up", "it does not state its up axis: add --up z, --up y or --up x")
    metre = (UNITS[units.unit] if units.unit else thing.unit_m or 1.0) * units.scale
    _check_size(size * metre, units)
    return _convert_units(thing, metre, _rotation_to_z(units.up or thing.up or "z"))


def _check_size(size: Array, units: UnitOptions) -> None:
    longest = float(size.max())
    if _MIN_SIZE <= longest <= _MAX_SIZE:
        return
    bare = longest / (UNITS[units.unit] if units.unit else 1.0)
    mends = {f"--unit {unit}": bare * metre for unit, metre in UNITS.items()}
    fitting = [
        f"{flag} makes it {length:.3g} m long"
        for flag, length in mends.items()
        if _PLAUSIBLE_SIZES[0] <= length <= _PLAUSIBLE_SIZES[1]
    ]
    mend = "; ".join(fitting) or "give --scale"
    raise RefusedError(
        "size",
        f"it would be {_format_size(size)} large; valid for the longest side: "
        f"{_MIN_SIZE * 1000:g} mm to {_MAX_SIZE:g} m; {mend}",
    )


def _format_size(size: Array) -> str:
    return " x ".join(f"{length:.3g}" for length in size) + " m"


def _object_extent(thing: ObjectDescription) -> Array:
    poses = zip(thing.parts, thing.part_poses(), strict=True)
    corners = [surface.transform(T).vertices for part, T in poses for surface in part.looks]
    if not corners:
        raise RefusedError("empty", "it has no visible surface")
    points = np.concatenate(corners)
    extent: Array = points.max(axis=0) - points.min(axis=0)
    return extent


def _rotation_to_z(up: str) -> Array:
    if up == "y":
        return np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    if up == "x":
        return np.array([[0, 0, -1.0], [0, 1, 0], [1, 0, 0]])
    return np.eye(3)


def _convert_units(thing: ObjectDescription, metre: float, turn: Array) -> ObjectDescription:
    if metre == 1.0 and np.array_equal(turn, np.eye(3)):
        return thing
    base, *others = thing.parts
    if not others and not base.shapes and not base.weight and not base.handles:
        looks = tuple(surface.transform(pose(rotation=metre * turn)) for surface in base.looks)
        return replace(thing, parts=(replace(base, looks=looks),), unit_m=1.0, up="z")
    if metre != 1.0:
        raise RefusedError("size", "a description is in metres: --unit and --scale are for mesh files only")
    from .kinematic_tree import transform_handle, transform_mass_properties, transform_shape

    T = pose(rotation=turn)
    turned = replace(
        base,
        looks=tuple(surface.transform(T) for surface in base.looks),
        shapes=None if base.shapes is None else tuple(transform_shape(shape, T) for shape in base.shapes),
        weight=None if base.weight is None else transform_mass_properties(base.weight, T),
        handles=tuple(transform_handle(handle, T) for handle in base.handles),
    )
    hung = (replace(part, T_in_parent=T @ part.T_in_parent) if part.parent == 0 else part for part in others)
    return replace(thing, parts=(turned, *hung))
