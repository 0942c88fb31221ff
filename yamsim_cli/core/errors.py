"""Errors that users see, with their documented exit codes, and helpers for one-line messages.

A message names the fault, the place, the value, the valid values and the remedy. Every exception that is not a
`YamsimError` is a bug: the program prints its traceback and exits with 1.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import ClassVar


class YamsimError(Exception):
    """Base of errors with a cause outside yamsim: the user's input, a file or the machine."""

    exit_code: ClassVar[int] = 1


class UsageError(YamsimError):
    """A command line that cannot be run as given: a bad flag value, an output that exists."""

    exit_code = 2


class ConfigError(YamsimError):
    """A configuration file or value that is not valid."""

    exit_code = 3


class ResourceError(YamsimError):
    """A missing resource: a mesh, a GL backend, a package extra or write permission."""

    exit_code = 4


class DatasetError(YamsimError):
    """A dataset, or a file of a dataset, that is damaged or inconsistent."""

    exit_code = 4


class NewerFormatError(DatasetError):
    """A later version of yamsim wrote the dataset, in a format that this version cannot read."""


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
    """Return a number with its noun: ``"1 episode"``, ``"2 episodes"``."""
    return f"{number} {noun}" + ("" if number == 1 else "s")


def join_ranges(numbers: Iterable[int]) -> str:
    """Return ordered numbers with consecutive ones joined: ``"0-4, 7, 9-10"``."""
    runs: list[list[int]] = []
    for number in numbers:
        if runs and number == runs[-1][1] + 1:
            runs[-1][1] = number
        else:
            runs.append([number, number])
    return ", ".join(str(first) if first == last else f"{first}-{last}" for first, last in runs)


def file_size(size: float) -> str:
    """Return a number of bytes as text in kB, MB or GB."""
    for unit, scale in (("GB", 1e9), ("MB", 1e6)):
        if size >= scale:
            return f"{size / scale:.1f} {unit}"
    return f"{size / 1e3:.1f} kB"


def suggest_similar(value: str, valid: Iterable[str]) -> str:
    """Return a hint such as ``"did you mean 'single'? valid: bimanual, single"``; no question if nothing is similar."""
    choices = sorted(valid)
    close = difflib.get_close_matches(value, choices, n=1)
    hint = f"did you mean {close[0]!r}? " if close else ""
    return f"{hint}valid: {', '.join(choices) if choices else '(none)'}"
