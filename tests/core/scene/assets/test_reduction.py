"""Reduced meshes: their deviation, and the store."""

import threading

import numpy as np
import pytest

from tests.meshes import ball, box, volume
from yamsim_cli.core.errors import ResourceError
from yamsim_cli.core.files.writing import sha256_bytes
from yamsim_cli.core.geometry.stl import decode_stl, encode_stl
from yamsim_cli.core.geometry.surface_distance import hausdorff_distance
from yamsim_cli.core.scene.assets import LockedFile, Reduction, find_reduced, make_reduced
from yamsim_cli.core.scene.assets import mesh_reduction as reduction
from yamsim_cli.core.scene.assets.mesh_reduction import MAX_DEVIATION_MM, collapse_edges, reduce_stl, remove_slivers

# 80 mm across, 6,240 faces.
BALL = ball(0.04, 40)


def in_mm(data):
    vertices, faces = decode_stl(data)
    return vertices * 1000, faces


@pytest.mark.slow
def test_a_ball_stays_a_ball_with_far_fewer_faces():
    source = encode_stl(*BALL)
    reduced = reduce_stl(source, Reduction(faces=900))
    assert len(in_mm(reduced)[1]) < 1000
    assert hausdorff_distance(in_mm(source), in_mm(reduced), 1.0, 4000) <= MAX_DEVIATION_MM
    assert volume(in_mm(reduced)) == pytest.approx(volume(in_mm(source)), rel=0.02)


@pytest.mark.slow
def test_slivers_of_a_flat_side_go_at_no_loss():
    source = encode_stl(*box(0.1, 12))
    reduced = reduce_stl(source, None)
    assert len(in_mm(reduced)[1]) == 12
    assert hausdorff_distance(in_mm(source), in_mm(reduced), 1.0, 1000) < 1e-3


@pytest.mark.slow
def test_the_same_mesh_gives_the_same_bytes():
    assert reduce_stl(encode_stl(*BALL), Reduction(faces=700)) == reduce_stl(encode_stl(*BALL), Reduction(faces=700))


@pytest.mark.slow
def test_one_that_strays_too_far_is_not_used(monkeypatch):
    """A ball of 20 faces deviates by millimetres: only removing slivers is left."""
    source = encode_stl(*BALL)
    far = collapse_edges(in_mm(source), Reduction(faces=20))
    assert hausdorff_distance(in_mm(source), far, 10.0, 1000) > MAX_DEVIATION_MM
    reduced = reduce_stl(source, Reduction(faces=20))
    assert 100 < len(in_mm(reduced)[1]) < len(BALL[1])
    assert hausdorff_distance(in_mm(source), in_mm(reduced), 1.0, 4000) <= MAX_DEVIATION_MM
    # If that deviates too, the source is used.
    monkeypatch.setattr(reduction, "remove_slivers", lambda surface, tolerance: (surface[0] * 1.1, surface[1][:50]))
    assert reduce_stl(source, Reduction(faces=20)) == source


def test_what_encloses_no_body_is_left_as_it_is():
    vertices, faces = box(100.0, 4)
    sheet = vertices, faces[(vertices[faces][..., 2] == 0).all(axis=1)]
    assert remove_slivers(sheet, 0.2) is sheet
    data = encode_stl(sheet[0] / 1000, sheet[1])
    assert reduce_stl(data, None) == data


@pytest.mark.slow
def test_no_face_without_an_area_is_left():
    vertices, faces = in_mm(reduce_stl(encode_stl(*BALL), Reduction(faces=300)))
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).min() > 0


@pytest.fixture
def contents():
    """Finely cut, m, so that there is something to reduce."""
    return {"part.stl": encode_stl(*box(0.1, 6)), "tip.stl": encode_stl(*ball(0.05, 12))}


@pytest.fixture
def tiny(world, contents):
    files = {
        name: LockedFile(sha256=sha256_bytes(data), size=len(data), member=name) for name, data in contents.items()
    }
    return world.lock.sets["tiny"].model_copy(update={"files": files})


@pytest.fixture
def source(world, tiny, contents):
    with world.store.write_lock():
        return world.store.publish(tiny, contents, "the notice")


def test_they_are_made_once_and_kept_beside_the_set(world, tiny, source, contents, monkeypatch):
    assert find_reduced(world.store, tiny) is None
    steps = []
    made = make_reduced(world.store, tiny, source, "the notice", lambda done, total: steps.append((done, total)))
    assert steps == [(1, 2), (2, 2)]
    assert made.directory.parent == source.parent
    assert made.directory.name.startswith(f"{source.name}-reduced-")
    assert sorted(path.name for path in made.directory.iterdir()) == sorted(
        [*contents, "tiny.txt", reduction.REPORT_FILE]
    )
    assert made.faces < made.source_faces == sum((len(data) - 84) // 50 for data in contents.values())
    assert (made.directory / "tiny.txt").read_text() == "the notice"

    monkeypatch.setattr(reduction, "reduce_stl", None)
    assert find_reduced(world.store, tiny) == made
    assert make_reduced(world.store, tiny, source, "the notice") == made


@pytest.mark.slow
@pytest.mark.parametrize("damage", ["byte", "cut", "missing", "report", "no report"])
def test_a_damaged_reduced_mesh_is_made_again(world, tiny, source, damage):
    made = make_reduced(world.store, tiny, source, "the notice")
    mesh, report = made.directory / "part.stl", made.directory / reduction.REPORT_FILE
    whole = mesh.read_bytes()
    match damage:
        case "byte":
            mesh.write_bytes(whole[:100] + bytes([whole[100] ^ 1]) + whole[101:])
        case "cut":
            mesh.write_bytes(whole[:-1])
        case "missing":
            mesh.unlink()
        case "report":
            report.write_text("{}")
        case "no report":
            report.unlink()
    assert find_reduced(world.store, tiny) is None
    assert make_reduced(world.store, tiny, source, "the notice") == made
    assert mesh.read_bytes() == whole
    assert find_reduced(world.store, tiny) == made


def test_another_source_or_recipe_is_another_folder(world, tiny, source, monkeypatch):
    made = make_reduced(world.store, tiny, source, "the notice")
    other = dict(tiny.files)
    other["part.stl"] = other["part.stl"].model_copy(update={"sha256": "0" * 64})
    assert find_reduced(world.store, tiny.model_copy(update={"files": other})) is None
    monkeypatch.setattr(reduction, "reduction_fingerprint", lambda: "another")
    assert find_reduced(world.store, tiny) is None
    assert make_reduced(world.store, tiny, source, "the notice").directory != made.directory
    assert made.directory.is_dir()


def test_two_at_once_do_the_work_once(world, tiny, source, monkeypatch):
    calls, real = [], reduction.reduce_stl
    monkeypatch.setattr(reduction, "reduce_stl", lambda data, how: (calls.append(1), real(data, how))[1])
    results = []
    threads = [
        threading.Thread(target=lambda: results.append(make_reduced(world.store, tiny, source, "the notice")))
        for _ in range(2)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(calls) == len(tiny.files)
    assert results[0] == results[1]


def test_a_library_that_is_not_here_is_a_missing_resource(world, tiny, source, monkeypatch):
    def missing():
        raise ModuleNotFoundError("No module named 'manifold3d'")

    monkeypatch.setattr(reduction, "reduction_fingerprint", missing)
    for call in (lambda: find_reduced(world.store, tiny), lambda: make_reduced(world.store, tiny, source, "")):
        with pytest.raises(ResourceError, match="manifold3d"):
            call()
