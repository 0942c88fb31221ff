"""Sets whose meshes nobody has to fetch: they are made from the figures of a gripper's soft fingers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ..config.loader import load_config
from ..files import sha256_bytes
from ..resources import Locations
from ..robots.finray.looks import meshes
from ..robots.models import Gripper
from .lock import NOTICES, AssetLock, AssetSet, LockedFile, read_lock
from .sources import FetchProgress, SourceError

_NOTICE = "made.txt"


def load_lock(locations: Locations) -> AssetLock:
    """The lock as it is written, and with it the sets that the grippers' figures make, each called as its gripper.

    What is locked of them is what they come to here, so that a set is another one when its figures change.

    Raises:
        ConfigError: a gripper's file is not valid; and as `read_lock`.
        ResourceError: as `read_lock`.
    """
    lock = read_lock(locations)
    grippers = (load_config(Gripper, "grippers", name, locations) for name in locations.config_names("grippers"))
    made = {gripper.name: meshes(gripper.finray) for gripper in grippers if gripper.finray is not None}
    if not made:
        return lock
    sets = {name: _locked(name, files) for name, files in made.items()}
    notice = locations.file(f"{NOTICES}/{_NOTICE}").read_text(encoding="utf-8")
    return lock.model_copy(
        update={"sets": {**lock.sets, **sets}, "notices": {**lock.notices, _NOTICE: notice}, "made": made}
    )


def _locked(name: str, files: Mapping[str, bytes]) -> AssetSet:
    return AssetSet(
        name=name,
        license="MIT",
        attribution=f"Made by yamsim from the figures of the gripper {name}.",
        notice=_NOTICE,
        archive=None,
        menagerie=None,
        files={
            file: LockedFile(sha256=sha256_bytes(data), size=len(data), member=file) for file, data in files.items()
        },
    )


@dataclass(frozen=True)
class MadeHere:
    """Meshes that are made and not fetched: set -> file -> bytes."""

    made: Mapping[str, Mapping[str, bytes]]

    @property
    def name(self) -> str:
        """How reports and errors call it."""
        return "made here"

    def offers(self, assets: AssetSet) -> bool:
        """Whether the set is one of these."""
        return assets.name in self.made

    def read(self, assets: AssetSet, scratch: Path, progress: FetchProgress) -> dict[str, bytes]:
        """The set's files.

        Raises:
            SourceError: it is none of these.
        """
        if not self.offers(assets):
            raise SourceError(f"{assets.name} is fetched")
        progress(f"{assets.name}: {self.name}", assets.size, assets.size)
        return dict(self.made[assets.name])
