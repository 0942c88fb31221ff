"""One encoder writes the JSON of all commands, with NumPy's values."""

from __future__ import annotations

import ast
import json
from pathlib import Path

import numpy as np
import pytest

import yamsim_cli
from yamsim_cli.core.files.documents.json_text import json_text
from yamsim_cli.terminal.console import print_json

PACKAGE = Path(yamsim_cli.__file__).parent


def test_numpy_values_and_paths_are_json(capsys: pytest.CaptureFixture[str]) -> None:
    print_json(
        {
            "told": np.bool_(True),
            "count": np.int64(3),
            "rad": np.float32(0.5),
            "matrix": np.eye(2),
            "deep": [{"found": np.bool_(False)}, {"x": -np.inf}],
            "not finite": (float("nan"), np.array([1.0, np.inf])),
            "file": Path("a/b.csv"),
        }
    )
    assert json.loads(capsys.readouterr().out) == {
        "told": True,
        "count": 3,
        "rad": 0.5,
        "matrix": [[1.0, 0.0], [0.0, 1.0]],
        "deep": [{"found": False}, {"x": None}],
        "not finite": [None, [1.0, None]],
        "file": "a/b.csv",
    }
    with pytest.raises(TypeError):
        json_text({"value": {1}})


@pytest.mark.parametrize("module", sorted((PACKAGE / "commands").glob("*.py")), ids=lambda path: path.stem)
def test_no_command_encodes_json_by_itself(module: Path) -> None:
    tree = ast.parse(module.read_text())
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    assert "json" not in imported
