"""ABC's model files: a folder of a checkout, which is identified by its git tree."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

from ..core.errors import ResourceError

CHECKOUT_VARIABLE = "YAMSIM_ABC"  # environment variable that names the checkout
COMMIT = "e5e1fbc"  # commit of amazon-far/abc from which the constants of this package are
#: Git's id of the folder at that commit: `git rev-parse e5e1fbc:assets/put_bottles`.
MODEL_TREE = "4146b3065a76ae7b18ddcddced90a7f2f9b4dfa2"
_MODEL_FOLDER = Path("assets", "put_bottles")  # in the checkout
_MAX_FILES = 1000  # files that are read before a folder counts as another one; the original has 320


def find_model_folder(environ: Mapping[str, str]) -> Path:
    """Return the folder of the model files in the checkout that `YAMSIM_ABC` names.

    Raises:
        ResourceError: the variable is not set, or the files differ from the commit's.
    """
    checkout = environ.get(CHECKOUT_VARIABLE, "")
    remedy = f"clone the repository amazon-far/abc, check out {COMMIT}, and set {CHECKOUT_VARIABLE} to its folder"
    if not checkout:
        raise ResourceError(
            f"the task put_bottles needs ABC's model files, and {CHECKOUT_VARIABLE} is not set: {remedy}"
        )
    folder = Path(checkout) / _MODEL_FOLDER
    if not folder.is_dir():
        raise ResourceError(f"{CHECKOUT_VARIABLE}: there is no folder {folder}: {remedy}")
    found = git_tree_id(folder)
    if found != MODEL_TREE:
        raise ResourceError(
            f"{CHECKOUT_VARIABLE}: {folder} differs from commit {COMMIT} of amazon-far/abc: its git tree is {found}, "
            f"not {MODEL_TREE}; `git status` and `git diff {COMMIT} -- {_MODEL_FOLDER}` there show which files"
        )
    return folder.resolve()


def git_tree_id(folder: Path) -> str:
    """Return the id (40 hexadecimal digits) that git gives to a folder of regular files and folders.

    Raises:
        ResourceError: the folder cannot be read, or has more than 1000 files.
    """
    try:
        return _tree_digest(folder, [_MAX_FILES]).hex()
    except OSError as error:
        raise ResourceError(f"{error.filename or folder}: cannot be read: {error.strerror}") from error


def _tree_digest(folder: Path, left: list[int]) -> bytes:
    entries = []
    for path in folder.iterdir():
        left[0] -= 1
        if left[0] < 0:
            raise ResourceError(
                f"{folder}: has more than {_MAX_FILES} files, so it is no checkout of amazon-far/abc; set "
                f"{CHECKOUT_VARIABLE} to the folder of a checkout"
            )
        if path.is_dir():
            # Git sorts a folder's name as if it ended with a slash.
            entries.append((f"{path.name}/", b"40000", path.name, _tree_digest(path, left)))
        else:
            entries.append((path.name, b"100644", path.name, _git_digest(b"blob", path.read_bytes())))
    rows = (mode + b" " + name.encode() + b"\0" + digest for _, mode, name, digest in sorted(entries))
    return _git_digest(b"tree", b"".join(rows))


def _git_digest(kind: bytes, content: bytes) -> bytes:
    # Git's own choice of hash, not a choice for secrecy.
    return hashlib.sha1(b"%s %d\0" % (kind, len(content)) + content, usedforsecurity=False).digest()
