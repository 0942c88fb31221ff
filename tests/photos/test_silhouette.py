"""Outlines, edges beside them, and the motion from one to the other."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from yamsim_cli.core.geometry.se3 import pose, rotation_from_vector
from yamsim_cli.photos.edge_alignment import (
    DEFAULT_SEARCH_DISTANCE,
    PoseCorrection,
    edge_equations,
    edge_offsets,
    grain_px,
    mask_outline,
    search_distances,
    solve_correction,
)

CENTRE, RADIUS = (160.0, 120.0), 60.0
K = np.array([[500.0, 0, 160], [0, 500, 120], [0, 0, 1]])


def disk(
    centre: tuple[float, float] = CENTRE, radius: float = RADIUS, shape: tuple[int, int] = (240, 320)
) -> np.ndarray:
    """A grey disk on a lighter ground with a blurred edge at half brightness."""
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    inside = np.clip(radius - np.hypot(columns - centre[0], rows - centre[1]) + 0.5, 0, 1)
    return cv2.GaussianBlur((180 - 120 * inside).astype(np.float32), (0, 0), 0.7).astype(np.uint8)


def mask(
    centre: tuple[float, float] = CENTRE, radius: float = RADIUS, shape: tuple[int, int] = (240, 320)
) -> np.ndarray:
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    return np.hypot(columns - centre[0], rows - centre[1]) < radius


def test_an_outline_runs_along_the_edge_and_its_normals_point_out() -> None:
    line = mask_outline(mask())
    assert len(line.points) > 80
    from_centre = line.points - CENTRE
    radii = np.linalg.norm(from_centre, axis=1)
    assert np.abs(radii - RADIUS).max() < 0.8
    assert (line.normals * from_centre).sum(axis=1) / radii == pytest.approx(1.0, abs=0.02)


def test_holes_have_outlines_and_the_border_of_the_picture_has_none() -> None:
    ring = mask() & ~mask(radius=20)
    assert len(mask_outline(ring).points) > len(mask_outline(mask()).points) + 20
    at_border = mask_outline(mask(centre=(0.0, 120.0)))
    assert (at_border.points[:, 0] > 2).all()
    assert len(mask_outline(np.zeros((50, 50), bool)).points) == 0


def test_the_outline_against_what_lies_in_front_is_left_out() -> None:
    front = np.zeros((240, 320), bool)
    front[:, 165:] = True
    line = mask_outline(mask() & ~front, front)
    assert line.points[:, 0].max() < 164


@pytest.mark.parametrize("offset", [-3.0, -0.7, 0.0, 0.3, 2.4])
def test_edges_are_found_to_a_fraction_of_a_pixel(offset: float) -> None:
    found = edge_offsets(disk(radius=RADIUS + offset), mask_outline(mask()))
    assert np.isfinite(found.offsets).mean() > 0.99
    assert np.nanmean(found.offsets) == pytest.approx(offset, abs=0.12)
    assert found.median_distance == pytest.approx(abs(offset), abs=0.3)


def test_what_has_no_edge_counts_as_far() -> None:
    nothing = edge_offsets(np.full((240, 320), 100, np.uint8), mask_outline(mask()))
    assert np.isnan(nothing.offsets).all() and nothing.median_distance == DEFAULT_SEARCH_DISTANCE
    faint = edge_offsets((disk() // 40) + 100, mask_outline(mask()))
    assert np.isnan(faint.offsets).all()
    assert edge_offsets(disk(), mask_outline(np.zeros((240, 320), bool))).median_distance is None


def test_large_photos_are_looked_at_in_larger_grains() -> None:
    """The same picture at four times the size has four times the offset, and stays within reach."""
    assert [grain_px((480, 640)), grain_px((720, 1280, 3)), grain_px((3000, 4000))] == [1, 1, 4]
    shape = (2400, 3200)
    line = mask_outline(mask((1600.0, 1200.0), 600.0, shape))
    off = edge_offsets(disk((1600.0, 1200.0), 620.0, shape), line)
    assert off.search_distance == 3 * DEFAULT_SEARCH_DISTANCE
    assert np.nanmean(off.offsets) == pytest.approx(20.0, abs=0.5)


def test_a_flat_disk_is_pulled_back_onto_its_picture() -> None:
    """Seen straight on from 1 m with 500 px, 6 px to the side is 12 mm; directions without information stay."""
    photo = disk((166.0, 116.0))
    T = pose((0, 0, 1.0))
    so_far = np.zeros(6)
    # A disk's rotation hardly shows; left free, it would compensate some of the shift.
    weak = np.diag([1e6] * 3 + [10.0] * 3)
    for reach in search_distances():
        centre = (160 + 500 * T[0, 3] / T[2, 3], 120 + 500 * T[1, 3] / T[2, 3])
        line = mask_outline(mask(centre, RADIUS / T[2, 3]))
        offsets = edge_offsets(photo, line, reach).offsets
        part = edge_equations(line, np.full(len(line.points), T[2, 3]), offsets, K, T[:3, 3].copy())
        move = solve_correction([part], T[:3, 3].copy(), weak, so_far)
        T, so_far = move.apply_to_pose(T), so_far + move.step
    assert T[:2, 3] == pytest.approx((0.012, -0.008), abs=0.0008)
    assert T[2, 3] == pytest.approx(1.0, abs=0.005)


def test_what_the_boards_know_is_not_given_up() -> None:
    line = mask_outline(mask())
    offsets = edge_offsets(disk((164.0, 120.0)), line).offsets
    part = edge_equations(line, np.ones(len(line.points)), offsets, K, np.array([0, 0, 1.0]))
    sure = np.diag([1e8] * 3 + [1e10] * 3)
    assert np.linalg.norm(solve_correction([part], np.array([0, 0, 1.0]), sure, np.zeros(6)).step) < 1e-5
    # The correction brings it back.
    back = solve_correction([part], np.array([0, 0, 1.0]), sure, np.array([0, 0, 0, 0.01, 0, 0])).step
    assert back[3] == pytest.approx(-0.01, abs=1e-4)


def test_outlines_that_move_together_are_weighed_together() -> None:
    line = mask_outline(mask())
    centre = np.array([0, 0, 1.0])
    parts = [
        edge_equations(
            line, np.ones(len(line.points)), edge_offsets(disk((160.0 + dx, 120.0)), line).offsets, K, centre
        )
        for dx in (4.0, 0.0)
    ]
    weak = np.diag([1e6] * 3 + [10.0] * 3)
    alone = solve_correction(parts[:1], centre, weak, np.zeros(6)).step
    both = solve_correction(parts, centre, weak, np.zeros(6)).step
    assert alone[3] == pytest.approx(0.008, abs=0.001)
    assert both[3] == pytest.approx(0.004, abs=0.001)


def test_without_an_outline_the_pose_stays() -> None:
    nothing = edge_equations(mask_outline(np.zeros((9, 9), bool)), np.zeros(0), np.zeros(0), np.eye(3), np.zeros(3))
    assert not solve_correction([nothing], np.zeros(3), np.eye(6), np.zeros(6)).step.any()


def test_a_correction_turns_about_its_centre() -> None:
    turn = PoseCorrection(np.array([0, 0, np.pi / 2, 0, 0, 0.1]), np.array([1.0, 0, 0]))
    moved = turn.apply_to_pose(pose((1.0, 1.0, 0.0)))
    assert moved[:3, 3] == pytest.approx((0.0, 0.0, 0.1))
    assert moved[:3, :3] == pytest.approx(rotation_from_vector([0, 0, np.pi / 2]))
