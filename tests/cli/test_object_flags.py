"""`--object`, `--target`, and `assets import`, as a user types them."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.run_cli import yamsim
from tests.objects.test_fits import block


@pytest.mark.slow
def test_an_apple_goes_into_a_bowl() -> None:
    run = yamsim("pickplace", "batch", "--n", "2", "--object", "013_apple", "--target", "024_bowl", "--json")
    assert run.code == 0
    assert run.json["n_success"] == 2
    assert set(run.json["trials"][0]["layout"]) == {"apple", "bowl"}


@pytest.mark.parametrize("command", [("record", "--n", "1"), ("pickplace", "batch", "--n", "1")])
def test_an_unknown_object_is_one_line_that_lists_those_there_are(command: tuple[str, ...], tmp_path: Path) -> None:
    run = yamsim(*command, "--object", "013_aple", cwd=tmp_path)
    assert run.code == 3
    assert run.message.startswith(
        "--object: task.things.object.of: unknown object '013_aple'; did you mean '013_apple'? valid: 005_tomato"
    )
    assert not list(tmp_path.iterdir())


def test_what_is_too_wide_is_told() -> None:
    run = yamsim("pickplace", "batch", "--n", "1", "--object", "054_softball")
    assert run.code in (2, 3)
    assert "object 'softball' is too wide to be picked up: 95 mm" in run.message
    assert "opens 75 mm" in run.message


@pytest.mark.slow
def test_an_imported_stl_can_be_picked_up(tmp_path: Path) -> None:
    (tmp_path / "drawn.stl").write_bytes(block((0.05, 0.02, 0.03)))
    env = {"YAMSIM_DATA_DIR": str(tmp_path / "mine"), "YAMSIM_ASSETS": str(tmp_path / "assets")}
    run = yamsim("assets", "import", tmp_path / "drawn.stl", "--name", "brick", "--mass", "0.1", "--json", env=env)
    assert run.code == 0, run.err
    (item,) = run.json["items"]
    assert (item["name"], item["collision"]["kind"], item["collision"]["parts"]) == ("brick", "primitives", 1)
    assert item["width_mm"] == pytest.approx(40, abs=2)
    run = yamsim("pickplace", "batch", "--n", "1", "--object", "brick", "--target", "bowl", "--json", env=env)
    assert run.code == 0, run.err
    assert run.json["n"] == 1


def test_an_import_asks_for_what_it_needs(tmp_path: Path) -> None:
    run = yamsim("assets", "import", "mug.stl", "--out", "mug.yaml", cwd=tmp_path)
    assert run.code == 4 and run.message.startswith("mug.stl: ") and run.message.endswith("[missing]")
    run = yamsim("assets", "import", "013_apple", "--name", "apple", "--out", tmp_path / "apple.yaml")
    assert run.code == 2
