"""Make an object's config from a file of a thing: read, made, its files kept by content, its config written."""

from __future__ import annotations

import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from ..assets import AssetStore, publish_own
from ..attempt.alone import reachable_places
from ..config.things.thing import ObjectConfig
from ..documents.document import dump_yaml
from ..errors import ResourceError
from ..files import sha256_bytes, sha256_file
from ..resources import Locations
from ..skills.errors import SkillFailedError
from ..thing_files.read import Told, read_thing
from ..things.convex import KEPT, Share
from ..things.make import Made, make
from ..things.wishes import Wishes
from .written import checked_name, own_config, put, refuse_existing

# Configs of things that were named by their file, where a config's name belongs.
_DIRECT = "imports"


@dataclass(frozen=True)
class ImportedFile:
    """A config that was written, and what it was made of."""

    path: Path
    config: ObjectConfig
    made: Made


def name_of(path: Path) -> str:
    """What a thing is called after its file; after its folder where the file's name says only what it is."""
    stem = path.parent.name if path.stem.lower() in ("model", "mesh", "scene", "object", "textured") else path.stem
    name = re.sub(r"\W+", "_", stem, flags=re.ASCII).strip("_") or "thing"
    return name if name[0].isalpha() else f"thing_{name}"


def import_file(
    file: Path, told: Told, wishes: Wishes, where: Locations, out: Path | None, share: Share = lambda done: None
) -> ImportedFile:
    """Of a file in one of the formats of `core.thing_files.read`.

    Args:
        out: the YAML file to write; by default `<name>.yaml` in the user's own configs.
        share: told how much of the work is done, 0 to 1.

    Raises:
        UsageError: the name is none, or there is no place to write to, or the file leaves open what has to be told.
        ResourceError: the file is refused, or no config can be made of it, or something cannot be written.
    """
    checked_name(wishes.name)
    path = out or own_config(where, wishes.name)
    refuse_existing(path)
    config, made, yaml = _imported(file, told, wishes, where, share)
    put(path, yaml.encode())
    return ImportedFile(path, config, made)


def import_directly(file: Path, where: Locations, share: Share = lambda done: None) -> ImportedFile:
    """Of a file that is named where a config belongs, with what the file says alone; its config lies with the meshes.

    Raises:
        UsageError, ResourceError: as `import_file`.
    """
    config, made, yaml = _imported(file, Told(), Wishes(name_of(file)), where, share)
    path = where.assets / _DIRECT / f"{config.name}-{sha256_bytes(yaml.encode())[:12]}.yaml"
    if not path.exists():
        put(path, yaml.encode())
    return ImportedFile(path, config, made)


def _imported(file: Path, told: Told, wishes: Wishes, where: Locations, share: Share) -> tuple[ObjectConfig, Made, str]:
    if file.suffix.lower() == ".stl":
        # As STL is mostly written for robots; nothing in it says so.
        told = replace(told, unit=told.unit or "m", up=told.up or "z")
    made = make(read_thing(file, told), wishes, where.assets / KEPT, share)
    about = {
        "source": file.name,
        "sha256": sha256_file(file),
        "told": asdict(told),
        "wishes": asdict(wishes),
    }
    store = AssetStore(where.assets)
    set_name = publish_own(store, wishes.name, made.files, about)
    data = made.with_set(set_name)
    try:
        config = ObjectConfig.model_validate(data)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise ResourceError(
            f"{file}: no config can be made of it: {place}: {first['msg']}, found {first['input']!r:.60}"
        ) from error
    config = _held_in_reach(config, replace(where, meshes={set_name: store.root / set_name}))
    if config.grasp is not None:
        data["grasp"] = config.grasp.model_dump(mode="json", exclude_unset=True)
    return config, made, _comment(file, made, told, about) + dump_yaml(data)


def _held_in_reach(config: ObjectConfig, where: Locations) -> ObjectConfig:
    """The thing with only those proposed places that the skill `pick` can take.

    Where it can take none of them, they stay as they are, and the certificate says what is wrong with them.
    """
    with suppress(SkillFailedError):
        if places := reachable_places(config, where):
            return config.with_places(places)
    return config


def _comment(file: Path, made: Made, told: Told, about: Mapping[str, Any]) -> str:
    kinds = ", ".join(dict.fromkeys(touch.kind for touch in made.touches))
    guess = " (a guess: nobody said)" if made.guessed else ""
    flags = "".join(f" --{key} {value:g}" if key == "scale" else f" --{key} {value}" for key, value in _given(told))
    return (
        f"# {file.name}, SHA-256 {about['sha256']}. Written by `yamsim assets import {file.name}{flags}`.\n"
        f"# It collides by {kinds} and weighs {made.mass * 1000:.4g} g{guess}.\n"
    )


def _given(told: Told) -> list[tuple[str, Any]]:
    return [(key, value) for key, value in asdict(told).items() if value is not None and value != 1.0]
