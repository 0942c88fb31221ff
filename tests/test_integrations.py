"""The distributions in `integrations/`, without the programs that they plug into."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement

from yamsim_cli import __version__

REPOSITORY = Path(__file__).resolve().parents[1]
DISTRIBUTIONS = sorted(path.parent for path in (REPOSITORY / "integrations").glob("*/pyproject.toml"))
NAMES = [path.name for path in DISTRIBUTIONS]


def project(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = tomllib.loads((folder / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return found


def imported(file: Path) -> Iterator[str]:
    """Absolute names of the modules that a file imports."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield str(node.module)


def test_all_are_there() -> None:
    assert NAMES == ["lerobot_env_yamsim", "lerobot_robot_yamsim", "maker_station_yamsim"]


@pytest.mark.parametrize("folder", DISTRIBUTIONS, ids=NAMES)
def test_a_distribution_is_called_as_it_is_looked_for_and_takes_this_yamsim(folder: Path) -> None:
    told = project(folder)
    # LeRobot imports the module with the distribution's name, including underscores.
    assert told["name"] == folder.name and (folder / folder.name / "__init__.py").is_file()
    (yamsim,) = (one for one in map(Requirement, told["dependencies"]) if one.name == "yamsim")
    assert yamsim.specifier.contains(__version__) and not yamsim.specifier.contains("1.0")
    assert (folder / told["readme"]).is_file() and list((folder / "tests").glob("test_*.py"))


@pytest.mark.parametrize("folder", DISTRIBUTIONS, ids=NAMES)
def test_a_distribution_uses_public_modules_alone_and_only_what_it_asks_for(folder: Path) -> None:
    asked = {re.sub("-", "_", Requirement(text).name) for text in project(folder)["dependencies"]}
    used = {name for file in (folder / folder.name).glob("*.py") for name in imported(file)}
    assert [name for name in used if re.match(r"yamsim_cli\.(core|commands|main)\b", name)] == []
    tops = {name.split(".")[0].replace("yamsim_cli", "yamsim") for name in used} - {"__future__"}
    assert tops - set(sys.stdlib_module_names) <= asked


def test_yamsim_is_without_them() -> None:
    from hatchling.builders.wheel import WheelBuilder

    files = [file.distribution_path for file in WheelBuilder(str(REPOSITORY)).recurse_included_files()]
    assert "yamsim_cli/station.py" in files
    assert [path for path in files if "integrations" in path or any(name in path for name in NAMES)] == []
    sources = (REPOSITORY / "yamsim_cli").rglob("*.py")
    assert [file for file in sources if set(imported(file)) & set(NAMES)] == []
