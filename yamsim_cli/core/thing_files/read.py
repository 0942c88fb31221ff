"""Read a thing's file: in a child process, within limits, and brought to metres with z up."""

from __future__ import annotations

import json
import stat
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from ..assets.child import python_call, run_child
from ..assets.sources import SourceError
from ..errors import ResourceError, UsageError
from ..files import scratch_directory
from ..geometry.se3 import Array
from ..untrusted.jail import MOST_BYTES
from ..untrusted.refusals import RefusedError
from .child import REFUSED
from .endings import ENDINGS
from .exchange import read_written
from .parts import Part, ReadThing

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}

# What a hand of this size can have to do with, m: from a crumb to a cabinet.
_LARGEST, _SMALLEST = 2.0, 0.003
# What is likely meant, m: things that are made for tables.
_LIKELY = (0.01, 0.8)

# How long reading may take, s of a core: at least, and for each megabyte; and how many times that on a busy machine.
_SECONDS, _SECONDS_A_MB = 15.0, 0.7
_BUSY = 4.0

# Packages of the extra that readers need.
_NEEDED = ("trimesh", "PIL", "defusedxml", "collada")
# Binary STL needs none of them.
_PLAIN = ".stl"


@dataclass(frozen=True)
class Told:
    """What a user says of a file, where it does not say so itself, or over what it says.

    Attributes:
        unit: one of `UNITS`.
        up: which of its axes is up: x, y or z.
        scale: what all lengths are multiplied by on top.
    """

    unit: str | None = None
    up: str | None = None
    scale: float = 1.0


def read_thing(path: Path, told: Told) -> ReadThing:
    """A thing in metres, z up, its base where the file has it.

    Raises:
        UsageError: the file does not say its unit or which way is up, and the user does not either.
        ResourceError: the file is refused, with one of `untrusted.refusals.CODES`; or the extra is not installed.
    """
    try:
        return _in_metres(read_as_is(path), told)
    except RefusedError as error:
        kind = UsageError if error.code in ("unit", "up", "size") else ResourceError
        raise kind(f"{path}: {error} [{error.code}]") from error


def read_as_is(path: Path) -> ReadThing:
    """A thing in its file's unit and with its file's axes.

    Raises:
        RefusedError, ResourceError: see `read_thing`.
    """
    missing = [name for name in _NEEDED if find_spec(name) is None]
    if missing and path.suffix.lower() != _PLAIN:
        raise ResourceError(f"reading {path.name} needs {' and '.join(missing)}: pip install 'yamsim[import]'")
    if path.suffix.lower() not in ENDINGS:
        raise RefusedError("unknown-kind", f"what ends in {path.suffix!r} is not read; valid: {', '.join(ENDINGS)}")
    try:
        status = path.stat()
    except OSError as error:
        raise RefusedError("missing", f"it cannot be read: {error.strerror}") from error
    if not stat.S_ISREG(status.st_mode):
        raise RefusedError("not-a-file", "it is no regular file")
    if status.st_size > MOST_BYTES:
        raise RefusedError("too-large", f"it has {status.st_size / 1e6:.0f} MB; at most {MOST_BYTES // 10**6}")
    seconds = _SECONDS + _SECONDS_A_MB * status.st_size / 1e6
    with scratch_directory("yamsim-read-") as scratch:
        return _read_in_child(path.resolve(), scratch, seconds)


def _read_in_child(path: Path, scratch: Path, seconds: float) -> ReadThing:
    out = scratch / "out"
    out.mkdir()
    call = python_call("core.thing_files.child.main", str(path), str(path.parent), str(out), int(np.ceil(seconds)))
    # One thread: each would reserve memory of its own.
    quiet = ["env", "OPENBLAS_NUM_THREADS=1", "OMP_NUM_THREADS=1", "MUJOCO_GL=off"]
    limit = _BUSY * seconds
    try:
        result = run_child([*quiet, *call], scratch, limit_s=limit, idle_s=limit)
    except SourceError as error:
        raise RefusedError("too-slow", f"reading it is {error}: reduce it first") from error
    if (out / REFUSED).is_file():
        said = json.loads((out / REFUSED).read_bytes())
        raise RefusedError(said["code"], said["text"])
    if result.returncode == 0:
        try:
            return read_written(out)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise RefusedError("crashed", f"what was read of it is not whole ({error})") from error
    last = (result.stderr.strip().splitlines() or ["no word"])[-1]
    if "MemoryError" in last or "Cannot allocate" in result.stderr or "bad_alloc" in result.stderr:
        raise RefusedError("too-much-memory", "it would take more memory than its size deserves")
    if result.returncode in (-24, -9):
        raise RefusedError("too-slow", f"reading it takes more than {seconds:.0f} s of a core: reduce it first")
    raise RefusedError("crashed", f"the reader broke down over it ({result.returncode}: {last[:160]})")


def _in_metres(thing: ReadThing, told: Told) -> ReadThing:
    size = _extent(thing)
    no_up = told.up is None and thing.up is None
    if told.unit is None and thing.unit_m is None:
        sizes = {unit: size * metre * told.scale for unit, metre in UNITS.items()}
        likely = [unit for unit, lengths in sizes.items() if _LIKELY[0] <= lengths.max() <= _LIKELY[1]]
        shown = " or ".join(f"--unit {unit} ({_spelt(sizes[unit])})" for unit in likely or UNITS)
        also = ", and --up z, y or x" if no_up else ""
        raise RefusedError("unit", f"it does not say its unit: give {shown}{also}")
    if no_up:
        raise RefusedError("up", "it does not say which way is up: give --up z, --up y or --up x")
    metre = (UNITS[told.unit] if told.unit else thing.unit_m or 1.0) * told.scale
    _check_size(size * metre, told)
    return _brought(thing, metre, _upright(told.up or thing.up or "z"))


def _check_size(size: Array, told: Told) -> None:
    longest = float(size.max())
    if _SMALLEST <= longest <= _LARGEST:
        return
    bare = longest / (UNITS[told.unit] if told.unit else 1.0)
    mends = {f"--unit {unit}": bare * metre for unit, metre in UNITS.items()}
    fitting = [
        f"{flag} makes it {length:.3g} m long" for flag, length in mends.items() if _LIKELY[0] <= length <= _LIKELY[1]
    ]
    mend = "; ".join(fitting) or "give --scale"
    raise RefusedError(
        "size", f"it would be {_spelt(size)} large, and a thing is {_SMALLEST * 1000:g} mm to {_LARGEST:g} m: {mend}"
    )


def _spelt(size: Array) -> str:
    return " x ".join(f"{length:.3g}" for length in size) + " m"


def _extent(thing: ReadThing) -> Array:
    corners = []
    poses: list[Array] = []
    for part in thing.parts:
        T = part.T_in_parent if part.parent is None else poses[part.parent] @ part.T_in_parent
        poses.append(T)
        corners += [surface.moved(T).vertices for surface in part.looks]
    if not corners:
        raise RefusedError("empty", "nothing of it can be seen")
    points = np.concatenate(corners)
    extent: Array = points.max(axis=0) - points.min(axis=0)
    return extent


def _upright(up: str) -> Array:
    """The rotation (3, 3) that makes an axis z."""
    if up == "y":
        return np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    if up == "x":
        return np.array([[0, 0, -1.0], [0, 1, 0], [1, 0, 0]])
    return np.eye(3)


def _brought(thing: ReadThing, metre: float, turn: Array) -> ReadThing:
    """All lengths scaled; and the base turned, its own frame with it."""
    if metre == 1.0 and np.array_equal(turn, np.eye(3)):
        return thing
    map_ = np.eye(4)
    map_[:3, :3] = metre * turn
    if len(thing.parts) > 1 or thing.parts[0].shapes or thing.parts[0].weight:
        if metre != 1.0:
            raise RefusedError("size", "a description says its own lengths: --unit and --scale are for mesh files")
        return replace(thing, parts=(_turned(thing.parts[0], turn), *(_hung(part, turn) for part in thing.parts[1:])))
    base = thing.parts[0]
    looks = tuple(surface.moved(map_) for surface in base.looks)
    return replace(thing, parts=(replace(base, looks=looks),), unit_m=1.0, up="z")


def _turned(base: Part, turn: Array) -> Part:
    from .tree import moved_shape, moved_weight

    T = np.eye(4)
    T[:3, :3] = turn
    return replace(
        base,
        looks=tuple(surface.moved(T) for surface in base.looks),
        shapes=None if base.shapes is None else tuple(moved_shape(shape, T) for shape in base.shapes),
        weight=None if base.weight is None else moved_weight(base.weight, T),
    )


def _hung(part: Part, turn: Array) -> Part:
    if part.parent != 0:
        return part
    T = np.eye(4)
    T[:3, :3] = turn
    return replace(part, T_in_parent=T @ part.T_in_parent)
