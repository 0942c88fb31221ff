"""The kinds of KitchenBench's goals that yamsim supports."""

from __future__ import annotations

from enum import StrEnum


class GoalKind(StrEnum):
    """Values of `SceneBlueprint.target_kind`."""

    PLACE_ON = "place_on"
    STACK = "stack"
    PLACE_IN = "place_in"
    HANDOFF = "handoff"
    SORT = "sort"
    FOLD = "fold"
    OPEN = "open"  # a lid is taken off its container
    SEAL = "seal"  # a lid is put onto its container
    POUR = "pour_into"
    SCOOP = "scoop_transfer"
