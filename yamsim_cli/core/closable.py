from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Self


class Closable(ABC):
    """Base of objects that own a resource, such as a renderer or workers; a context manager."""

    @abstractmethod
    def close(self) -> None:
        """Free the resource."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *reason: object) -> None:
        self.close()
