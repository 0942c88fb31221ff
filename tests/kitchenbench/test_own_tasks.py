"""yamsim's tasks as tasks of Inspect Robots: which exist, their instructions, and that yamsim's goal judges."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("inspect_robots", reason="needs yamsim[inspect]")
pytest.importorskip("kitchenbench", reason="needs yamsim[inspect]")

from inspect_robots import Action, Scene
from inspect_robots import eval as evaluate
from inspect_robots.compat import check_compatibility

from yamsim_cli.core.errors import YamsimError
from yamsim_cli.kitchenbench.embodiment import JOINTS, YamsimEmbodiment
from yamsim_cli.kitchenbench.own_tasks import make_task
from yamsim_cli.kitchenbench.policy import YamsimExpert

ROOT = Path(__file__).resolve().parents[2]
ENTRY_POINTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]["inspect_robots.tasks"]


@pytest.fixture(scope="module")
def embodiment() -> Iterator[YamsimEmbodiment]:
    made = YamsimEmbodiment(images=False)
    yield made
    made.close()


def test_each_yamsim_task_is_a_benchmark_task() -> None:
    assert set(ENTRY_POINTS) == {f"yamsim/{path.stem}" for path in (ROOT / "configs" / "tasks").glob("*.yaml")}


@pytest.mark.slow
def test_what_they_ask_for_fits(embodiment: YamsimEmbodiment) -> None:
    expert = YamsimExpert()
    for name, where in ENTRY_POINTS.items():
        module, _, factory = where.partition(":")
        task = getattr(import_module(module), factory)()
        assert task.name == name
        assert check_compatibility(expert, embodiment, task).ok
        assert 30 <= task.resolve_envelope(embodiment.info.control_hz).max_steps <= 1000


@pytest.mark.slow
@pytest.mark.parametrize("name", ["set_upright", "pickplace"])
def test_the_expert_does_it_and_our_goal_says_so(name: str, embodiment: YamsimEmbodiment, tmp_path: Path) -> None:
    task = replace(make_task(name), epochs=1)
    (log,) = evaluate(task, policy=YamsimExpert(), embodiment=embodiment, log_dir=str(tmp_path))
    assert log.status == "success"
    assert [scene.reduced["success_at_end"] for scene in log.samples] == [1.0]


def test_who_holds_still_does_not(embodiment: YamsimEmbodiment) -> None:
    (scene,) = make_task("tower").scenes
    first = embodiment.reset(scene, seed=3)
    assert first.instruction in {"stack the three cubes into a tower", "build a tower of all the cubes",
                                 "put the cubes on top of each other"}  # fmt: skip
    for _ in range(6):
        step = embodiment.step(Action(first.state[JOINTS]))
        assert not step.terminated
    assert step.info["explanation"].startswith("not yet: stacked")
    again = embodiment.reset(scene, seed=3)
    np.testing.assert_equal(again.state[JOINTS], first.state[JOINTS])


def test_an_unknown_task_is_one_line(embodiment: YamsimEmbodiment) -> None:
    with pytest.raises(YamsimError, match="towers"):
        embodiment.reset(Scene("x", "do it", metadata={"benchmark": "yamsim", "task": "towers"}))
