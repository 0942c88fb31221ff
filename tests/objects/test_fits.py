"""Fits to surfaces with known parameters."""

from __future__ import annotations

import numpy as np
import pytest

from yamsim_cli.core.config.objects.primitives import Box, Capsule, Cylinder, Ring, Sphere
from yamsim_cli.core.geometry.se3 import Array, rotation_z
from yamsim_cli.core.geometry.stl import encode_stl
from yamsim_cli.objects.primitive_fit import Scan, fit_solid
from yamsim_cli.objects.primitives import PointBody, signed_distance
from yamsim_cli.objects.ycb_config import ScannedObject, build_ycb_config

THING = ScannedObject("thing", 100.0, (1, 1, 1, 1), "imported", "thing.stl", "A thing")


def revolved(profile: list[tuple[float, float]], segments: int = 96) -> bytes:
    """A closed body of revolution around z, from its profile (radius, height) outwards and back to the axis."""
    angles = 2 * np.pi * np.arange(segments) / segments
    vertices = [(r * np.cos(a), r * np.sin(a), z) for r, z in profile for a in angles]
    faces = []
    for k in range(len(profile) - 1):
        for i in range(segments):
            a, b = k * segments + i, k * segments + (i + 1) % segments
            faces += [(a, a + segments, b), (b, a + segments, b + segments)]
    return encode_stl(vertices, faces)


def block(half: tuple[float, float, float], yaw: float = 0.0, at: tuple[float, float, float] = (0, 0, 0)) -> bytes:
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]
    return encode_stl(corners @ rotation_z(yaw).T + at, faces)


def ball(radius: float) -> bytes:
    angles = np.linspace(0, np.pi, 60)
    return revolved([(radius * np.sin(a), radius - radius * np.cos(a)) for a in angles])


BOWL = [(1e-5, 0.0), (0.04, 0.0), (0.08, 0.05), (0.076, 0.05), (0.037, 0.004), (1e-5, 0.004)]


@pytest.mark.parametrize(
    ("part", "outside", "inside"),
    [
        (Sphere(type="sphere", centre=(1, 0, 0), radius=0.5), (2, 0, 0), (1, 0, 0.1)),
        (Capsule(type="capsule", start=(0, 0, 0), end=(0, 0, 1), radius=0.5), (1, 0, 0.5), (0.1, 0, 0.7)),
        (Cylinder(type="cylinder", centre=(0, 0, 0), radius=1, half_height=0.5), (0, 0, 1), (0, 0, 0.1)),
        (Box(type="box", centre=(0, 0, 0), half_size=(1, 0.5, 2), yaw_deg=90), (1, 0, 0), (0.1, 0, 0)),
        (Ring(type="ring", inner=(1, 1), outer=(3, 1), thickness=0.8, segments=8), (0, 2, 1.5), (0, 2, 0.6)),
    ],
)
def test_distances_from_each_primitive(
    part: Sphere | Capsule | Cylinder | Box | Ring, outside: tuple[float, ...], inside: tuple[float, ...]
) -> None:
    found = signed_distance([part], np.array([outside, inside], dtype=float))
    assert found == pytest.approx([0.5, -0.4])


def test_a_ball_is_a_ball() -> None:
    fit = fit_solid(Scan.from_stl(ball(0.03)).points)
    assert fit.rms < 5e-4
    (part,) = fit.parts
    assert isinstance(part, Sphere)
    assert part.radius == pytest.approx(0.03, abs=5e-4)
    assert part.centre == pytest.approx((0, 0, 0.03), abs=5e-4)


def test_a_can_is_a_cylinder_that_stands_on_its_foot() -> None:
    can = revolved([(1e-5, 0.01), (0.034, 0.01), (0.034, 0.11), (1e-5, 0.11)])
    (part,) = fit_solid(Scan.from_stl(can).points).parts
    assert isinstance(part, Cylinder)
    assert (part.radius, part.half_height) == pytest.approx((0.034, 0.05), abs=3e-4)
    assert part.centre[2] - part.half_height == pytest.approx(0.01, abs=1e-4)


@pytest.mark.slow
def test_a_block_is_a_box_turned_as_it_is_and_taken_across_its_narrow_side() -> None:
    made = build_ycb_config(THING, Scan.from_stl(block((0.05, 0.02, 0.03), np.radians(30), (0.1, -0.2, 0.03))))
    (part,) = made.fit.parts
    assert isinstance(part, Box)
    assert made.data["mesh"]["origin"] == pytest.approx([0.1, -0.2, 0.03], abs=5e-4)
    grasp = made.data["grasp"]
    # Its narrow side lies along its own y.
    assert grasp["axis_deg"] == pytest.approx(120, abs=2)
    assert grasp["opening"] == pytest.approx(0.02, abs=1e-3)
    assert [point["axis_deg"] for point in grasp["friction"]["points"]] == [grasp["axis_deg"]] * 3
    assert made.data["rest_height"] == pytest.approx(0.03, abs=5e-4)


def test_inertia_is_that_of_the_primitives() -> None:
    half = np.array([0.05, 0.02, 0.03])
    part = Box(type="box", centre=(0.1, 0, 0), half_size=(0.05, 0.02, 0.03))
    body = PointBody.from_primitives([part], np.array([0.04, -0.03, -0.04]), np.array([0.16, 0.03, 0.04]))
    moments, _ = body.principal_inertia(0.3)
    square: Array = (2 * half) ** 2
    assert body.centre == pytest.approx([0.1, 0, 0], abs=2e-4)
    assert moments == pytest.approx(sorted(0.3 / 12 * (square.sum() - square)), rel=0.06)


def test_a_bowl_is_a_floor_and_rings_to_put_things_in() -> None:
    made = build_ycb_config(THING, Scan.from_stl(revolved(BOWL)))
    floor, *rings = made.fit.parts
    assert isinstance(floor, Cylinder)
    assert floor.centre[2] + floor.half_height == pytest.approx(0.004, abs=5e-4)
    assert floor.radius == pytest.approx(0.037, abs=0.002)
    assert rings
    assert all(isinstance(ring, Ring) for ring in rings)
    assert made.fit.rms < 1.2e-3
    assert made.data["preposition"] == "in"
    assert "grasp" not in made.data
    assert made.data["rest_height"] == 0.0
    # Nothing is in the hollow.
    hollow = np.array([(r, 0, z) for r, z in ((0.0, 0.02), (0.03, 0.02), (0.06, 0.045))])
    assert (signed_distance(made.fit.parts, hollow) > 0.005).all()


def test_an_upside_down_bowl_is_imported_with_a_grasp() -> None:
    over = [(r, 0.05 - z) for r, z in reversed(BOWL)]
    assert "grasp" in build_ycb_config(THING, Scan.from_stl(revolved(over))).data


def test_a_dimple_is_not_an_interior() -> None:
    dented = [(0.03 * np.sin(a), 0.03 - 0.03 * np.cos(a)) for a in np.linspace(0, np.pi * 0.85, 50)] + [(1e-5, 0.04)]
    (part,) = fit_solid(Scan.from_stl(revolved(dented)).points).parts
    assert isinstance(part, Sphere)
    assert part.radius == pytest.approx(0.03, abs=1e-3)
