"""Where a LeRobot dataset keeps its videos, as `meta/info.json` says it."""

from __future__ import annotations

import math
import re
import string
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import DatasetError

# Fields that `video_path` may have. Source: lerobot 0.4.4 and 0.6.1; the first three in version 2, the others in 3.
_FIELDS = ("video_key", "episode_chunk", "episode_index", "chunk_index", "file_index")
_FORMAT_SPEC = re.compile(r"(0?[1-9]?d)?")  # A number padded to at most 9 digits: a wider one could fill the memory.
_LONGEST_PATTERN = 1000  # Characters of `video_path`; paths of files end at 4096 bytes.
_MOST_FPS = 10_000.0  # Frames per second; cameras stay far below.
_MOST_CHUNK = 1_000_000_000  # Largest whole number in a path or of episodes in a chunk.
_CHUNK_SIZE = 1000  # Episodes in a chunk where a dataset of version 2 does not say. Source: lerobot 0.4.4.


@dataclass(frozen=True)
class Films:
    """The videos of a dataset.

    Attributes:
        path: the dataset's folder.
        info: content of its `info.json`.
        file: path of that file in the folder, for messages.
    """

    path: Path
    info: Mapping[str, Any]
    file: str

    @property
    def fps(self) -> float:
        """Frames per second.

        Raises:
            DatasetError: `fps` is missing, or no positive number.
        """
        fps = self.info.get("fps")
        if isinstance(fps, bool) or not isinstance(fps, int | float) or not 0 < fps <= _MOST_FPS:
            raise self._bad("fps", f"a number above 0, at most {_MOST_FPS:g} frames per second")
        return float(fps)

    def check(self) -> None:
        """Check what `info.json` says of videos, before any is opened.

        Raises:
            DatasetError: a value is missing or not valid.
        """
        _ = self.fps, self._pattern, self._chunk_size

    def place(self, key: str, number: int, row: Mapping[str, Any] | None) -> tuple[Path, float]:
        """The file with an episode's video of one camera, and the time at which the episode begins in it, s.

        Args:
            key: the camera's feature.
            number: the episode's number.
            row: the episode's row in `meta/episodes/`, which version 3 has; None for version 2.

        Raises:
            DatasetError: `info.json` or the row is not valid, or the file lies outside the dataset.
        """
        pattern = self._pattern
        numbers = {"episode_chunk": number // self._chunk_size, "episode_index": number}
        begin = 0.0
        if row is not None:
            numbers = {name: self._whole(row, f"videos/{key}/{name}", number) for name in ("chunk_index", "file_index")}
            begin = self._start(row, f"videos/{key}/from_timestamp", number)
        if lacking := [field for field in _fields(pattern) if field not in (*numbers, "video_key")]:
            raise self._bad("video_path", f"for this version only the fields video_key, {', '.join(numbers)}", lacking)
        file = (self.path / pattern.format(video_key=key, **numbers)).resolve()
        if not file.is_relative_to(self.path.resolve()):
            raise DatasetError(f"{self.path / self.file}: video_path {pattern!r} leads out of the dataset")
        return file, begin

    @property
    def _pattern(self) -> str:
        pattern = self.info.get("video_path")
        valid = f"a path with the fields {', '.join(_FIELDS)}, each plain or padded such as {{episode_index:06d}}"
        if not isinstance(pattern, str) or not 0 < len(pattern) <= _LONGEST_PATTERN or "\0" in pattern:
            raise self._bad("video_path", valid)
        try:
            parts = list(string.Formatter().parse(pattern))
        except ValueError as error:
            raise self._bad("video_path", valid) from error
        for _, field, spec, conversion in parts:
            if field is None:
                continue
            padding = _FORMAT_SPEC.fullmatch(spec or "") and (field != "video_key" or not spec)
            if field not in _FIELDS or conversion is not None or not padding:
                raise self._bad("video_path", valid)
        return pattern

    @property
    def _chunk_size(self) -> int:
        size = self.info.get("chunks_size", _CHUNK_SIZE)
        if isinstance(size, bool) or not isinstance(size, int) or not 1 <= size <= _MOST_CHUNK:
            raise self._bad("chunks_size", f"a whole number from 1 to {_MOST_CHUNK}")
        return size

    def _whole(self, row: Mapping[str, Any], name: str, number: int) -> int:
        value = row.get(name)
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= _MOST_CHUNK:
            raise DatasetError(f"{self.path}/meta/episodes: episode {number}: {name} is {_short(value)}")
        return value

    def _start(self, row: Mapping[str, Any], name: str, number: int) -> float:
        value = row.get(name)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < math.inf:
            raise DatasetError(f"{self.path}/meta/episodes: episode {number}: {name} is {_short(value)}")
        return float(value)

    def _bad(self, key: str, valid: str, found: object = None) -> DatasetError:
        said = found if found is not None else self.info.get(key)
        problem = f"is {_short(said)}" if key in self.info else "is missing"
        return DatasetError(f"{self.path / self.file}: {key} {problem}; valid: {valid}")


def _fields(pattern: str) -> list[str]:
    return [field for _, field, _, _ in string.Formatter().parse(pattern) if field is not None]


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
