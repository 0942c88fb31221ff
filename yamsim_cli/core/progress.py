"""Progress of a job, for callbacks."""

from __future__ import annotations

from collections.abc import Callable

# Called with the number of finished parts and the total number of parts.
Progress = Callable[[int, int], None]
