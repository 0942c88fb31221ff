"""What knows only tasks with an object and a target."""

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
