import numpy as np
import pytest

from tests.meshes import ball, box
from yamsim_cli.core.geometry.surface_distance import distances_to_surface, hausdorff_distance, sample_surface

TRIANGLE = np.array([[0.0, 0, 0], [4, 0, 0], [0, 3, 0]]), np.array([[0, 1, 2]])


@pytest.mark.parametrize(
    ("point", "distance"),
    [
        ((1, 1, 0), 0),
        ((1, 1, 2), 2),  # over the inside
        ((1, 1, -2), 2),
        ((2, -3, 0), 3),  # beside an edge
        ((-3, -4, 0), 5),  # beyond a corner
        ((4 + 3, 0, 4), 5),
        ((2 + 3, 1.5 + 4, 0), 5),  # beside the slanted edge: along its normal (3, 4) / 5
    ],
)
def test_distance_of_a_point_from_a_triangle(point, distance):
    assert distances_to_surface(np.array([point], float), TRIANGLE, 10.0) == pytest.approx([distance], abs=1e-12)


def test_a_triangle_without_area_is_its_edges():
    line = np.array([[0.0, 0, 0], [2, 0, 0], [1, 0, 0]]), np.array([[0, 1, 2]])
    np.testing.assert_allclose(distances_to_surface(np.array([[1.0, 1, 0], [3, 0, 0]]), line, 5.0), [1, 1])


def test_beyond_the_limit_is_infinitely_far():
    far = distances_to_surface(np.array([[0.0, 0, 0.9], [0, 0, 1.1]]), TRIANGLE, 1.0)
    np.testing.assert_allclose(far, [0.9, np.inf])


def test_sorting_points_into_cells_changes_nothing():
    rng = np.random.default_rng(1)
    points, surface = rng.uniform(-0.5, 1.5, (3000, 3)), box(cuts=5)
    together = distances_to_surface(points, surface, 3.0)
    alone = np.concatenate([distances_to_surface(point[None], surface, 3.0) for point in points[:200]])
    np.testing.assert_array_equal(together[:200], alone)
    # Far outside the cube, and inside it, the distance is known.
    outside = np.linalg.norm(np.maximum(np.maximum(-points, points - 1), 0), axis=1)
    within = np.minimum(points, 1 - points).min(axis=1)
    np.testing.assert_allclose(together, np.where(within > 0, within, outside), atol=1e-12)


def test_deviation_looks_from_both_sides():
    whole, without_a_side = box(cuts=4), box(cuts=4)
    faces = without_a_side[1]
    kept = ~(without_a_side[0][faces][..., 2] == 1).all(axis=1)
    holed = without_a_side[0], faces[kept]
    # The rest lies on the whole; the middle of the missing side is half an edge from the rest.
    assert hausdorff_distance(whole, whole, 1.0, 500) == pytest.approx(0, abs=1e-12)
    for pair in ((whole, holed), (holed, whole)):
        assert hausdorff_distance(*pair, 1.0, 3000) == pytest.approx(0.5, abs=0.03)


def test_deviation_of_a_shifted_body():
    vertices, faces = box(cuts=3)
    shifted = vertices + np.array([0, 0, 0.25]), faces
    assert hausdorff_distance((vertices, faces), shifted, 1.0, 1000) == pytest.approx(0.25)
    assert hausdorff_distance((vertices, faces), shifted, 0.2, 1000) == np.inf


def test_points_lie_on_the_surface_and_everywhere_on_it():
    points, _ = sample_surface(ball(rings=60), 4000, np.random.default_rng(0))
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1, atol=2e-3)
    np.testing.assert_allclose(points.mean(axis=0), 0, atol=0.05)
    np.testing.assert_allclose((points**2).mean(axis=0), 1 / 3, atol=0.02)
