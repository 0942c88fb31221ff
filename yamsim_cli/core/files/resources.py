"""Locations of configs, robot models and assets: a checkout, an installed wheel, or the user's own folder."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from ..errors import ConfigError, ResourceError, suggest

AUTO = ("quality", "auto")  # kind and name of the config that stands for `Locations.auto_quality`
IMPORTED = "imported"  # asset set of the user's own meshes: a folder of the cache that no lock lists
_ENDINGS = (".yaml", ".yml")  # of config files
_CAMERA_ENDINGS = (*_ENDINGS, ".json", ".xml")  # of camera files, which may come from other programs
_KITCHEN = "kitchen_"  # prefix of the names of kitchen things

# Asset set -> folder of its meshes; None shows primitives instead.
Meshes = Mapping[str, Path | None]

# Kind -> path of its configs below a data root, with `*` for the name.
_PLACES = {"robots": "robot_models/*/model.yaml", "grippers": "robot_models/grippers/*/gripper.yaml"}

_PACKAGE = Path(__file__).resolve().parents[2]


def _built_in() -> Path:
    """The data root that ships with yamsim: `_data` in an installed wheel, else the checkout's top level."""
    packaged = _PACKAGE / "_data"
    return packaged if packaged.is_dir() else _PACKAGE.parent


def config_path_pattern(kind: str) -> str:
    """Path of the configs of a kind below a data root, with `*` for the name."""
    return _PLACES.get(kind, f"configs/{kind}/*.yaml")


def camera_file(name: str) -> tuple[Path, str] | None:
    """File and camera of `FILE` or `FILE:CAMERA`, the camera empty if not given; None if `name` names no file."""
    if name.endswith(_CAMERA_ENDINGS):
        return Path(name), ""
    file, _, camera = name.rpartition(":")
    return (Path(file), camera) if file.endswith(_CAMERA_ENDINGS) else None


@dataclass(frozen=True)
class Locations:
    """The directories that a job may read from; plain data that can be sent to workers on any machine.

    Attributes:
        data: roots that hold `configs/`, `robot_models/` and `assets/`, most important first.
        assets: the cache of fetched meshes.
        auto_quality: the quality that the name `auto` stands for; depends on the GPU.
        meshes: folders of the meshes that scenes show; empty shows primitives.
    """

    data: tuple[Path, ...]
    assets: Path
    auto_quality: str = "balanced"
    meshes: Meshes = field(default_factory=dict)

    @classmethod
    def find(cls, environ: Mapping[str, str]) -> Locations:
        """The locations from `YAMSIM_DATA_DIR`, `YAMSIM_ASSETS`, `XDG_CACHE_HOME` and `HOME`; opens no file."""
        roots = [Path(environ["YAMSIM_DATA_DIR"])] if environ.get("YAMSIM_DATA_DIR") else []
        if environ.get("YAMSIM_ASSETS"):
            assets = Path(environ["YAMSIM_ASSETS"])
        elif environ.get("XDG_CACHE_HOME"):
            assets = Path(environ["XDG_CACHE_HOME"]) / "yamsim" / "assets"
        else:
            assets = Path(environ.get("HOME") or "~").expanduser() / ".cache" / "yamsim" / "assets"
        return cls(data=(*roots, _built_in()), assets=assets)

    def file(self, relative: str) -> Path:
        """The file at `relative` in the first data root that has it; ResourceError if none has."""
        for root in self.data:
            if (root / relative).is_file():
                return root / relative
        raise ResourceError(
            f"{relative} not found under {', '.join(map(str, self.data))}; set YAMSIM_DATA_DIR or reinstall yamsim"
        )

    def config_names(self, kind: str) -> list[str]:
        """Names of the configs of one kind (`rigs`, `tasks`, `robots`, ...), sorted."""
        place = config_path_pattern(kind)
        depth = place.split("/").index("*") if kind in _PLACES else -1
        found = {path.relative_to(root).parts[depth] for root in self.data for path in root.glob(place)}
        names = {name.removesuffix(".yaml") for name in found}
        return sorted(names | {AUTO[1]} if kind == AUTO[0] else names)

    def config_file(self, kind: str, name: str) -> Path:
        """The file of a named config, or of a path that ends in `.yaml` or `.yml`.

        Names may leave out a prefix, as in `013_apple` and `kitchen_spoon`. A camera's file may also end in `.json` or
        `.xml`, and be followed by the name of one of its cameras, as in `calibration.json:left`. The returned path
        keeps that name.

        Raises:
            ConfigError: no such config; the message lists valid names.
        """
        path = Path(name)
        # Recordings state a robot by its name, so that robots and grippers are found by names alone.
        file = path if name.endswith(_ENDINGS) and kind not in _PLACES else None
        if kind == "cameras" and (found := camera_file(name)):
            file = found[0]
        if file is not None:
            if file.is_file():
                return path
            raise ConfigError(f"{kind.removesuffix('s')} config file {file} does not exist")
        if name not in self.config_names(kind):
            name = self._prefixed(kind, name) or name
        if name not in self.config_names(kind):
            endings = _CAMERA_ENDINGS if kind == "cameras" else _ENDINGS
            hint = f"; the name of a file has to end in {' or '.join(endings)}" if path.is_file() else ""
            robots = "; or an arm and its gripper, such as yam_pro+linear_4310" if kind == "rigs" else ""
            valid = suggest(name, self.config_names(kind))
            raise ConfigError(f"unknown {kind.removesuffix('s')} {name!r}; {valid}{robots}{hint}")
        chosen = self.auto_quality if (kind, name) == AUTO else name
        return self.file(config_path_pattern(kind).replace("*", chosen))

    def _prefixed(self, kind: str, name: str) -> str | None:
        """The only config named by a number and `name` (`013_apple`), or else `kitchen_` and `name`; or None."""
        names = self.config_names(kind)
        found = [other for other in names if re.fullmatch(rf"\d[^_]*_{re.escape(name)}", other)]
        if not found and (ours := f"{_KITCHEN}{name}") in names:
            return ours
        return found[0] if len(found) == 1 else None
