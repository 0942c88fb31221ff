"""The folder of fetched meshes, which are verified against the lock whenever they are used."""

from __future__ import annotations

import contextlib
import shutil
import uuid
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from ..errors import ResourceError
from ..files import exclusive_lock, publish_directory, sha256_bytes, sha256_file
from .lock import AssetSet, LockedFile


class MismatchError(ResourceError):
    """Files that are not the locked ones, byte for byte."""


class FileStatus(StrEnum):
    """The state of a locked file on the disk."""

    OK = "ok"
    MISSING = "missing"
    CHANGED = "changed"


@dataclass(frozen=True)
class FileState:
    """One locked file on the disk; for a missing one, the path is where it should be."""

    name: str
    path: Path
    status: FileStatus


def check_file(path: Path, locked: LockedFile) -> FileStatus:
    """A file's state, compared with its lock entry. Only a regular file of the locked size is ever opened."""
    try:
        if not path.is_file():
            return FileStatus.CHANGED if path.exists() else FileStatus.MISSING
        # The size is compared first: that settles most cases without reading, and no huge wrong file is hashed.
        same = path.stat().st_size == locked.size and sha256_file(path) == locked.sha256
    except FileNotFoundError:  # deleted meanwhile
        return FileStatus.MISSING
    except OSError:  # a file that cannot be read cannot be verified
        return FileStatus.CHANGED
    return FileStatus.OK if same else FileStatus.CHANGED


@dataclass(frozen=True)
class AssetStore:
    """A folder of verified meshes. Reading needs no lock and no write permission, and never the network.

    A set lies in `<root>/<set>-<digest>/`, as `fetch` publishes it, or where a user put it by hand: in `<root>/<set>/`
    or straight in `<root>/`.
    """

    root: Path

    def directory(self, assets: AssetSet) -> Path:
        """Where the set is published."""
        return self.root / assets.directory_name

    @property
    def failure_mark(self) -> Path:
        """The file whose time tells when fetching at first use failed last."""
        return self.root / ".fetch-failed"

    def resolve(self, assets: AssetSet) -> Path | None:
        """The folder that holds every file of the set, each verified by SHA-256; None when there is none."""
        for folder in self._folders(assets):
            if all(check_file(folder / name, locked) is FileStatus.OK for name, locked in assets.files.items()):
                return folder
        return None

    def status(self, assets: AssetSet) -> tuple[FileState, ...]:
        """The state of each file, in the lock's order, in the folder where most of the set is good."""
        files = assets.files.items()
        states = [
            tuple(FileState(name, folder / name, check_file(folder / name, locked)) for name, locked in files)
            for folder in self._folders(assets)
        ]
        # A folder with changed files is likelier to be meant than one without any; among equals, `max` takes the first.
        return max(states, key=lambda files: (_count(files, FileStatus.OK), _count(files, FileStatus.CHANGED)))

    @contextlib.contextmanager
    def writing(self) -> Iterator[Path]:
        """A scratch folder inside the store, which is held for writing in the block; another process waits for it.

        Raises:
            OSError: the store cannot be written to.
        """
        self.root.mkdir(parents=True, exist_ok=True)
        with exclusive_lock(self.root / ".lock"):
            # This process is the only writer now, so whatever lies here was left by one that was killed.
            shutil.rmtree(self._staging, ignore_errors=True)
            self._staging.mkdir()
            try:
                yield self._staging
            finally:
                shutil.rmtree(self._staging, ignore_errors=True)

    def publish(self, assets: AssetSet, files: Mapping[str, bytes], notice: str) -> Path:
        """The set's folder, made in one step with the set's notice in it; to be called within `writing`.

        Raises:
            MismatchError: a file is missing or is not the locked one; nothing was published.
            OSError: the disk failed; nothing was published.
        """
        wrong = [name for name, file in assets.files.items() if sha256_bytes(files.get(name, b"")) != file.sha256]
        if wrong:
            raise MismatchError(f"not the locked content: {', '.join(wrong)}")
        final = self.directory(assets)
        if final.exists():
            # Only reached when the folder failed verification: a damaged set is moved away, never patched.
            final.rename(self._staging / f"damaged.{uuid.uuid4().hex}")
        content = {name: files[name] for name in assets.files} | {assets.notice: notice.encode()}
        publish_directory(final, content, self._staging)
        return final

    @property
    def _staging(self) -> Path:
        return self.root / ".staging"

    def _folders(self, assets: AssetSet) -> tuple[Path, Path, Path]:
        return self.directory(assets), self.root / assets.name, self.root


def _count(files: tuple[FileState, ...], status: FileStatus) -> int:
    return sum(file.status is status for file in files)
