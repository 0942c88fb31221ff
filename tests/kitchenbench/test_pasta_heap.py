"""The bench of loose pasta measures slopes and densities that are known."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np
import pytest

pytest.importorskip("inspect_robots", reason="needs yamsim[inspect]")
pytest.importorskip("kitchenbench", reason="needs yamsim[inspect]")

from tools.bench import pasta_heap as bench
from tools.bench.heap_shape import heap_profile, pieces_below, slope_of
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.objects.object_config import ObjectConfig
from yamsim_cli.core.config.program_task import ProgramTask
from yamsim_cli.core.config.task_objects import Filling, Role


def filled(vessel: str, base: Any, pieces: int) -> ProgramTask:
    outer, piece = (
        load_config(ObjectConfig, "objects", f"kitchen_{name}", base.locations) for name in (vessel, "penne")
    )
    filling = Filling(of=piece, grams=pieces * piece.inertia.mass_g)
    task: ProgramTask = base.config.task.model_copy(update={"things": {"vessel": Role(of=(outer,), filled=filling)}})
    return task


@pytest.mark.parametrize("degrees", [10.0, 25.0, 40.0])
@pytest.mark.parametrize("height", [0.02, 0.05])  # m; flat cones reach the edge of the measured circle
def test_the_slope_of_a_cone(degrees: float, height: float) -> None:
    spec, step = mujoco.MjSpec(), 0.0005
    for low in np.arange(0.0, height, step):
        radius = (height - low - step / 2) / math.tan(math.radians(degrees))
        size, middle = [radius, step / 2, 0], [0.3, -0.2, low + step / 2]
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=size, pos=middle)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    radii, heights = heap_profile(model, data, np.array([0.3, -0.2]), 0.07)
    assert heights.max() == pytest.approx(height, abs=2 * step)
    assert slope_of(radii, heights) == pytest.approx(degrees, abs=1.0)


@pytest.mark.parametrize("upright", [True, False])
def test_pieces_below_a_level_in_a_box(upright: bool) -> None:
    """Three layers of 25 capsules, up to the top of the second layer and to the middle of the third one."""
    radius, half = 0.005, 0.02
    tall = 2 * (radius + half) if upright else 2 * radius
    axis = half * np.array([0.0, 0.0, 1.0] if upright else [0.6, 0.8, 0.0])
    places = [(x, y, tall * (k + 0.5)) for x in range(5) for y in range(5) for k in range(3)]
    ends = np.array([(place - axis, place + axis) for place in places])
    assert pieces_below(2 * tall, ends, radius) == pytest.approx(50)
    assert pieces_below(2.5 * tall, ends, radius) == pytest.approx(62.5, abs=0.3)


def test_a_few_pieces_in_the_cylinder(base: Any) -> None:
    heap = bench.measure_heap(filled("pot", base, 60), seed=0)
    assert heap.solid == pytest.approx(0.5, abs=0.08)
    # A penne of 1.34 g has the outline of a capsule of 2.9 ml.
    assert heap.density == pytest.approx(456 * heap.solid, rel=0.02)
    assert 5 < heap.angle < 45


def test_pieces_leave_an_open_carton_that_points_down(base: Any) -> None:
    task = filled("food_container", base, 4)
    rate, share = bench.measure_flow(task, seed=0, tilt_deg=170.0, towards=0)
    assert share == 1.0 and rate > 10  # g/s
    assert bench.measure_flow(task, seed=0, tilt_deg=20.0, towards=0)[1] == 0.0
