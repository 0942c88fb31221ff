"""Where configs, robot models and assets lie: in a checkout, in an installed wheel, or in the user's own folder."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from .errors import ConfigError, ResourceError, suggest

# The quality that names another one, chosen by whoever knows what draws.
AUTO = ("quality", "auto")

# The asset set of the user's own meshes: a folder of that name among the fetched ones, in no lock.
IMPORTED = "imported"

# What a config file's name ends in. Cameras may come from other programs.
_ENDINGS = (".yaml", ".yml")
_CAMERA_ENDINGS = (*_ENDINGS, ".json", ".xml")

_PACKAGE = Path(__file__).resolve().parents[1]


def _built_in() -> Path:
    """The data shipped with this yamsim: `_data` inside an installed wheel, else the checkout's top level."""
    packaged = _PACKAGE / "_data"
    return packaged if packaged.is_dir() else _PACKAGE.parent


def camera_file(name: str) -> tuple[Path, str] | None:
    """The file that `FILE` or `FILE:CAMERA` names, and the camera, empty without one; None if it names no file."""
    if name.endswith(_CAMERA_ENDINGS):
        return Path(name), ""
    file, _, camera = name.rpartition(":")
    return (Path(file), camera) if file.endswith(_CAMERA_ENDINGS) else None


@dataclass(frozen=True)
class Locations:
    """The directories a job may read from. Plain data, so that workers on any machine can be handed it.

    Attributes:
        data: roots that hold `configs/`, `robot_models/` and `assets/`, most important first.
        assets: the cache of fetched meshes.
        auto_quality: the quality that the name `auto` stands for.
    """

    data: tuple[Path, ...]
    assets: Path
    auto_quality: str = "balanced"

    @classmethod
    def find(cls, environ: Mapping[str, str]) -> Locations:
        """Build from the environment: `YAMSIM_DATA_DIR`, `YAMSIM_ASSETS`, `XDG_CACHE_HOME`, `HOME`. Touches no file."""
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
        """Names of the configs of one kind (`rigs`, `tasks`, ...), sorted."""
        names = {path.stem for root in self.data for path in (root / "configs" / kind).glob("*.yaml")}
        return sorted(names | {AUTO[1]} if kind == AUTO[0] else names)

    def config_file(self, kind: str, name: str) -> Path:
        """The file of a named config, or of a path the user gave (anything ending in `.yaml` or `.yml`).

        A number in front, as in `013_apple`, may be left out. A camera's file may also end in `.json` or `.xml`, and
        have one of its cameras' names behind it, as in `calibration.json:left`: then so has the path that comes back.

        Raises:
            ConfigError: no such config; the message lists the names there are.
        """
        path = Path(name)
        file = path if name.endswith(_ENDINGS) else None
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
            valid = suggest(name, self.config_names(kind))
            raise ConfigError(f"unknown {kind.removesuffix('s')} {name!r}; {valid}{hint}")
        chosen = self.auto_quality if (kind, name) == AUTO else name
        return self.file(f"configs/{kind}/{chosen}.yaml")

    def _numbered(self, kind: str, name: str) -> str | None:
        """The only config whose name is a number and this name, as `013_apple` for `apple`; None if there is none."""
        found = [other for other in self.config_names(kind) if re.fullmatch(rf"\d[^_]*_{re.escape(name)}", other)]
        return found[0] if len(found) == 1 else None
