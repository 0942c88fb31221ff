"""`--offline`, and messages without a network."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.cli.run_cli import yamsim

COMMANDS = Path(__file__).resolve().parents[2] / "yamsim_cli/commands"


def test_every_command_that_shows_meshes_can_stay_offline() -> None:
    sources = {path.stem: path.read_text() for path in COMMANDS.glob("*.py")}
    fetches = re.compile(r"opener\.(open|with_scene_meshes|with_mesh_folders)\(")
    shows = {name for name, text in sources.items() if fetches.search(text)}
    assert len(shows) >= 15
    assert {name for name in shows if not re.search(r"offline: (flags\.)?Offline = False", sources[name])} == set()


@pytest.mark.parametrize("how", ["flag", "variable"])
def test_offline_fetches_nothing(tmp_path: Path, how: str) -> None:
    env = {"YAMSIM_ASSETS": str(tmp_path / "new"), "YAMSIM_OFFLINE": "0" if how == "flag" else "1"}
    flag = ["--offline"] if how == "flag" else []
    run = yamsim("compose-xml", "--out", tmp_path / "scene.xml", *flag, env=env)
    assert run.code == 0
    lines = run.err.splitlines()
    assert "so primitives are shown: run `yamsim assets fetch`" in lines[0]
    assert lines[-1] == lines[0] and len(lines) > 1, "said at the start and at the end"
    assert not (tmp_path / "new").exists()
