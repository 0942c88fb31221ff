"""The child process that reads one file within limits, and writes the thing, or why the file is refused."""

from __future__ import annotations

import contextlib
import json
import resource
from pathlib import Path

from ..untrusted.jail import MOST_BYTES, Folder
from ..untrusted.refusals import RefusedError
from .parts import Part, ReadThing

REFUSED = "refused.json"

_BASE_BYTES = 3_000_000_000  # address space of Python and its libraries, mostly only reserved
_FACTOR = 60  # further address space, as a multiple of the file's size
_MOST_MEMORY = 12_000_000_000  # bytes
_MOST_WRITTEN = 2_000_000_000  # bytes of one written file: arrays of the most faces


def main(file: str, root: str, out: str, seconds: int) -> None:
    """Read `file`, which may name others below `root`, and write the thing, or the refusal, into `out`."""
    path = Path(file)
    _limit(path.stat().st_size, seconds)
    try:
        from .exchange import write_thing

        write_thing(_read(path, Path(root)), Path(out))
    except RefusedError as error:
        _refuse(out, error.code, str(error))
    except MemoryError:
        _refuse(out, "too-much-memory", "it would take more memory than its size deserves")
    except RecursionError:
        _refuse(out, "damaged", "it is nested too deeply")


def _limit(size: int, seconds: int) -> None:
    memory = min(_MOST_MEMORY, _BASE_BYTES + _FACTOR * size)
    for kind, limit in (
        (resource.RLIMIT_AS, memory),
        (resource.RLIMIT_CPU, seconds),
        (resource.RLIMIT_FSIZE, _MOST_WRITTEN),
        (resource.RLIMIT_CORE, 0),
    ):
        # A lower limit that is already set stays.
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(kind, (limit, limit))


def _refuse(out: str, code: str, text: str) -> None:
    (Path(out) / REFUSED).write_text(json.dumps({"code": code, "text": text}))


def _read(path: Path, root: Path) -> ReadThing:
    folder, base, suffix = Folder(root), path.parent.resolve(), path.suffix.lower()
    if path.stat().st_size > MOST_BYTES:
        raise RefusedError("too-large", f"it has more than {MOST_BYTES // 10**6} MB")
    data = folder.read(path.name, base)
    if suffix in (".sdf", ".urdf", ".xml", ".mjcf"):
        return _description(data, folder, base)
    import numpy as np

    from .meshes import read_mesh

    mesh = read_mesh(data, suffix, folder, base)
    part = Part("base", None, np.eye(4), looks=mesh.surfaces)
    return ReadThing("", (part,), unit_m=mesh.unit_m, up=mesh.up)


def _description(data: bytes, folder: Folder, base: Path) -> ReadThing:
    """A description by its root element: `.xml` may be any of the formats."""
    from .xml import parse

    match parse(data).tag:
        case "sdf":
            from .sdf import read_sdf

            return read_sdf(data, folder, base)
        case "robot":
            from .urdf import read_urdf

            return read_urdf(data, folder, base)
        case _:
            from .mjcf import read_mjcf

            return read_mjcf(data, folder, base)
