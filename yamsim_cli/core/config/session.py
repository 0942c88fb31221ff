"""The config of a recording and the locations of its files, as one value for all jobs and worker processes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

# Imported only for types, so that a program can open a session before pydantic is loaded.
if TYPE_CHECKING:
    from ..files.resources import Locations
    from .recording import RecordConfig


@dataclass(frozen=True)
class Session:
    """A config and the locations of its files, which can be pickled for worker processes on any machine.

    Attributes:
        config: the validated config.
        locations: locations of its files, including the folders of its meshes.
    """

    config: RecordConfig
    locations: Locations

    def with_values(self, **values: Any) -> Session:
        """Return the session with the given keys of its config replaced by `values`, without validation."""
        return replace(self, config=self.config.model_copy(update=values))

    def without_meshes(self) -> Session:
        """Return the session with primitives instead of meshes, which compiles faster with the same physics."""
        return replace(self, locations=replace(self.locations, meshes={}))
