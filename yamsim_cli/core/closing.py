"""What a `with` statement closes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Self


class Closing(ABC):
    """Base of objects that own something to be given back, such as a renderer or workers: a `with` closes them."""

    @abstractmethod
    def close(self) -> None:
        """Give back what this object owns."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *reason: object) -> None:
        self.close()
