import numpy as np
import pytest

from tests.meshes import ball, box, volume
from yamsim_cli.core.assets import Reduction, reduction
from yamsim_cli.core.assets.reduction import LIMIT_MM, cleared, collapsed, reduce_stl
from yamsim_cli.core.geometry.deviation import deviation
from yamsim_cli.core.geometry.stl import read_stl, stl_bytes

# 80 mm across, 6,240 faces.
BALL = ball(0.04, 40)


def in_mm(data):
    vertices, faces = read_stl(data)
    return vertices * 1000, faces


@pytest.mark.slow
def test_a_ball_stays_a_ball_with_far_fewer_faces():
    source = stl_bytes(*BALL)
    reduced = reduce_stl(source, Reduction(faces=900))
    assert len(in_mm(reduced)[1]) < 1000
    assert deviation(in_mm(source), in_mm(reduced), 1.0, 4000) <= LIMIT_MM
    assert volume(in_mm(reduced)) == pytest.approx(volume(in_mm(source)), rel=0.02)


@pytest.mark.slow
def test_slivers_of_a_flat_side_go_at_no_loss():
    source = stl_bytes(*box(0.1, 12))
    reduced = reduce_stl(source, None)
    assert len(in_mm(reduced)[1]) == 12
    assert deviation(in_mm(source), in_mm(reduced), 1.0, 1000) < 1e-3


@pytest.mark.slow
def test_the_same_mesh_gives_the_same_bytes():
    assert reduce_stl(stl_bytes(*BALL), Reduction(faces=700)) == reduce_stl(stl_bytes(*BALL), Reduction(faces=700))


@pytest.mark.slow
def test_one_that_strays_too_far_is_not_used(monkeypatch):
    """A ball of 20 faces misses the real one by millimetres: clearing alone is what is left."""
    source = stl_bytes(*BALL)
    far = collapsed(in_mm(source), Reduction(faces=20))
    assert deviation(in_mm(source), far, 10.0, 1000) > LIMIT_MM
    reduced = reduce_stl(source, Reduction(faces=20))
    assert 100 < len(in_mm(reduced)[1]) < len(BALL[1])
    assert deviation(in_mm(source), in_mm(reduced), 1.0, 4000) <= LIMIT_MM
    # And where that strays too, the source.
    monkeypatch.setattr(reduction, "cleared", lambda surface, tolerance: (surface[0] * 1.1, surface[1][:50]))
    assert reduce_stl(source, Reduction(faces=20)) == source


def test_what_encloses_no_body_is_left_as_it_is():
    vertices, faces = box(100.0, 4)
    sheet = vertices, faces[(vertices[faces][..., 2] == 0).all(axis=1)]
    assert cleared(sheet, 0.2) is sheet
    data = stl_bytes(sheet[0] / 1000, sheet[1])
    assert reduce_stl(data, None) == data


@pytest.mark.slow
def test_no_face_without_an_area_is_left():
    vertices, faces = in_mm(reduce_stl(stl_bytes(*BALL), Reduction(faces=300)))
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).min() > 0
