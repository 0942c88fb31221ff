from __future__ import annotations

import stat
import urllib.parse
from pathlib import Path

from .refusals import RefusedError

MAX_BYTES = 256_000_000  # bytes, of all files that a folder reads
MAX_FILES = 256

_MODEL_SCHEMES = ("model", "package", "fuel")  # URI schemes that identify a model by its name


class ConfinedFolder:
    """Reads untrusted files below one folder, not even through links to others, with limits on their number and size.

    Callers check `refused`, the last error of `read`, after libraries that swallow exceptions.
    """

    def __init__(self, root: Path) -> None:
        self._root = root.resolve()
        self._bytes = 0
        self._files = 0
        self.refused: RefusedError | None = None

    def read(self, name: str, base: Path | None = None) -> bytes:
        """Return the content of a file by its name relative to `base` (default: the root), or its `model://` URI.

        A file that is outside, missing or not regular, or exceeds a limit, raises RefusedError.
        """
        try:
            path = self.find(name, base)
            self._files += 1
            if self._files > MAX_FILES:
                raise RefusedError("too-many-files", f"it names more than {MAX_FILES} files")
            self._bytes += path.stat().st_size
            if self._bytes > MAX_BYTES:
                raise RefusedError("too-large", f"the files up to {name} have more than {MAX_BYTES // 10**6} MB")
            return path.read_bytes()
        except RefusedError as error:
            self.refused = error
            raise
        except OSError as error:
            self.refused = RefusedError("missing", f"{name} cannot be read: {error.strerror}")
            raise self.refused from error

    def find(self, name: str, base: Path | None = None) -> Path:
        """Return the path of a regular file by its name; arguments and errors as in `read`."""
        tried = self._candidate_paths(name, base or self._root)
        inside = [path for path in tried if path.is_relative_to(self._root)]
        if not inside:
            raise RefusedError("outside", f"it names {name!r}, which is outside of its folder")
        for path in inside:
            try:
                mode = path.stat().st_mode
            except (OSError, ValueError):
                continue
            if not stat.S_ISREG(mode):
                raise RefusedError("not-a-file", f"{name!r} is not a regular file")
            return path
        raise RefusedError("missing", f"{name!r} is not in its folder")

    def _candidate_paths(self, name: str, base: Path) -> list[Path]:
        if "\0" in name or len(name) > 1000:
            raise RefusedError("outside", "it names a file with an invalid path")
        name = name.strip().replace("\\", "/")
        scheme, found, rest = name.partition("://")
        if not found:
            decoded = urllib.parse.unquote(name)
            return [(base / part).resolve() for part in dict.fromkeys((name, decoded)) if part]
        if scheme == "file":
            return [Path("/" + rest.lstrip("/")).resolve()]
        if scheme not in _MODEL_SCHEMES:
            raise RefusedError("outside", f"it names {name!r}, but yamsim reads only files of its folder")
        model, _, inner = rest.partition("/")
        # Most files are in a folder with the model's name; some are beside that folder.
        roots = [base, self._root]
        own = [(root / inner).resolve() for root in roots if inner]
        return [*((root / rest).resolve() for root in roots if rest), *own] if model else own
