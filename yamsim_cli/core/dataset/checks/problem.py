"""One thing that is wrong with a dataset, and how equal ones are gathered."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, replace
from typing import Any

from .codes import CODES, Code, Severity

_LONGEST = 200


@dataclass(frozen=True)
class Problem:
    """A fault found.

    Attributes:
        code: one of `codes.CODES`.
        episode: the episode's directory name; "" for the dataset.
        file: the first file concerned, relative to the episode or the dataset; "" for all of it.
        value: what was found.
        valid: what would have been valid; "" where there is nothing to say.
        count: how many files or frames of this episode have it.
    """

    code: str
    episode: str
    file: str
    value: str
    valid: str = ""
    count: int = 1

    @property
    def kind(self) -> Code:
        """What is known about the code."""
        return CODES[self.code]

    @property
    def text(self) -> str:
        """One line for a person, without the place."""
        valid = f"; valid: {self.valid}" if self.valid else ""
        more = f" (in {self.count} frames)" if self.count > 1 else ""
        return f"{self.kind.title}: {self.value}{valid}{more}" if self.value else f"{self.kind.title}{more}"

    @property
    def place(self) -> str:
        """Where it is."""
        return "/".join(part for part in (self.episode, self.file) if part) or "dataset"

    def plain(self) -> dict[str, Any]:
        """As JSON-ready data."""
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
    """Gathers the faults of one episode or of the dataset; the same fault in many frames is one with a count."""

    def __init__(self, episode: str = "") -> None:
        self._episode = episode
        self._found: dict[Hashable, Problem] = {}

    def add(self, code: str, file: str = "", value: object = "", valid: object = "", *, about: Hashable = None) -> None:
        """Note a fault; with `about`, faults of one code about the same thing are counted as one.

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
        """Whether there is a fault whose code begins so."""
        return any(problem.code.startswith(prefix) for problem in self._found.values())

    def list(self) -> list[Problem]:
        """What was found, in the order of finding."""
        return list(self._found.values())

    def __len__(self) -> int:
        return len(self._found)


def printable(value: object) -> str:
    """Text of a value for one line of a terminal: what the dataset holds may be made to look like something else."""
    text = str(value)
    if len(text) > _LONGEST:
        text = text[: _LONGEST - 3] + "..."
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text)


def errors(problems: list[Problem]) -> int:
    """How many of them are errors."""
    return sum(problem.kind.severity is Severity.ERROR for problem in problems)
