"""A config and the places of its files, as one value for all that runs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

# Imported for types only, so that a program can open a session before pydantic is loaded.
if TYPE_CHECKING:
    from ..files.resources import Locations
    from .recording import RecordConfig


@dataclass(frozen=True)
class Session:
    """Plain data for workers on any machine; `opener` opens a session.

    Attributes:
        config: the validated config.
        locations: places of its files, including the folders of its meshes.
    """

    config: RecordConfig
    locations: Locations

    def with_values(self, **values: Any) -> Session:
        """The session with other values of its config, by their keys, without validation."""
        return replace(self, config=self.config.model_copy(update=values))

    def without_meshes(self) -> Session:
        """The session with primitives instead of meshes, which compiles faster and has the same physics."""
        return replace(self, locations=replace(self.locations, meshes={}))
