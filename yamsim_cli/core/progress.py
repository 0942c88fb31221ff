from __future__ import annotations

from collections.abc import Callable

# Is called with the number of finished parts and the total number of parts of a job.
Progress = Callable[[int, int], None]
