"""Loose pieces in hollow objects: their number and mass, their places, and that they stay in a shaken vessel."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from tests.programs import changed, session_of
from tests.shaken_vessel import VESSEL, filled_task, shake
from yamsim_cli.core.errors import UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import pose_from_quat
from yamsim_cli.core.scene.blueprint import task_blueprint
from yamsim_cli.loose_pieces import loose_pieces, stacked_poses
from yamsim_cli.viewers.show.compose import compose_at_home, first_attempt_start, write_scene

PASTA = "kitchen_dry_pasta"


def ends_of_pieces(task: Any) -> tuple[np.ndarray, float]:
    """Return the ends (n, 2, 3) of the pieces' axes in the vessel's frame, and their radius, m."""
    part: Any = loose_pieces(task)[VESSEL][0].collision[0]
    ends = np.array([part.start, part.end])
    poses = [pose_from_quat(row[:3], row[3:]) for row in stacked_poses(task, VESSEL)]
    return np.array([ends @ T[:3, :3].T + T[:3, 3] for T in poses]), part.radius


def test_pieces_have_the_mass_that_is_asked_for(locations: Locations) -> None:
    pieces = loose_pieces(filled_task("kitchen_bowl", PASTA, 100.0, locations))[VESSEL]
    assert len(pieces) == 29  # of 3.5 g
    assert sum(piece.inertia.mass_g for piece in pieces) == pytest.approx(100.0)
    assert [piece.name for piece in pieces[:2]] == ["vessel_piece_1", "vessel_piece_2"]


def test_too_many_pieces_become_fewer_and_larger(locations: Locations) -> None:
    task = filled_task("kitchen_bowl", PASTA, 280.0, locations, max_pieces=10)
    pieces: Any = loose_pieces(task)[VESSEL]
    single: Any = task.things[VESSEL].filled
    assert len(pieces) == 10
    assert sum(piece.inertia.mass_g for piece in pieces) == pytest.approx(280.0)
    assert pieces[0].collision[0].radius / single.of.collision[0].radius == pytest.approx(2.0, rel=0.01)


def test_pieces_lie_within_a_length_from_the_end_of_a_container(locations: Locations) -> None:
    task = filled_task("kitchen_container", PASTA, 60.0, locations)
    role = task.things[VESSEL]
    assert role.filled is not None
    filling = role.filled.model_copy(update={"length_mm": 50.0})
    short: Any = task.model_copy(update={"things": {VESSEL: role.model_copy(update={"filled": filling})}})
    (ends, radius), (all_ends, _) = ends_of_pieces(short), ends_of_pieces(task)
    shape: Any = task.objects[0].shape
    end = -shape.size_mm[1] / 2000
    assert end < ends[..., 1].min() - radius < ends[..., 1].max() + radius < end + 0.05 + shape.wall_mm / 1000
    assert all_ends[..., 1].max() > end + 0.07
    round_role = (
        filled_task("kitchen_bowl", PASTA, 60.0, locations).things[VESSEL].model_copy(update={"filled": filling})
    )
    with pytest.raises(UsageError, match="is round, so `length_mm` does not apply"):
        stacked_poses(task.model_copy(update={"things": {VESSEL: round_role}}), VESSEL)


@pytest.mark.parametrize(
    ("vessel", "grams"),
    [
        ("kitchen_measuring_cup", 150.0),
        ("kitchen_measuring_cup", 200.0),
        ("kitchen_bowl", 150.0),
        ("kitchen_container", 180.0),
    ],
)
def test_stacked_pieces_do_not_touch(vessel: str, grams: float, locations: Locations) -> None:
    ends, radius = ends_of_pieces(filled_task(vessel, PASTA, grams, locations))
    along = ends[0, 1] - ends[0, 0]
    assert np.abs(np.diff(ends, axis=1) - along).max() < 1e-9  # all are parallel
    for k, (start, _) in enumerate(ends):
        others = np.delete(ends[:, 0], k, axis=0) - start
        share = np.clip(others @ along / (along @ along), -1.0, 1.0)
        assert np.linalg.norm(others - share[:, None] * along, axis=1).min() > 2 * radius


@pytest.mark.parametrize(
    ("vessel", "piece", "grams", "says"),
    [
        ("kitchen_cup", PASTA, 900.0, "the vessel holds about .* g of 900 g; give less in `filled.grams`"),
        ("kitchen_distractor", PASTA, 50.0, "the vessel cannot be `filled`; fill an object whose `shape` is a deep"),
        (
            "kitchen_bowl",
            "kitchen_fork",
            50.0,
            "the fork cannot be a piece in `filled`; give an object with one capsule",
        ),
    ],
)
def test_unsuitable_fillings_are_refused(
    vessel: str, piece: str, grams: float, says: str, locations: Locations
) -> None:
    with pytest.raises(UsageError, match=says):
        stacked_poses(filled_task(vessel, piece, grams, locations), VESSEL)


def test_nothing_leaves_a_shaken_cup(locations: Locations) -> None:
    # One realization of a chaotic motion; `tools.bench.shaken_vessels` shakes 24.
    one = shake(filled_task("kitchen_measuring_cup", PASTA, 60.0, locations), seed=0, seconds=1.0)
    assert one.pieces == 17
    assert (one.fell_out, one.leaked) == (0, 0)
    assert one.wall_depth < 0.002  # of a radius of 4 mm


def test_an_unfilled_role_is_recorded_without_the_key(locations: Locations) -> None:
    task = filled_task("kitchen_cup", PASTA, 50.0, locations)
    assert "filled" in task.model_dump(mode="json")["things"][VESSEL]
    emptied = task.things[VESSEL].model_copy(update={"filled": None})
    assert "filled" not in emptied.model_dump(mode="json")


@pytest.mark.slow
def test_a_composed_scene_has_its_pieces_at_rest_in_the_cup(tmp_path: Path) -> None:
    changes: dict[tuple[str, ...], Any] = {
        ("things", "cube"): {"of": "kitchen_measuring_cup", "filled": {"of": PASTA, "grams": 40}},
        ("expert",): [{"pick": {"thing": "cube"}}],
    }
    session = session_of(tmp_path, changed(changes))
    config, home = first_attempt_start(session)
    spec, model = compose_at_home(task_blueprint(config), session.locations, home)
    write_scene(spec, model, tmp_path / "scene", as_zip=False, overwrite=False)
    read = mujoco.MjModel.from_xml_path(str(tmp_path / "scene" / "scene.xml"))
    data = mujoco.MjData(read)
    mujoco.mj_resetDataKeyframe(read, data, 0)
    mujoco.mj_forward(read, data)
    bodies = [k for k in range(read.nbody) if read.body(k).name.startswith("cube_piece_")]
    before, cup = data.xipos[bodies].copy(), data.body("cube").xpos.copy()
    assert len(bodies) == 11
    assert 1000 * read.body_mass[bodies].sum() == pytest.approx(40.0)
    assert np.linalg.norm((before - cup)[:, :2], axis=1).max() < 0.039  # m, the cup's radius
    mujoco.mj_step(read, data, 100)
    assert np.abs(data.xipos[bodies] - before).max() < 0.005
