from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from ..errors import ConfigError, ResourceError, suggest_similar

AUTO_QUALITY = ("quality", "auto")  # kind and name of a config for which `Locations.auto_quality` is loaded instead
IMPORTED_MESH_FOLDER = (
    "imported"  # folder of the asset cache with meshes that the user imported; no lock file lists them
)
_CONFIG_SUFFIXES = (".yaml", ".yml")
_CAMERA_SUFFIXES = (*_CONFIG_SUFFIXES, ".json", ".xml")  # also of other programs
_KITCHEN_PREFIX = "kitchen_"  # prefix of the names of kitchen objects

# Asset set -> folder of its mesh files; None if scenes show primitives instead.
MeshFolders = Mapping[str, Path | None]

# Kind -> path of its configs below a data root, with `*` for the name.
_CONFIG_PATTERNS = {"robots": "robot_models/*/model.yaml", "grippers": "robot_models/grippers/*/gripper.yaml"}

_PACKAGE = Path(__file__).resolve().parents[2]


def _built_in_data_folder() -> Path:
    packaged = _PACKAGE / "_data"
    return packaged if packaged.is_dir() else _PACKAGE.parent


def config_path_pattern(kind: str) -> str:
    """Return the path pattern of configs of a kind below a data root, with `*` for the name."""
    return _CONFIG_PATTERNS.get(kind, f"configs/{kind}/*.yaml")


def split_camera_path(name: str) -> tuple[Path, str] | None:
    """Return file and camera of `FILE` or `FILE:CAMERA`, with an empty camera for `FILE`; None for other names."""
    if name.endswith(_CAMERA_SUFFIXES):
        return Path(name), ""
    file, _, camera = name.rpartition(":")
    return (Path(file), camera) if file.endswith(_CAMERA_SUFFIXES) else None


@dataclass(frozen=True)
class Locations:
    """The directories that a job may read; picklable for worker processes on any machine.

    Attributes:
        data: data roots: folders with `configs/`, `robot_models/` and `assets/`; earlier ones have priority.
        assets: the cache of fetched meshes.
        auto_quality: name of the rendering quality that `auto` stands for.
    """

    data: tuple[Path, ...]
    assets: Path
    auto_quality: str = "balanced"
    meshes: MeshFolders = field(default_factory=dict)

    @classmethod
    def from_environment(cls, environ: Mapping[str, str]) -> Locations:
        """Return the locations from `YAMSIM_DATA_DIR`, `YAMSIM_ASSETS`, `XDG_CACHE_HOME` and `HOME`; open no file."""
        roots = [Path(environ["YAMSIM_DATA_DIR"])] if environ.get("YAMSIM_DATA_DIR") else []
        if environ.get("YAMSIM_ASSETS"):
            assets = Path(environ["YAMSIM_ASSETS"])
        elif environ.get("XDG_CACHE_HOME"):
            assets = Path(environ["XDG_CACHE_HOME"]) / "yamsim" / "assets"
        else:
            assets = Path(environ.get("HOME") or "~").expanduser() / ".cache" / "yamsim" / "assets"
        return cls(data=(*roots, _built_in_data_folder()), assets=assets)

    def find_data_file(self, relative: str) -> Path:
        """Return the file at `relative` in the first data root that has it. Raises ResourceError if no root has it."""
        for root in self.data:
            if (root / relative).is_file():
                return root / relative
        raise ResourceError(
            f"{relative} not found under {', '.join(map(str, self.data))}; set YAMSIM_DATA_DIR or reinstall yamsim"
        )

    def config_names(self, kind: str) -> list[str]:
        """Return the sorted names of the configs of one kind (`rigs`, `tasks`, `robots`, ...)."""
        place = config_path_pattern(kind)
        depth = place.split("/").index("*") if kind in _CONFIG_PATTERNS else -1
        found = {path.relative_to(root).parts[depth] for root in self.data for path in root.glob(place)}
        names = {name.removesuffix(".yaml") for name in found}
        return sorted(names | {AUTO_QUALITY[1]} if kind == AUTO_QUALITY[0] else names)

    def config_file(self, kind: str, name: str) -> Path:
        """Return the file of a named config, or of a path that ends in `.yaml` or `.yml`; raise ConfigError if there is
        none.

        Names may leave out a prefix, such as `013_` of `013_apple` and `kitchen_` of `kitchen_spoon`. A camera's path
        may also end in `.json` or `.xml`, with the name of a camera after a colon: `calibration.json:left`. The
        returned path keeps it.
        """
        path = Path(name)
        # Recordings contain only the names of robots and grippers, so these are not found by paths.
        file = path if name.endswith(_CONFIG_SUFFIXES) and kind not in _CONFIG_PATTERNS else None
        if kind == "cameras" and (found := split_camera_path(name)):
            file = found[0]
        if file is not None:
            if file.is_file():
                return path
            raise ConfigError(f"{kind.removesuffix('s')} config file {file} does not exist")
        if name not in self.config_names(kind):
            name = self._find_prefixed_name(kind, name) or name
        if name not in self.config_names(kind):
            endings = _CAMERA_SUFFIXES if kind == "cameras" else _CONFIG_SUFFIXES
            hint = f"; the name of a file must end in {' or '.join(endings)}" if path.is_file() else ""
            robots = "; or an arm and its gripper, such as yam_pro+linear_4310" if kind == "rigs" else ""
            valid = suggest_similar(name, self.config_names(kind))
            raise ConfigError(f"unknown {kind.removesuffix('s')} {name!r}; {valid}{robots}{hint}")
        chosen = self.auto_quality if (kind, name) == AUTO_QUALITY else name
        return self.find_data_file(config_path_pattern(kind).replace("*", chosen))

    def _find_prefixed_name(self, kind: str, name: str) -> str | None:
        """Return the only config `<number>_<name>` (`013_apple`), or else `kitchen_<name>`."""
        names = self.config_names(kind)
        found = [other for other in names if re.fullmatch(rf"\d[^_]*_{re.escape(name)}", other)]
        if not found and (ours := f"{_KITCHEN_PREFIX}{name}") in names:
            return ours
        return found[0] if len(found) == 1 else None
