"""Dishes that the expert puts into the rack."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("inspect_robots", reason="needs yamsim[inspect]")
pytest.importorskip("kitchenbench", reason="needs yamsim[inspect]")

from inspect_robots import eval as evaluate
from kitchenbench import tasks
from kitchenbench.sim import SceneBlueprint, build_blueprint

from yamsim_cli.core.skills.base import Skill
from yamsim_cli.core.skills.place import Place
from yamsim_cli.kitchenbench.catalog import thing_of
from yamsim_cli.kitchenbench.embodiment import YamsimEmbodiment
from yamsim_cli.kitchenbench.policy import YamsimExpert
from yamsim_cli.kitchenbench.programs import program_of
from yamsim_cli.kitchenbench.scene import open_base

SCENES = {scene.id: scene for scene in tasks.TASK_FACTORIES["place_in_rack"]().scenes}

Program = Callable[[SceneBlueprint], list[Skill]]

# Where the arms stand, as far as a program asks for it, m.
BASES = (np.array([0.0, 0.305]), np.array([0.0, -0.305]))


@pytest.fixture(scope="module")
def program() -> Program:
    """The program of a blueprint whose things are those of the kitchen."""
    base = open_base("64x48", images=False)

    def made(blueprint: SceneBlueprint) -> list[Skill]:
        items = {item.name: thing_of(item, blueprint.conditions, base.locations) for item in blueprint.objects}
        return program_of(blueprint, items, BASES)

    return made


@pytest.mark.parametrize(
    ("scene", "conditions", "expected_mm"),
    [
        ("cup-narrow", {"slot_index": 1, "slot_width_cm": 6}, -120.0),
        ("cup-narrow", {"slot_index": 5, "slot_width_cm": 6}, 120.0),
        # Slots of 8 cm: three of them have room, and the last is the nearest to the fifth.
        ("cup-narrow", {"slot_index": 5, "slot_width_cm": 8}, 80.0),
        # A bowl over the outermost slot would stand in the bow.
        ("bowl-tilt", {"slot_index": 3}, 35.0),
        ("bowl-tilt", {"slot_index": 1}, -35.0),
    ],
)
def test_a_dish_goes_into_the_slot_that_is_asked_for_or_the_nearest_that_fits(
    scene: str, conditions: dict[str, int], expected_mm: float, program: Program
) -> None:
    blueprint = replace(build_blueprint(SCENES[f"place-in-rack-{scene}"], 0), conditions=conditions)
    place = program(blueprint)[1]
    assert isinstance(place, Place) and place.at is not None
    assert [1000 * x for x in place.at] == pytest.approx([expected_mm, 0.0])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bowl-tilt", "wet-slippery"])
def test_a_dish_is_put_into_the_rack(name: str, tmp_path: object) -> None:
    """By the benchmark's own task, scored by its own scorer."""
    task = tasks.TASK_FACTORIES["place_in_rack"]()
    task.scenes = [scene for scene in task.scenes if scene.id == f"place-in-rack-{name}"]
    task.epochs = 1
    (log,) = evaluate(task, policy=YamsimExpert(), embodiment=YamsimEmbodiment(images=False), log_dir=str(tmp_path))
    assert log.status == "success"
    assert [scene.reduced["task_success"] for scene in log.samples] == [1.0]
