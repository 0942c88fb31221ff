"""A folder of meshes that are verified at each use.

Besides the sets of the lock, the store has user sets with the files of imported objects. The folder of a user set is
named by a hash of its content, so that a later import under the same name does not change the meshes of a dataset.
"""

from __future__ import annotations

import contextlib
import json
import re
import shutil
import uuid
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from ...errors import ResourceError
from ...files.writing import exclusive_lock, publish_directory, sha256_bytes, sha256_file
from .asset_lock import AssetSet, LockedFile

USER_SET_INFO_FILE = "thing.json"  # beside the meshes of a user set, with their hashes and origin

_NAME = re.compile(r"own-[A-Za-z][A-Za-z0-9_]*-[0-9a-f]{12}")  # of a user set
_FILE = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")  # file name in a user set


class MismatchError(ResourceError):
    """Files differ from the content in the asset lock."""


class FileStatus(StrEnum):
    """The state of a locked file on the disk."""

    OK = "ok"
    MISSING = "missing"
    CHANGED = "changed"


@dataclass(frozen=True)
class FileState:
    """The state of a locked file on the disk. For a missing file, `path` is its expected path."""

    name: str
    path: Path
    status: FileStatus


def check_file(path: Path, locked: LockedFile) -> FileStatus:
    """Compare a file with its lock entry. Only a regular file of the locked size is opened."""
    try:
        if not path.is_file():
            return FileStatus.CHANGED if path.exists() else FileStatus.MISSING
        same = path.stat().st_size == locked.size and sha256_file(path) == locked.sha256
    except FileNotFoundError:  # deleted concurrently
        return FileStatus.MISSING
    except OSError:  # an unreadable file cannot be verified
        return FileStatus.CHANGED
    return FileStatus.OK if same else FileStatus.CHANGED


@dataclass(frozen=True)
class AssetStore:
    """A folder of verified meshes. Reading requires neither write permission nor network.

    `fetch` publishes a set in `<root>/<set>-<digest>/`. Users can copy a set to `<root>/<set>/` or to `<root>/`.
    """

    root: Path

    def folder_of_set(self, assets: AssetSet) -> Path:
        """Return the folder in which the set is published."""
        return self.root / assets.directory_name

    @property
    def fetch_failure_file(self) -> Path:
        """File whose modification time is when `fetch_missing` last failed."""
        return self.root / ".fetch-failed"

    def find_verified_folder(self, assets: AssetSet) -> Path | None:
        """Return the folder with all files of the set, each verified by SHA-256; None if there is no such folder."""
        for folder in self._candidate_folders(assets):
            if all(check_file(folder / name, locked) is FileStatus.OK for name, locked in assets.files.items()):
                return folder
        return None

    def file_states(self, assets: AssetSet) -> tuple[FileState, ...]:
        """Return the state of each file, in the lock's order, in the folder with the most valid files of the set."""
        files = assets.files.items()
        states = [
            tuple(FileState(name, folder / name, check_file(folder / name, locked)) for name, locked in files)
            for folder in self._candidate_folders(assets)
        ]
        # Changed files indicate that the folder is meant for the set. For equal counts, `max` returns the first folder.
        return max(
            states,
            key=lambda files: (
                _count_files_with_status(files, FileStatus.OK),
                _count_files_with_status(files, FileStatus.CHANGED),
            ),
        )

    @contextlib.contextmanager
    def write_lock(self) -> Iterator[Path]:
        """Lock the store for writing, and yield a scratch folder in it. Other processes wait for the lock.

        If the store cannot be written, at the start or within the block, ResourceError is raised.
        """
        try:
            self.root.mkdir(parents=True, exist_ok=True)
            with exclusive_lock(self.root / ".lock"):
                # A killed process can leave files in the scratch folder. No other process uses it during the lock.
                shutil.rmtree(self._staging_directory, ignore_errors=True)
                self._staging_directory.mkdir()
                try:
                    yield self._staging_directory
                finally:
                    shutil.rmtree(self._staging_directory, ignore_errors=True)
        except OSError as error:
            raise ResourceError(
                f"cannot write to the asset store {self.root}: {error.strerror or error}; free some space, or set "
                "YAMSIM_ASSETS to a folder that can be written to"
            ) from error

    def publish(self, assets: AssetSet, files: Mapping[str, bytes], notice: str) -> Path:
        """Write a set's files and license text into the store in one step, and return the folder.

        After MismatchError (a missing or changed file) or OSError, nothing is published.
        """
        wrong = [name for name, file in assets.files.items() if sha256_bytes(files.get(name, b"")) != file.sha256]
        if wrong:
            raise MismatchError(f"not the locked content: {', '.join(wrong)}")
        content = {name: files[name] for name in assets.files} | {assets.notice: notice.encode()}
        return self.publish_folder(assets.directory_name, content)

    def publish_folder(self, name: str, files: Mapping[str, bytes]) -> Path:
        """Write a folder of the store in one step, and return its path. Call within `write_lock`.

        An existing folder of that name has failed verification and is removed. After an OSError, nothing is published.
        """
        final = self.root / name
        if final.exists():
            final.rename(self._staging_directory / f"damaged.{uuid.uuid4().hex}")
        publish_directory(final, files, self._staging_directory)
        return final

    @property
    def _staging_directory(self) -> Path:
        return self.root / ".staging"

    def _candidate_folders(self, assets: AssetSet) -> tuple[Path, Path, Path]:
        return self.folder_of_set(assets), self.root / assets.name, self.root


def _count_files_with_status(files: tuple[FileState, ...], status: FileStatus) -> int:
    return sum(file.status is status for file in files)


def is_user_set(set_name: str) -> bool:
    """Return whether the name belongs to a user set, which is not in the lock."""
    return _NAME.fullmatch(set_name) is not None


def _set_name(thing: str, hashes: Mapping[str, str]) -> str:
    listed = "".join(f"{name} {hashes[name]}\n" for name in sorted(hashes))
    return f"own-{thing}-{sha256_bytes(listed.encode())[:12]}"


def publish_user_set(store: AssetStore, thing: str, files: Mapping[str, bytes], about: Mapping[str, Any]) -> str:
    """Write an imported object's files into the store as a user set in one step, and return the set's name.

    `about` is the object's origin, for humans: the source's name and hash, its unit, and the conversion.
    """
    if wrong := [name for name in files if not _FILE.fullmatch(name) or name == USER_SET_INFO_FILE]:
        raise ValueError(f"no names for a set's files: {wrong}")
    hashes = {file: sha256_bytes(data) for file, data in sorted(files.items())}
    name = _set_name(thing, hashes)
    text = json.dumps({"about": about, "files": hashes}, indent=1) + "\n"
    with store.write_lock():
        if resolve_user_set(store, name) is None:
            store.publish_folder(name, {**files, USER_SET_INFO_FILE: text.encode()})
    return name


def resolve_user_set(store: AssetStore, set_name: str) -> Path | None:
    """Return the folder of a user set, verified by SHA-256; None if a file is missing or changed."""
    if not is_user_set(set_name):
        return None
    folder = store.root / set_name
    try:
        listed = json.loads((folder / USER_SET_INFO_FILE).read_bytes())["files"]
        found = {name: sha256_file(folder / name) for name in listed if _FILE.fullmatch(name)}
    except (OSError, ValueError, KeyError, TypeError):
        return None
    thing = set_name.removeprefix("own-").rpartition("-")[0]
    return folder if len(found) == len(listed) and _set_name(thing, found) == set_name else None
