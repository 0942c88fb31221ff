"""When what happens in an attempt: it follows from the config alone, whatever is drawn."""

from __future__ import annotations

from dataclasses import replace

from ..config.record import RecordConfig
from ..types import Phases
from . import handover
from .plans import phases, ticks


def attempt_phases(config: RecordConfig) -> tuple[Phases, ...]:
    """When the object is in hand, and in whose."""
    if config.task.kind == "handover":
        return handover.phases(config.task)
    return (replace(phases(config.task, config.grasp), arm=config.acting_scene_arms[0]),)


def attempt_ticks(config: RecordConfig) -> int:
    """Control ticks of an attempt."""
    if config.task.kind == "handover":
        return handover.schedule(config.task).total
    return ticks(config.task, config.grasp)
