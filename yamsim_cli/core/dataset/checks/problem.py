"""A fault in a dataset, and the collection of an episode's faults."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, replace
from typing import Any

from .codes import CODES, Code, Severity

_LONGEST = 200


@dataclass(frozen=True)
class Problem:
    """A fault that was found.

    Attributes:
        code: one of `codes.CODES`.
        episode: the episode's directory name; "" for the dataset.
        file: the first file concerned, relative to the episode or the dataset; "" for all of it.
        value: what was found.
        valid: what would be valid; "" where that needs no words.
        count: how many files or frames of this episode have the fault.
    """

    code: str
    episode: str
    file: str
    value: str
    valid: str = ""
    count: int = 1

    @property
    def kind(self) -> Code:
        """The code's severity, title and advice."""
        return CODES[self.code]

    @property
    def text(self) -> str:
        """One line for a person, without the place."""
        valid = f"; valid: {self.valid}" if self.valid else ""
        more = f" (in {self.count} frames)" if self.count > 1 else ""
        return f"{self.kind.title}: {self.value}{valid}{more}" if self.value else f"{self.kind.title}{more}"

    @property
    def place(self) -> str:
        """The episode and file with the fault."""
        return "/".join(part for part in (self.episode, self.file) if part) or "dataset"

    def plain(self) -> dict[str, Any]:
        """The fault as data that is ready for JSON."""
        return {
            "code": self.code,
            "severity": str(self.kind.severity),
            "episode": self.episode,
            "file": self.file,
            "title": self.kind.title,
            "problem": self.text,
            "value": self.value,
            "valid": self.valid,
            "count": self.count,
            "advice": self.kind.advice,
        }


class Problems:
    """Collects the faults of one episode or of the dataset. The same fault in many frames counts as one."""

    def __init__(self, episode: str = "") -> None:
        self._episode = episode
        self._found: dict[Hashable, Problem] = {}

    def add(self, code: str, file: str = "", value: object = "", valid: object = "", *, about: Hashable = None) -> None:
        """Note a fault. With `about`, faults of one code about the same thing count as one.

        Raises:
            KeyError: there is no such code.
        """
        assert code in CODES, code
        key = (code, len(self._found)) if about is None else (code, "about", about)
        if earlier := self._found.get(key):
            self._found[key] = replace(earlier, count=earlier.count + 1)
        else:
            self._found[key] = Problem(
                code, printable(self._episode), printable(file), printable(value), printable(valid)
            )

    def have(self, prefix: str) -> bool:
        """Whether there is a fault whose code begins with `prefix`."""
        return any(problem.code.startswith(prefix) for problem in self._found.values())

    def list(self) -> list[Problem]:
        """The faults, in the order in which they were found."""
        return list(self._found.values())

    def __len__(self) -> int:
        return len(self._found)


def printable(value: object) -> str:
    """Text of a value that is safe to show on one line of a terminal, where a dataset's content could deceive."""
    text = str(value)
    if len(text) > _LONGEST:
        text = text[: _LONGEST - 3] + "..."
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text)


def errors(problems: list[Problem]) -> int:
    """How many of the problems are errors."""
    return sum(problem.kind.severity is Severity.ERROR for problem in problems)
