"""Finds the filesystem of a path in the kernel's mount table.

No file of a network mount is opened: a process that waits for a dead server cannot even be killed.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

_MOUNT_TABLE_FILE = Path("/proc/self/mountinfo")

# Filesystems with files on another machine. Every `fuse.*` also counts, except those in `_LOCAL_FUSE_FILESYSTEMS`.
_NETWORK_FILESYSTEMS = re.compile(
    "9p|afs|autofs|beegfs|ceph|cifs|coda|davfs|fuse|gfs2|glusterfs|gpfs|lustre|ncpfs|nfs|nfs4|ocfs2|orangefs|prl_fs|"
    "pvfs2|smb3|smbfs|vboxsf|wekafs"
)
_LOCAL_FUSE_FILESYSTEMS = re.compile(r"fuse\.(fuse-overlayfs|lxcfs|portal|snapfuse|squashfuse)")
# Filesystems whose locks (flock) reach other machines. Source: flock(2) for NFS and CIFS; the others' manuals.
_NETWORK_LOCK_FILESYSTEMS = re.compile(r"ceph|cifs|gfs2|glusterfs|fuse\.glusterfs|gpfs|nfs|nfs4|ocfs2|smb3")
_LOCAL_LOCK_OPTIONS = frozenset(["nolock", "local_lock=all", "local_lock=flock", "nobrl", "localflock"])

_MAX_LINKS = 40  # symbolic links in a path; more are a loop. Source: the kernel's limit, path_resolution(7)


@dataclass(frozen=True)
class Mount:
    """One line of the mount table.

    Attributes:
        kind: such as `ext4` or `fuse.sshfs`.
        source: the mounted device or export, such as `server:/export`.
        options: of the mount and of the filesystem.
    """

    mount_id: int
    parent_id: int
    point: PurePosixPath
    kind: str
    source: str
    options: frozenset[str]

    @property
    def is_network(self) -> bool:
        """Whether the files are, or may be, on another machine. For FUSE and automounters, this is unknown."""
        return bool(_NETWORK_FILESYSTEMS.fullmatch(self.kind)) or (
            self.kind.startswith("fuse.") and not _LOCAL_FUSE_FILESYSTEMS.fullmatch(self.kind)
        )

    @property
    def locks_reach_others(self) -> bool:
        """Whether other machines that can write to the filesystem see a lock of this machine."""
        if not self.is_network:
            return True
        return bool(_NETWORK_LOCK_FILESYSTEMS.fullmatch(self.kind)) and not self.options & _LOCAL_LOCK_OPTIONS


def read_mounts() -> list[Mount]:
    """Return the current mount table; empty on systems without one, such as macOS."""
    try:
        return parse_mounts(_MOUNT_TABLE_FILE.read_text(errors="surrogateescape"))
    except OSError:
        return []


def parse_mounts(text: str) -> list[Mount]:
    """Return the mounts of a table in the format of `/proc/self/mountinfo`. Source: proc(5)."""
    mounts = []
    for line in text.splitlines():
        before, dash, after = line.partition(" - ")
        fields, rest = before.split(" "), after.split(" ")
        if dash and len(fields) >= 6 and len(rest) >= 3:
            options = frozenset([*fields[5].split(","), *rest[2].split(",")])
            point = PurePosixPath(_unescape_octal(fields[4]))
            mounts.append(Mount(int(fields[0]), int(fields[1]), point, rest[0], _unescape_octal(rest[1]), options))
    return mounts


def mount_at(path: PurePosixPath, mounts: Sequence[Mount]) -> Mount | None:
    """Return the mount that contains an absolute path without symbolic links.

    The search goes down from the root, which excludes mounts that later mounts cover.
    """
    numbers = {mount.mount_id for mount in mounts}
    current = next(
        (mount for mount in mounts if mount.parent_id not in numbers or mount.parent_id == mount.mount_id), None
    )
    while current is not None:
        below = [
            mount
            for mount in mounts
            if mount.parent_id == current.mount_id and mount is not current and path.is_relative_to(mount.point)
        ]
        if not below:
            return current
        current = min(below, key=lambda mount: len(mount.point.parts))
    return None


def network_mount(path: Path, mounts: Sequence[Mount], readlink: Callable[[str], str] = os.readlink) -> Mount | None:
    """Return the network mount that contains a path, which need not exist; None for a local filesystem.

    `readlink` raises OSError for paths that are no links.
    """
    rest = list(Path.cwd().joinpath(path).parts[1:])
    here = PurePosixPath("/")
    links = 0
    while rest:
        part = rest.pop(0)
        if part == "..":
            here = here.parent
            continue
        step = here / part
        mount = mount_at(step, mounts)
        if mount is not None and mount.is_network:
            # Do not follow links in the rest of the path. A local filesystem may be mounted below.
            mount = mount_at(PurePosixPath(os.path.normpath(step.joinpath(*rest))), mounts)
            return mount if mount is not None and mount.is_network else None
        try:
            target = PurePosixPath(readlink(str(step)))
        except OSError:
            here = step
            continue
        links += 1
        if links > _MAX_LINKS:
            return None
        if target.is_absolute():
            here = PurePosixPath("/")
        rest = [*(part for part in target.parts if part != "/"), *rest]
    return None


def _unescape_octal(text: str) -> str:
    """The table escapes blanks, tabs, newlines and backslashes as three octal digits."""
    return re.sub(r"\\([0-7]{3})", lambda match: chr(int(match.group(1), 8)), text)
