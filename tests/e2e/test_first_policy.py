"""The page on policies: its policy picks the banana as written, and fails as the page says."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from tests.cli.run_cli import yamsim
from tests.pages import DOCS, blocks

PAGE = DOCS / "first-policy.md"
TEXT = PAGE.read_text(encoding="utf-8")
(POLICY,) = (block.text for block in blocks(TEXT) if block.language == "python")
SHOWN, RAISED = (block.text for block in blocks(TEXT) if block.language == "")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The user's folder, with the policy saved as on the page."""
    (tmp_path / "first_policy.py").write_text(POLICY)
    return tmp_path


def test_it_is_as_short_as_it_says() -> None:
    lines = [line for line in POLICY.splitlines() if line.strip() and not line.strip().startswith("#")]
    assert len(lines) <= 30


def test_its_policy_picks_the_banana(folder: Path) -> None:
    (line,) = (line for block in blocks(TEXT) if block.language == "sh" for line in block.commands)
    name, *words = shlex.split(line)
    assert (name, words[words.index("--n") + 1]) == ("yamsim", "100")
    words[words.index("--n") + 1] = "2"
    run = yamsim(*words, "--min-success", "1", "--json", cwd=folder)
    assert run.code == 0, run.err
    assert (run.json["stats"]["n_success"], run.json["stats"]["ended"]) == (2, {"success": 2})


def test_what_it_shows_has_the_form_of_what_comes(folder: Path) -> None:
    """The output has the form of the page, apart from the counts."""
    run = yamsim("eval", "--policy", "first_policy.py", "--n", "1", "--workers", "1", cwd=folder)
    for shown, came in zip(SHOWN.splitlines()[:6], run.out.splitlines(), strict=False):
        assert re.sub(r"[\d.]+", "0", shown) == re.sub(r"[\d.]+", "0", came)


def test_its_mistake_is_told_as_it_says(folder: Path) -> None:
    mistake, instead = "self.arm.ik(T_pinch[:3], joints)", "self.arm.ik(T_pinch, joints, rotation_tolerance=0.6)"
    assert f"write `{mistake}`" in TEXT
    assert instead in POLICY
    (folder / "first_policy.py").write_text(POLICY.replace(instead, mistake))
    run = yamsim("eval", "--policy", "first_policy.py", "--n", "1", "--workers", "1", cwd=folder)
    assert run.code == 6
    assert RAISED in run.out
    assert run.err.splitlines()[-1].startswith("yamsim: no trial of first_policy.py was completed (policy_raised 1)")
