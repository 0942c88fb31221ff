"""Fin-ray fingers: stiffness against beam theory, grip, and meshes."""

from __future__ import annotations

from collections import Counter

import mujoco
import numpy as np
import pytest
from pydantic import ValidationError

from tests.hands import GripResult, finger, grip, hand
from tests.meshes import volume
from tests.plane_frame import PlaneFrame, bent, compliance
from yamsim_cli.core.files.writing import sha256_bytes
from yamsim_cli.core.geometry.stl import decode_stl
from yamsim_cli.core.robots.finray.finger import hinge_coupling_springs, hinge_stiffness, slip_jacobian, slip_stiffness
from yamsim_cli.core.robots.finray.finger_meshes import finger_mesh_files

# m, heights of contact: from the middle to the last rib
HELD = (0.04, 0.05, 0.06, 0.065, 0.07)


@pytest.mark.parametrize("height", HELD)
def test_the_springs_give_way_as_an_elastic_frame_does(height: float) -> None:
    far, tip, turn = PlaneFrame(finger()).pushed(height, 1.0)
    assert compliance(finger(), height) == pytest.approx(far, rel=0.07)
    angles = bent(finger(), height, 1.0)
    assert (finger().length - finger().hinge_heights) @ -angles == pytest.approx(tip, rel=0.08)
    assert angles.sum() == pytest.approx(turn, rel=0.09)


@pytest.mark.parametrize(
    "changes", [{"wall_mm": 1.6}, {"rib_mm": 0.6}, {"ribs": 5}, {"base_mm": 24}, {"length_mm": 100}]
)
def test_and_so_do_other_fingers(changes: dict[str, float]) -> None:
    other = finger(**changes)
    frame = PlaneFrame(other)
    for station in other.hinge_heights[other.segment_count // 2 : -1]:
        assert compliance(other, station) == pytest.approx(frame.pushed(station, 1.0)[0], rel=0.15)


@pytest.mark.parametrize("height", HELD)
def test_pushed_in_the_tip_turns_towards_what_pushes_and_without_its_back_wall_away(height: float) -> None:
    assert bent(finger(), height, 1.0).sum() > 0
    lever = np.maximum(height - finger().hinge_heights, 0)
    assert (-lever / hinge_stiffness(finger())).sum() < 0


def test_couplings_are_the_slips_springs() -> None:
    rows, arms = hinge_coupling_springs(finger()), slip_jacobian(finger())
    np.testing.assert_allclose(rows.T @ rows, arms.T @ slip_stiffness(finger()) @ arms, rtol=1e-9, atol=1e-12)


def pushed(height: float, force: float) -> tuple[float, float]:
    """Return how far a force pushes the left finger's front wall at a height, in physics, m, and the tip's rotation,
    rad.
    """
    spec, soft = hand("finray"), finger()
    for joint in ("left_finger", "right_finger"):
        spec.delete(spec.joint(joint))
    for what in (*spec.equalities, *spec.actuators):
        spec.delete(what)
    k = int(height / soft.rib_spacing)
    spec.body(f"left_foot_segment_{k + 1}").add_site(name="pushed", pos=(height - soft.hinge_heights[k], 0, 0))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    body, start, away = (
        model.site("pushed").bodyid[0],
        data.site("pushed").xpos.copy(),
        -data.body("left_foot").xmat[[1, 4, 7]],
    )
    for _ in range(400):
        data.qfrc_applied[:] = 0
        mujoco.mj_applyFT(model, data, force * away, np.zeros(3), data.site("pushed").xpos, body, data.qfrc_applied)
        mujoco.mj_step(model, data)
    assert np.abs(data.qvel).max() < 1e-6
    bends = [data.joint(f"left_foot_bend_{n + 1}").qpos[0] for n in range(soft.segment_count)]
    return float((data.site("pushed").xpos - start) @ away), float(np.sum(bends))


@pytest.mark.parametrize("height", [0.04, 0.065])
def test_physics_is_the_theory_where_forces_are_small_and_near_it_where_they_are_large(height: float) -> None:
    far, turned = pushed(height, 0.1)
    assert far == pytest.approx(0.1 * compliance(finger(), height), rel=0.002)
    assert turned == pytest.approx(bent(finger(), height, 0.1).sum(), rel=0.002)
    # It stiffens with deflection: the levers shorten.
    assert 0.8 < pushed(height, 15.0)[0] / (15.0 * compliance(finger(), height)) < 1.0


def cylinder(body: mujoco.MjsBody) -> None:
    """60 mm across, its axis perpendicular to the closing axis and to the fingers."""
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=(0.03, 0.05, 0), quat=(1, 1, 0, 0), mass=0.05)


def strawberry(body: mujoco.MjsBody) -> None:
    """As wide as YCB's strawberry at the grasp."""
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.0215, 0, 0), mass=0.018)


# Closes each pad of a linear_4310 onto 60 mm with 15 N: half of 2000 N/m over 15 mm.
CLOSE = 0.030 - 0.015


def test_it_touches_more_of_a_cylinder_than_rigid_pads_do() -> None:
    rigid = grip("linear_4310", cylinder, CLOSE, start=0.04)
    soft = grip("finray", cylinder, CLOSE, start=0.04)
    assert soft.area > 2 * rigid.area
    assert soft.forces[-1] < 0.75 * rigid.forces[-1]
    # With the same force, the middle of the finger wraps around more.
    wrapped = grip("finray", cylinder, 0.0, start=0.04, height=0.117)
    assert wrapped.forces[-1] == pytest.approx(rigid.forces[-1], rel=0.15)
    assert wrapped.area > 3.5 * rigid.area


@pytest.fixture(scope="module")
def berries() -> tuple[GripResult, GripResult]:
    rigid, soft = (grip(name, strawberry, 0.0, start=0.0375) for name in ("linear_4310", "finray"))
    return rigid, soft


def test_told_to_close_it_presses_softer_on_a_strawberry_at_its_worst_too(
    berries: tuple[GripResult, GripResult],
) -> None:
    rigid, soft = berries
    assert soft.forces[-1] < 0.75 * rigid.forces[-1]
    assert soft.forces.max() < 0.75 * rigid.forces.max()


def test_at_15_newtons_it_stands_still() -> None:
    """On an object of 50 mm, with a command for at least 15 N per finger."""
    held = grip("finray", strawberry, -0.012, start=0.0375)
    assert held.forces[-1] > 15
    # In the second half of the time.
    assert np.ptp(held.forces[250:]) < 0.2
    assert np.abs(held.data.qvel).max() < 0.01


def test_meshes_are_closed_and_look_outwards() -> None:
    for name, data in finger_mesh_files(finger()).items():
        vertices, faces = decode_stl(data)
        edges = Counter((int(face[k]), int(face[(k + 1) % 3])) for face in faces for k in range(3))
        assert all(count == 1 and edges[b, a] == 1 for (a, b), count in edges.items()), name
        assert volume((vertices, faces)) > 0, name


def test_meshes_fill_what_the_boxes_weigh() -> None:
    """Walls that overlap at the stations count twice in the meshes."""
    model = hand("finray").compile()
    weighed = model.body_subtreemass[model.body("left_foot").id] / finger().density_kg_m3
    filled = sum(volume(decode_stl(data)) for data in finger_mesh_files(finger()).values())
    overlapping = (2 * finger().segment_count - 2) * 0.0025 * finger().wall_thickness * finger().width
    assert filled - overlapping == pytest.approx(weighed, rel=0.1)


def test_the_same_figures_give_the_same_bytes_and_others_others() -> None:
    files = b"".join(finger_mesh_files(finger()).values())
    assert sha256_bytes(files) == "874b11b34241e48d26721dfffb2abb01b80c3001fc87fab528e34219ef9b0eac"
    assert finger_mesh_files(finger()) != finger_mesh_files(finger(wall_mm=2.2))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tip_mm": 40}, "narrower than the base"),
        ({"tip_mm": 3}, "wider than two walls"),
        ({"rib_mm": 6}, "too thick for 7 ribs"),
        ({"length_mm": 0.08}, "is it in m"),
    ],
)
def test_impossible_finger_sizes_are_refused(changes: dict[str, float], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        finger(**changes)
