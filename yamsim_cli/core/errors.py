"""The errors that users see, each one line of text and one documented exit code, and words for messages.

A message says what is wrong, where, the value found, what would be valid, and what to do. Anything that is not a
`YamsimError` is a bug: it keeps its traceback and exits with 1.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import ClassVar


class YamsimError(Exception):
    """Base of every error that is the user's or the machine's, not a bug in yamsim."""

    exit_code: ClassVar[int] = 1


class UsageError(YamsimError):
    """A command line that cannot be run as given: a bad flag value, an output that exists."""

    exit_code = 2


class ConfigError(YamsimError):
    """A configuration file or value that is not valid."""

    exit_code = 3


class ResourceError(YamsimError):
    """Something the job needs is missing: a mesh, a GL backend, a package extra, write permission."""

    exit_code = 4


class DatasetError(YamsimError):
    """A dataset, or a file of one, that cannot be trusted."""

    exit_code = 4


class SimulationError(YamsimError):
    """Physics, planning or rendering failed."""

    exit_code = 5


class PartialJobError(YamsimError):
    """A job ended early; its results so far are intact and on disk."""

    exit_code = 6


class InterruptedJobError(YamsimError):
    """The user stopped the job; its results so far are intact and on disk."""

    exit_code = 130


def count_noun(number: int, noun: str) -> str:
    """A number with its noun: ``"1 episode"``, ``"2 episodes"``."""
    return f"{number} {noun}" + ("" if number == 1 else "s")


def join_ranges(numbers: Iterable[int]) -> str:
    """Ordered numbers with runs joined: ``"0-4, 7, 9-10"``."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    return ", ".join(str(first) if first == last else f"{first}-{last}" for first, last in runs)


def file_size(size: float) -> str:
    """A number of bytes for a person, in kB, MB or GB."""
    for unit, scale in (("GB", 1e9), ("MB", 1e6)):
        if size >= scale:
            return f"{size / scale:.1f} {unit}"
    return f"{size / 1e3:.1f} kB"


def suggest(value: str, valid: Iterable[str]) -> str:
    """The valid values in words, after the closest one if there is a close one.

    Returns:
        For example ``"did you mean 'single'? valid: bimanual, single"``.
    """
    choices = sorted(valid)
    close = difflib.get_close_matches(value, choices, n=1)
    hint = f"did you mean {close[0]!r}? " if close else ""
    return f"{hint}valid: {', '.join(choices) if choices else '(none)'}"
