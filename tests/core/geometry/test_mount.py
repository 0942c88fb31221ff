import collections

import numpy as np
import pytest

from yamsim_cli.core.errors import ConfigError
from yamsim_cli.core.geometry.board_mount import mount_mesh, union_of_boxes

# Source: configs/rigs/single.yaml and russet.yaml.
X, Y, Z = (2.41, 225.23), (-69.57, 30.43), (-9.41, 4.26)
CENTRE, EDGE = (175.23, -19.6, -4.1), 93.5385
MIRRORED = (-CENTRE[0], *CENTRE[1:])


def mesh(mirror):
    return mount_mesh(X, Y, Z, MIRRORED if mirror else CENTRE, (EDGE, EDGE), mirror)


def volume(vertices, faces):
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return np.einsum("ij,ij->", a, np.cross(b, c)) / 6


def heights_at(vertices, faces, x, y):
    """Intersections of the vertical line through (x, y) with the surface, from below: (z, whether the face there points
    up).
    """
    hits = []
    for a, b, c in vertices[faces]:
        weights = np.array([np.cross(q - p, np.array([x, y, 0]) - p)[2] for p, q in ((b, c), (c, a), (a, b))])
        total = weights.sum()
        if abs(total) > 1e-15 and (weights / total > 0).all():
            hits.append((float(weights @ [a[2], b[2], c[2]] / total), bool(total > 0)))
    return sorted(hits)


@pytest.mark.parametrize("mirror", [False, True])
def test_the_envelope(mirror):
    vertices, _ = mesh(mirror)
    x = (-X[1], -X[0]) if mirror else X
    assert vertices.min(axis=0) * 1000 == pytest.approx((x[0], Y[0], Z[0]), abs=0.01)
    assert vertices.max(axis=0) * 1000 == pytest.approx((x[1], Y[1], Z[1]), abs=0.01)


@pytest.mark.parametrize("mirror", [False, True])
def test_watertight_and_turned_outwards(mirror):
    vertices, faces = mesh(mirror)
    edges = collections.Counter((int(f[k]), int(f[k - 2])) for f in faces for k in range(3))
    assert set(edges.values()) == {1}
    assert all((b, a) in edges for a, b in edges)
    assert len(np.unique(vertices, axis=0)) == len(vertices) == len(np.unique(faces))
    assert len(vertices) - len(edges) // 2 + len(faces) == 2  # Euler: one piece, no holes.
    # The real one has 91.5 cm3.
    assert volume(vertices, faces) * 1e6 == pytest.approx(91.5, rel=0.1)


@pytest.mark.parametrize("mirror", [False, True])
def test_the_board_lies_on_the_plate_and_nothing_stands_above_it(mirror):
    vertices, faces = mesh(mirror)
    centre = np.array(MIRRORED if mirror else CENTRE)
    for dx, dy in np.random.default_rng(1).uniform(-EDGE / 2, EDGE / 2, (60, 2)):
        top = heights_at(vertices, faces, (centre[0] + dx) / 1000, (centre[1] + dy) / 1000)[-1][0] * 1000
        assert centre[2] - 0.2 < top < centre[2]


@pytest.mark.parametrize("mirror", [False, True])
def test_nothing_hides_the_board_from_20_degrees_up(mirror):
    vertices, _ = mesh(mirror)
    centre = np.array(MIRRORED if mirror else CENTRE)
    above = vertices[vertices[:, 2] * 1000 > CENTRE[2]] * 1000 - centre
    distance = np.linalg.norm(np.maximum(np.abs(above[:, :2]) - EDGE / 2, 0), axis=1)
    assert np.rad2deg(np.arctan2(above[:, 2], distance)).max() < 20


@pytest.mark.parametrize(
    ("centre", "mirror"), [(MIRRORED, False), (CENTRE, True), ((175.23, 0, -4.1), False), ((175.23, -19.6, 9), False)]
)
def test_a_board_beside_its_mount_is_an_error(centre, mirror):
    with pytest.raises(ConfigError, match="does not lie on its mount"):
        mount_mesh(X, Y, Z, centre, (EDGE, EDGE), mirror)


def test_an_outline_without_a_tongue_is_a_plate():
    vertices, faces = mount_mesh((125.23, 225.23), Y, Z, CENTRE, (EDGE, EDGE))
    assert volume(vertices, faces) * 1e9 == pytest.approx(100 * 100 * (9.41 - 4.2), rel=1e-3)


def test_figures_of_another_mount_never_put_the_tongue_over_the_board():
    vertices, faces = mount_mesh((2.41, 150.0), Y, Z, (95.0, -19.6, -4.1), (EDGE, EDGE))
    for x, y in np.random.default_rng(2).uniform(-EDGE / 2, EDGE / 2, (20, 2)):
        assert heights_at(vertices, faces, (95 + x) / 1000, (y - 19.6) / 1000)[-1][0] * 1000 < -4.1


def test_merged_boxes_have_no_faces_inside():
    vertices, faces = union_of_boxes([[(0, 0, 0), (2, 1, 1)], [(1, 0, 0), (3, 1, 1)], [(5, 5, 5), (5, 6, 6)]])
    assert volume(vertices, faces) == pytest.approx(3)
    assert np.linalg.norm(
        np.cross(*np.diff(vertices[faces], axis=1).swapaxes(0, 1)), axis=1
    ).sum() / 2 == pytest.approx(14)
