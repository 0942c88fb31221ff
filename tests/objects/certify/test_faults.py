"""Each code has its fault: one changed property of an object gives exactly this code."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.objects.certify.things import SampleObject, flap, pin
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.objects.certify.certify import CHECKS, run_object_checks

BLOCK, CUP, PASTA = "kitchen_distractor", "kitchen_cup", "kitchen_penne"


def inertia(**changes: object) -> Callable[[SampleObject], None]:
    return lambda thing: thing.data["inertia"].update(changes)


def heavy(thing: SampleObject) -> None:
    weight = thing.data["inertia"]
    weight |= {"mass_g": weight["mass_g"] * 1000, "diagonal": [1000 * value for value in weight["diagonal"]]}


def in_millimetres(thing: SampleObject) -> None:
    thing.vertices = thing.vertices * 1000


def filled(thing: SampleObject) -> None:
    thing.data["collision"].append(
        {"type": "cylinder", "centre": [0.0, 0.0, 0.0515], "radius": 0.034, "half_height": 0.048}
    )


def inside_out(thing: SampleObject) -> None:
    thing.faces = thing.faces[:, ::-1]


def open_(thing: SampleObject) -> None:
    thing.faces = thing.faces[: len(thing.faces) * 9 // 10]


def jams(thing: SampleObject) -> None:
    thing.data["links"] = [flap(jams=True), pin()]


def too_large(thing: SampleObject) -> None:
    thing.data["collision"][0]["half_size"] = [0.05, 0.05, 0.04]


def lopsided(thing: SampleObject) -> None:
    thing.data["inertia"]["centre"] = [0.012, 0.0, thing.data["inertia"]["centre"][2]]


def a_hundredth_of_its_inertia(thing: SampleObject) -> None:
    thing.data["inertia"]["diagonal"] = [value / 100 for value in thing.data["inertia"]["diagonal"]]


def hardly_any_about_one_axis(thing: SampleObject) -> None:
    # As a rod: the triangle inequality holds, but not for a cube.
    _, middle, largest = sorted(thing.data["inertia"]["diagonal"])
    thing.data["inertia"]["diagonal"] = [largest / 50, middle, largest]


def soft(thing: SampleObject) -> None:
    thing.data["contact"]["push_out_s"] = 0.14


def hardly_held(thing: SampleObject) -> None:
    point = {"position": [0.0, 0.0, 0.05], "axis_deg": 0.0, "opening": 0.04}
    thing.data["grasp"] = {**point, "friction": {"force": 0.1, "points": [point]}}


def held_too_low(thing: SampleObject) -> None:
    # The pads reach 8 mm below this point, into the table under the pasta.
    point = {"position": [0.0, 0.0, 0.005], "axis_deg": 0.0, "opening": 0.005}
    thing.data["grasp"] = {**point, "friction": {"force": 15.0, "points": [point]}}


FAULTS: dict[str, list[tuple[str, Callable[[SampleObject], None]]]] = {
    "size.implausible": [(BLOCK, in_millimetres)],
    "mesh.open": [(BLOCK, open_)],
    "mesh.inverted": [(BLOCK, inside_out)],
    "mass.density": [(PASTA, heavy)],
    "mass.centre": [(BLOCK, inertia(centre=[0.0, 0.0, 0.3]))],
    "inertia.impossible": [
        (BLOCK, inertia(diagonal=[1e-4, 1e-4, 5e-4])),
        (BLOCK, inertia(diagonal=[0.5, 0.5, 0.5])),
        (BLOCK, a_hundredth_of_its_inertia),
        (BLOCK, hardly_any_about_one_axis),
    ],
    "collision.differs": [(BLOCK, too_large)],
    "rest.moves": [("kitchen_produce_item", lopsided)],
    "drop.breaks": [(BLOCK, soft)],
    "hollow.filled": [(CUP, filled)],
    "joint.jams": [(BLOCK, jams)],
    "grasp.slips": [(BLOCK, hardly_held), (PASTA, held_too_low)],
}


def found(
    name: str, spoil: Callable[[SampleObject], None], folder: Path, locations: Locations
) -> dict[str, bool | None]:
    thing = SampleObject.of(name, locations)
    spoil(thing)
    certified = run_object_checks(*thing.written(folder, locations), locations)
    return {code: outcome.ok for code, outcome in certified.outcomes.items()}


def test_every_code_has_a_fault() -> None:
    assert set(FAULTS) == set(CHECKS)


@pytest.mark.parametrize(
    ("code", "name", "spoil"),
    [(code, name, spoil) for code, faults in FAULTS.items() for name, spoil in faults],
    ids=[f"{code}-{k}" for code, faults in FAULTS.items() for k in range(len(faults))],
)
def test_a_fault_is_found_by_its_own_check_alone(
    code: str, name: str, spoil: Callable[[SampleObject], None], tmp_path: Path, locations: Locations
) -> None:
    oks = found(name, spoil, tmp_path, locations)
    assert [other for other, ok in oks.items() if ok is False] == [code]


@pytest.mark.parametrize("name", [BLOCK, CUP, "kitchen_produce_item"])
def test_all_checks_pass_without_a_fault(name: str, tmp_path: Path, locations: Locations) -> None:
    oks = found(name, lambda thing: None, tmp_path, locations)
    assert [code for code, ok in oks.items() if ok is False] == []


def test_a_flap_that_moves_freely_passes(tmp_path: Path, locations: Locations) -> None:
    oks = found(BLOCK, lambda thing: thing.data.update(links=[flap(jams=False)]), tmp_path, locations)
    assert oks["joint.jams"] is True
    assert False not in oks.values()


def test_figures_are_the_same_each_time(tmp_path: Path, locations: Locations) -> None:
    thing = SampleObject.of(BLOCK, locations)
    item, meshes = thing.written(tmp_path, locations)
    assert (
        run_object_checks(item, meshes, locations).to_json_data()
        == run_object_checks(item, meshes, locations).to_json_data()
    )


def test_without_meshes_it_says_what_was_not_checked(tmp_path: Path, locations: Locations) -> None:
    item, _ = SampleObject.of(BLOCK, locations).written(tmp_path, locations)
    certified = run_object_checks(item, {}, locations)
    assert certified.ok
    for code in ("mesh.open", "mesh.inverted", "mass.density", "collision.differs", "hollow.filled"):
        assert certified.outcomes[code].ok is None
        assert "yamsim assets fetch" in certified.outcomes[code].note
    assert np.isfinite(certified.outcomes["rest.moves"].figures["tilt_deg"])
