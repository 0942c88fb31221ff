"""Which policy is evaluated, and how."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from ..policies.chunks import Chunking


@dataclass(frozen=True)
class PolicyChoice:
    """Which policy, how its answers are used, and how much time it has.

    Attributes:
        name, folder: see `make_policy`.
        call_seconds: for one answer, or a reset, of real time.
        time_limit: for a trial, of simulated time, s; None for twice what a plan takes.
        arguments: keywords that the user's own policy is made with.
        mapping: name or file of a config of `policies`, for a policy from elsewhere; None for its protocol's own.
        chunking: how chunks of actions are used.
    """

    name: str
    folder: Path
    call_seconds: float = 30.0
    time_limit: float | None = None
    arguments: Mapping[str, int | float | str] = field(default_factory=dict)
    mapping: str | None = None
    chunking: Chunking = field(default_factory=Chunking)
