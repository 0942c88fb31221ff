"""Import an object file: store its meshes as a set named by their hash, and write its config."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from pydantic import ValidationError

from yamsim_cli.core.config.objects.object_config import ObjectConfig
from yamsim_cli.core.errors import ResourceError, UsageError
from yamsim_cli.core.expert.skills.planning_context import SkillFailedError
from yamsim_cli.core.files.documents.yaml_document import dump_yaml
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.files.writing import sha256_bytes, sha256_file, write_file
from yamsim_cli.core.scene.assets import AssetStore, publish_user_set
from yamsim_cli.objects.certify.single_object_pick import reachable_grasp_points

from ..building import BuiltObject, ImportOptions, build_object
from ..convex_decomposition import DECOMPOSITION_FOLDER, ShareCallback
from ..readers.object_reader import UnitOptions, read_object

_IMPORTED_CONFIG_FOLDER = "imports"  # folder of `import_with_defaults`'s configs, in the mesh folder


@dataclass(frozen=True)
class ImportedObjectFile:
    """The written config, its path, and the object with its mesh files."""

    path: Path
    config: ObjectConfig
    built_object: BuiltObject


def object_name_of(path: Path) -> str:
    """Return the object's name: the file's, or the folder's if that is generic, such as `model`."""
    stem = path.parent.name if path.stem.lower() in ("model", "mesh", "scene", "object", "textured") else path.stem
    name = re.sub(r"\W+", "_", stem, flags=re.ASCII).strip("_") or "thing"
    return name if name[0].isalpha() else f"thing_{name}"


def import_file(
    file: Path,
    units: UnitOptions,
    options: ImportOptions,
    locations: Locations,
    out: Path | None,
    share: ShareCallback = lambda done: None,
) -> ImportedObjectFile:
    """Import an object file (mesh, SDF, URDF or MJCF) to `out`, by default `<name>.yaml` in the user's config folder.

    Raises:
        UsageError: the name is invalid, the config file exists, or its folder, the unit or the up axis is unknown.
        ResourceError: the file is refused or does not allow a valid config, or a file cannot be written.
    """
    if not re.fullmatch("[A-Za-z][A-Za-z0-9_]*", options.name):
        raise UsageError(f"--name {options.name!r} is not valid; valid: a letter, then letters, digits and underscores")
    path = config_path(locations, options.name, out)
    config, made, yaml = _build_and_publish(file, units, options, locations, share)
    write_config(path, yaml)
    return ImportedObjectFile(path, config, made)


def import_with_defaults(file: Path, locations: Locations) -> ImportedObjectFile:
    """Import a file by default options, its config beside the meshes. Raises `UsageError` or `ResourceError`."""
    options = ImportOptions(object_name_of(file))
    config, made, yaml = _build_and_publish(file, UnitOptions(), options, locations, lambda done: None)
    path = locations.assets / _IMPORTED_CONFIG_FOLDER / f"{config.name}-{sha256_bytes(yaml.encode())[:12]}.yaml"
    if not path.exists():
        write_config(path, yaml)
    return ImportedObjectFile(path, config, made)


def config_path(locations: Locations, name: str, out: Path | None) -> Path:
    """Return `out`, or by default `<name>.yaml` in the user's config folder.

    Raises:
        UsageError: the user has no config folder, or the file exists.
    """
    if out is None and len(locations.data) < 2:
        raise UsageError("no folder for configs of your own: set YAMSIM_DATA_DIR, or give --out FILE.yaml")
    path = out or locations.data[0] / "configs" / "objects" / f"{name}.yaml"
    if path.exists():
        raise UsageError(f"{path} exists; move it away, or choose another --out")
    return path


def write_config(path: Path, yaml: str) -> None:
    """Write a config file, and make its folder. Raises `ResourceError`."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file(path, yaml.encode())
    except OSError as error:
        raise ResourceError(f"{path} cannot be written: {error.strerror}") from error


def _build_and_publish(
    file: Path, units: UnitOptions, options: ImportOptions, locations: Locations, share: ShareCallback
) -> tuple[ObjectConfig, BuiltObject, str]:
    if file.suffix.lower() == ".stl":
        # STL states neither; most robot files are in metres, z up.
        units = replace(units, unit=units.unit or "m", up=units.up or "z")
    made = build_object(read_object(file, units), options, locations.assets / DECOMPOSITION_FOLDER, share)
    sha256 = sha256_file(file)
    about = {"source": file.name, "sha256": sha256, "told": asdict(units), "wishes": asdict(options)}
    store = AssetStore(locations.assets)
    set_name = publish_user_set(store, options.name, made.files, about)
    data = made.config_with_mesh_set(set_name)
    try:
        config = ObjectConfig.model_validate(data)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"])
        raise ResourceError(
            f"{file}: no config can be made of it: {place}: {first['msg']}, found {first['input']!r:.60}"
        ) from error
    config = _with_reachable_grasps(config, replace(locations, meshes={set_name: store.root / set_name}))
    if config.grasp is not None:
        data["grasp"] = config.grasp.model_dump(mode="json", exclude_unset=True, exclude_none=True)
    return config, made, _config_comment(file, made, units, sha256) + dump_yaml(data)


def _with_reachable_grasps(config: ObjectConfig, locations: Locations) -> ObjectConfig:
    """Keep only grasp points that `pick` can use; without any, all stay, and the certificate reports it."""
    with suppress(SkillFailedError):
        if places := reachable_grasp_points(config, locations):
            return config.with_grasp_points(places)
    return config


def _config_comment(file: Path, made: BuiltObject, units: UnitOptions, sha256: str) -> str:
    kinds = ", ".join(dict.fromkeys(geometry.kind for geometry in made.collision))
    guess = " (a guess: neither mass nor density was given)" if made.mass_is_guessed else ""
    given = [(key, value) for key, value in asdict(units).items() if value is not None and value != 1.0]
    flags = "".join(f" --{key} {value:g}" if key == "scale" else f" --{key} {value}" for key, value in given)
    return (
        f"# {file.name}, SHA-256 {sha256}. Written by `yamsim assets import {file.name}{flags}`.\n"
        f"# It collides by {kinds} and weighs {made.mass * 1000:.4g} g{guess}.\n"
    )
