from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.run_cli import yamsim


@pytest.mark.render
def test_every_check_has_a_name_and_a_health(tmp_path: Path) -> None:
    run = yamsim("doctor", "--out", tmp_path / "d", "--json", fresh=True)
    assert run.code == 0, run.err
    assert run.json["ok"] is True
    assert {check["health"] for check in run.json["checks"]} <= {"ok", "warning"}
    assert list(tmp_path.iterdir()) == []


def test_a_fault_is_printed_with_its_fix_and_exits_with_4(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "nonsense")
    run = yamsim("doctor", "--out", tmp_path / "d")
    assert run.code == 4
    assert run.err.startswith("yamsim: gl: MUJOCO_GL=nonsense is set but does not work")
    assert [line.split()[0] for line in run.out.splitlines()].count("fault") == 1
    assert "  -> unset MUJOCO_GL" in run.out


def test_version_tells_what_else_matters() -> None:
    run = yamsim("--version")
    first, second = run.out.splitlines()
    assert first.startswith("yamsim ")
    assert "Python 3" in second
    assert "mujoco " in second
