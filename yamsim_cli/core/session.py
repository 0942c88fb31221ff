"""What is settled before anything runs, as one value."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

# Named alone: whoever opens sessions starts before pydantic is loaded.
if TYPE_CHECKING:
    from .config.recording import RecordConfig
    from .resources import Locations


@dataclass(frozen=True)
class Session:
    """What a job is made from: plain data, which travels to its workers whole. `core.opener` opens one.

    Attributes:
        config: what is run, checked.
        locations: where its files are, the folders of its meshes among them.
    """

    config: RecordConfig
    locations: Locations

    def with_values(self, **values: Any) -> Session:
        """The same session with other values of its config, by their keys; they are not checked again."""
        return replace(self, config=self.config.model_copy(update=values))

    def without_meshes(self) -> Session:
        """The same session with primitives in place of all meshes: the same physics, compiled sooner."""
        return replace(self, locations=replace(self.locations, meshes={}))
