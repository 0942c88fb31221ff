"""What knows only one of the two kinds of tasks: those with an object and a target, and those that are data."""

from __future__ import annotations

from ..errors import UsageError
from .recording import RecordConfig


def require_pair(config: RecordConfig, who: str) -> RecordConfig:
    """The config itself, if its task has an object and a target.

    Args:
        who: asks, for the message.

    Raises:
        UsageError: its task is data, done by skills.
    """
    if config.program:
        raise UsageError(
            f"task {config.task.name!r} is of things by role, and {who} knows only tasks with an object and a target; "
            "give one such as pickplace or handover"
        )
    return config


def require_program(config: RecordConfig, who: str) -> RecordConfig:
    """The config itself, if its task is data, done by skills.

    Args:
        who: asks, for the message.

    Raises:
        UsageError: its task has an object and a target, and a planner of its own.
    """
    if not config.program:
        raise UsageError(
            f"task {config.task.name!r} is of the kind {config.task.kind!r}, and {who} is for tasks of the kind "
            f"'program'; `yamsim trials --task {config.task.name}` counts how often it succeeds"
        )
    return config
