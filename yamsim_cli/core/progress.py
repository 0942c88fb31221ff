"""How whoever waits for many things of one kind is told how far they are."""

from __future__ import annotations

from collections.abc import Callable

# Called with how many are done, and how many there are in all.
Progress = Callable[[int, int], None]
