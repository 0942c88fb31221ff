"""The recipe from images of docs/training.md in miniature: its commands with one demonstration and a short training."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.pages import DOCS, blocks

pytestmark = [pytest.mark.render, pytest.mark.slow]

# Pattern -> replacement, in the page's lines. The trial starts as the demonstration, since one demonstration teaches no
# other start. 200 steps take 10 s of a core with images of this size.
SMALLER = {
    r"--n \d+": "--n 1",
    r"--seed \d+": "--seed 0",
    r"--workers 2": "--workers 1",
    r"128x96": "64x48",
    r"(picture_policy\.pt)$": r"\1 --steps 200",
}


def commands() -> list[str]:
    text = (DOCS / "training.md").read_text(encoding="utf-8")
    (found,) = [block for block in blocks(text) if block.section == "Train from images" and block.language == "sh"]
    return found.commands


def test_one_demonstration_is_learnt_from_images_and_done_again(repository: Path, tmp_path: Path) -> None:
    pytest.importorskip("torch", reason="PyTorch is not installed: pip install torch")
    record, train, evaluate = commands()
    report: dict[str, object] = {}
    for line in (record, train, f"{evaluate} --json"):
        for pattern, smaller in SMALLER.items():
            line = re.sub(pattern, smaller, line)
        program, *words = shlex.split(line.replace("tools/picture_policy.py", f"{repository}/tools/picture_policy.py"))
        run = subprocess.run(
            [sys.executable, *(["-m", "yamsim_cli"] if program == "yamsim" else []), *words],
            cwd=tmp_path,
            env={**os.environ, "PYTHONPATH": str(repository), "OMP_NUM_THREADS": "1"},
            capture_output=True,
            text=True,
            check=False,
        )
        assert run.returncode == 0, f"{line}:\n{run.stdout[-2000:]}\n{run.stderr[-2000:]}"
        if program != "yamsim":
            losses = [float(loss) for loss in re.findall(r"loss (\S+),", run.stdout)]
            assert losses[-1] < 0.5 * losses[0]
        elif words[0] == "eval":
            report = json.loads(run.stdout)
    assert isinstance(report["stats"], dict) and isinstance(report["settings"], dict)
    assert (report["stats"]["n"], report["stats"]["n_success"]) == (1, 1)
    assert (report["settings"]["size_px"], report["settings"]["quality"]) == ([64, 48], "fast")
    assert report["settings"]["trained_on"]["differences"] == {}


def test_a_batch_has_windows_of_several_datasets() -> None:
    pytest.importorskip("torch", reason="PyTorch is not installed: pip install torch")
    from tools.picture_policy import windows_at

    class Windows:
        def __init__(self, count: int, first: int) -> None:
            self.values = np.arange(first, first + count)

        def __len__(self) -> int:
            return len(self.values)

        def __getitem__(self, rows: np.ndarray) -> dict[str, np.ndarray]:
            return {"value": self.values[rows]}

    datasets: Any = [Windows(3, 10), Windows(2, 20), Windows(4, 30)]
    assert windows_at(datasets, np.array([8, 3, 2, 0]))["value"].tolist() == [12, 10, 20, 33]
    assert windows_at(datasets, np.array([5, 4]))["value"].tolist() == [21, 30]
