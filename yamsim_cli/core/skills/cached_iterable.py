"""Choices that are made one by one, when somebody asks for the next one, and kept for whoever asks again."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Generic, TypeVar

T = TypeVar("T")


class CachedIterable(Generic[T]):
    """An iterable that takes elements from its source when they are first asked for, and keeps them.

    Args:
        source: is iterated once.
    """

    def __init__(self, source: Iterable[T]) -> None:
        self._source, self._kept = iter(source), list[T]()

    def __iter__(self) -> Iterator[T]:
        k = 0
        while True:
            while k < len(self._kept):
                yield self._kept[k]
                k += 1
            try:
                self._kept.append(next(self._source))
            except StopIteration:
                return
