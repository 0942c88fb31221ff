"""The tested recipe equals that of the page."""

from __future__ import annotations

import shlex
from pathlib import Path

import yaml

from tests import training_recipe as recipe
from tests.pages import DOCS, blocks


def shown() -> list[list[str]]:
    """Words of the page's command lines, without programs."""
    text = (DOCS / "training.md").read_text(encoding="utf-8")
    (block,) = [
        block for block in blocks(text) if block.section == "Record, export, train, evaluate" and block.language == "sh"
    ]
    return [shlex.split(line) for line in block.commands]


def flags(words: list[str]) -> set[tuple[str, ...]]:
    """Each flag with its value, in any order."""
    parts = " ".join(words).split(" --")
    return {tuple(part.rstrip("/").split()) for part in parts}


def test_the_page_shows_the_recipe(tmp_path: Path) -> None:
    record, export, train, evaluate = shown()
    kind = recipe.KINDS["weld"]
    assert flags(record[1:]) == flags(recipe.record(kind, 200, Path("demos")))
    # All of them are exported.
    tried = recipe.export(Path("demos/"), Path("demos_lerobot/"), 200)
    assert [word.rstrip("/") for word in export[1:]] == tried[: tried.index("--episodes")]
    assert flags(evaluate[1:]) == flags(recipe.evaluate(kind, Path("trained")))

    config = yaml.safe_load(recipe.write_config(tmp_path / "act_states.yaml").read_text())
    given = recipe.train(Path("act_states.yaml"), Path(config["dataset"]["root"]), Path(config["output_dir"]))
    assert train[-1] == given[0]
    assert given[1:] == ["--dataset.root=demos_lerobot", "--output_dir=trained"]
