"""No export writes outside its folder, whatever names a dataset has."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.export.conftest import ignore
from tests.unrendered import change_record
from yamsim_cli.core.dataset.dataset_paths import EPISODE_FILE
from yamsim_cli.core.dataset.reader import open_recorded_episode
from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.export.export_source import SimulatedSource, open_source
from yamsim_cli.export.lerobot import export_lerobot
from yamsim_cli.export.raiden import export_raiden
from yamsim_cli.export.raiden_schema import RaidenOptions
from yamsim_cli.export.rrd import export_rerun
from yamsim_cli.export.videos import export_mp4, export_sheet

_AWAY = "../../../escaped"
_CAMERA = "scene_camera"

_EXPORTS: dict[str, Callable[[SimulatedSource, Path, Locations], object]] = {
    "lerobot": lambda source, out, where: export_lerobot(source, out, ignore),
    "raiden": lambda source, out, where: export_raiden(source, out, where, ignore, RaidenOptions()),
    "mp4": lambda source, out, where: export_mp4(source, out, (), ignore),
    "sheet": lambda source, out, where: export_sheet(source, out.with_suffix(".jpg"), (), ignore),
    "rerun": lambda source, out, where: export_rerun(source, out, ignore),
}


@pytest.fixture
def crafted(dataset: Path, tmp_path: Path) -> Path:
    """A dataset whose camera's name is a path, with pictures at that path."""
    path = tmp_path / "in" / "dataset"
    shutil.copytree(dataset, path)
    for directory in sorted(path.glob("ep_*")):
        record = json.loads((directory / EPISODE_FILE).read_text())
        cameras = {_AWAY if name == _CAMERA else name: size for name, size in record["cameras"].items()}
        files = {name.replace(f"rgb/{_CAMERA}/", f"rgb/{_AWAY}/"): value for name, value in record["files"].items()}
        change_record(directory, cameras=cameras, files=files)
        shutil.copytree(directory / "rgb" / _CAMERA, directory / "rgb" / _AWAY, dirs_exist_ok=True)
    return path


@pytest.mark.parametrize("name", _EXPORTS)
def test_a_camera_with_a_path_as_its_name_is_refused(
    name: str, crafted: Path, locations: Locations, tmp_path: Path
) -> None:
    there = {path for path in tmp_path.rglob("*") if path.is_file()}
    (tmp_path / "out").mkdir()
    with pytest.raises(DatasetError, match=r"episode.json: cameras\."):
        _EXPORTS[name](open_source(crafted, None, locations), tmp_path / "out" / "exported", locations)
    assert {path for path in tmp_path.rglob("*") if path.is_file()} == there


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("objects", ["banana", "../plate"]),
        ("objects", ["/etc"]),
        ("layout", {"..": [0, 0, 0, 1, 0, 0, 0]}),
        ("joints", {"a/b": ["hinge"]}),
        ("cloths", {".hidden": [2, 2]}),
        ("files", {"../../secret": "0"}),
        ("files", {"/etc/hosts": "0"}),
        ("files", {"rgb/../x": "0"}),
        ("cameras", {"top\n": [8, 8]}),
        ("cameras", {"": [8, 8]}),
    ],
)
def test_every_name_of_a_record_is_checked(dataset: Path, tmp_path: Path, key: str, value: object) -> None:
    directory = tmp_path / "ep_000000"
    shutil.copytree(dataset / "ep_000000", directory)
    open_recorded_episode(directory)
    change_record(directory, **{key: value})
    with pytest.raises(DatasetError, match=rf"episode.json: {key}\."):
        open_recorded_episode(directory)
