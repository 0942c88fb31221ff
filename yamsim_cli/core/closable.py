"""Base class of context managers that have a `close` method."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Self


class Closable(ABC):
    """Base of objects that own a resource, such as a renderer or workers. A `with` statement closes the object."""

    @abstractmethod
    def close(self) -> None:
        """Free the resources of this object."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *reason: object) -> None:
        self.close()
