"""Where configs, robot models and assets lie: in a checkout, in an installed wheel, or in the user's own folder."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from .errors import ConfigError, ResourceError, suggest

# Kind and name of the config that stands for another quality, `Locations.auto_quality`, which depends on the GPU.
AUTO = ("quality", "auto")

# The asset set of the user's own meshes: a folder among the fetched ones that no lock lists.
IMPORTED = "imported"

# What a config file's name ends in. Cameras may come from other programs.
_ENDINGS = (".yaml", ".yml")
_CAMERA_ENDINGS = (*_ENDINGS, ".json", ".xml")

# What the names of the things of our own kitchen begin with.
_KITCHEN = "kitchen_"
# Asset set -> folder of its meshes, or None where they are not here. Primitives stand in for what has no folder.
Meshes = Mapping[str, Path | None]

# Where the configs of a kind lie under a root of data, `*` standing for their names.
_PLACES = {"robots": "robot_models/*/model.yaml", "grippers": "robot_models/grippers/*/gripper.yaml"}

# Kind -> what else may stand where a name of that kind is asked for.
_ALSO_VALID = {"rigs": "; or an arm and its gripper, such as yam_pro+linear_4310"}

_PACKAGE = Path(__file__).resolve().parents[1]


def _built_in() -> Path:
    """The folder of the data shipped with yamsim: `_data` in an installed wheel, else the checkout's top level."""
    packaged = _PACKAGE / "_data"
    return packaged if packaged.is_dir() else _PACKAGE.parent


def config_place(kind: str) -> str:
    """Where the configs of a kind lie under a root of data, `*` standing for a name."""
    return _PLACES.get(kind, f"configs/{kind}/*.yaml")


def camera_file(name: str) -> tuple[Path, str] | None:
    """The file that `FILE` or `FILE:CAMERA` names, and the camera, empty without one; None if it names no file."""
    if name.endswith(_CAMERA_ENDINGS):
        return Path(name), ""
    file, _, camera = name.rpartition(":")
    return (Path(file), camera) if file.endswith(_CAMERA_ENDINGS) else None


@dataclass(frozen=True)
class Locations:
    """The directories that a job may read from. Plain data, so that it can be sent to workers on any machine.

    Attributes:
        data: roots that hold `configs/`, `robot_models/` and `assets/`, most important first.
        assets: the cache of fetched meshes.
        auto_quality: the quality that the name `auto` stands for.
        meshes: the folders of those that a scene is to show, once they were looked for; empty shows primitives.
    """

    data: tuple[Path, ...]
    assets: Path
    auto_quality: str = "balanced"
    meshes: Meshes = field(default_factory=dict)

    @classmethod
    def find(cls, environ: Mapping[str, str]) -> Locations:
        """The locations that `YAMSIM_DATA_DIR`, `YAMSIM_ASSETS`, `XDG_CACHE_HOME` and `HOME` name. Touches no file."""
        roots = [Path(environ["YAMSIM_DATA_DIR"])] if environ.get("YAMSIM_DATA_DIR") else []
        if environ.get("YAMSIM_ASSETS"):
            assets = Path(environ["YAMSIM_ASSETS"])
        elif environ.get("XDG_CACHE_HOME"):
            assets = Path(environ["XDG_CACHE_HOME"]) / "yamsim" / "assets"
        else:
            assets = Path(environ.get("HOME") or "~").expanduser() / ".cache" / "yamsim" / "assets"
        return cls(data=(*roots, _built_in()), assets=assets)

    def file(self, relative: str) -> Path:
        """The first data root's file at `relative`.

        Raises:
            ResourceError: no root has it.
        """
        for root in self.data:
            if (root / relative).is_file():
                return root / relative
        raise ResourceError(
            f"{relative} not found under {', '.join(map(str, self.data))}; set YAMSIM_DATA_DIR or reinstall yamsim"
        )

    def config_names(self, kind: str) -> list[str]:
        """Names of the configs of one kind (`rigs`, `tasks`, `robots`, ...), sorted."""
        place = config_place(kind)
        depth = place.split("/").index("*") if kind in _PLACES else -1
        found = {path.relative_to(root).parts[depth] for root in self.data for path in root.glob(place)}
        names = {name.removesuffix(".yaml") for name in found}
        return sorted(names | {AUTO[1]} if kind == AUTO[0] else names)

    def config_file(self, kind: str, name: str) -> Path:
        """The file of a named config, or of a path the user gave (anything ending in `.yaml` or `.yml`).

        What stands in front, as in `013_apple` and `kitchen_spoon`, may be left out. A camera's file may also end in
        `.json` or `.xml`. One of its cameras may be named behind it, as in `calibration.json:left`, and stays in the
        path that comes back.

        Raises:
            ConfigError: no such config; the message lists the names there are.
        """
        path = Path(name)
        # A robot is recorded by its name, so it has to be where names are looked up.
        file = path if name.endswith(_ENDINGS) and kind not in _PLACES else None
        if kind == "cameras" and (found := camera_file(name)):
            file = found[0]
        if file is not None:
            if file.is_file():
                return path
            raise ConfigError(f"{kind.removesuffix('s')} config file {file} does not exist")
        if name not in self.config_names(kind):
            name = self._numbered(kind, name) or name
        if name not in self.config_names(kind):
            endings = _CAMERA_ENDINGS if kind == "cameras" else _ENDINGS
            hint = f"; the name of a file has to end in {' or '.join(endings)}" if path.is_file() else ""
            valid = suggest(name, self.config_names(kind)) + _ALSO_VALID.get(kind, "")
            raise ConfigError(f"unknown {kind.removesuffix('s')} {name!r}; {valid}{hint}")
        chosen = self.auto_quality if (kind, name) == AUTO else name
        return self.file(config_place(kind).replace("*", chosen))

    def _numbered(self, kind: str, name: str) -> str | None:
        """The only config whose name is a number and this name, as `013_apple` for `apple`; else the kitchen's of this
        name, as `kitchen_spoon` for `spoon`; None if there is none.
        """
        names = self.config_names(kind)
        found = [other for other in names if re.fullmatch(rf"\d[^_]*_{re.escape(name)}", other)]
        if not found and (ours := f"{_KITCHEN}{name}") in names:
            return ours
        return found[0] if len(found) == 1 else None
