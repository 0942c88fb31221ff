"""What is in a LeRobot dataset: file by file, and as lerobot's own loader gives it."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import numpy as np


def rows(root: Path, pattern: str) -> dict[str, list[Any]]:
    """The columns of a series of Parquet files, as lists."""
    import pyarrow.parquet as parquet

    tables = [parquet.read_table(file).to_pydict() for file in sorted(root.glob(pattern))]
    return {key: [value for table in tables for value in table[key]] for key in tables[0]}


def run_reader(python: str, root: Path, tmp_path: Path) -> dict[str, Any]:
    """What lerobot's loader gives of a dataset: feature -> values of all frames."""
    reader = Path(__file__).with_name("lerobot_reader.py")
    run = [python, str(reader), str(root), str(tmp_path / "read.npz")]
    done = subprocess.run(run, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stderr[-3000:]
    return dict(np.load(tmp_path / "read.npz"))
