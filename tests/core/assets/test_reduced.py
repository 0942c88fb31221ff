import threading

import pytest

from tests.meshes import ball, box
from yamsim_cli.core.assets import LockedFile, find_reduced, make_reduced, reduction
from yamsim_cli.core.errors import ResourceError
from yamsim_cli.core.files import sha256_bytes
from yamsim_cli.core.geometry.stl import stl_bytes


@pytest.fixture
def contents():
    """In metres, and finely cut, so that there is something to reduce."""
    return {"part.stl": stl_bytes(*box(0.1, 6)), "tip.stl": stl_bytes(*ball(0.05, 12))}


@pytest.fixture
def tiny(world, contents):
    files = {
        name: LockedFile(sha256=sha256_bytes(data), size=len(data), member=name) for name, data in contents.items()
    }
    return world.lock.sets["tiny"].model_copy(update={"files": files})


@pytest.fixture
def source(world, tiny, contents):
    with world.store.writing():
        return world.store.publish(tiny, contents, "the notice")


def test_they_are_made_once_and_kept_beside_the_set(world, tiny, source, contents, monkeypatch):
    assert find_reduced(world.store, tiny) is None
    steps = []
    made = make_reduced(world.store, tiny, source, "the notice", lambda done, total: steps.append((done, total)))
    assert steps == [(1, 2), (2, 2)]
    assert made.directory.parent == source.parent
    assert made.directory.name.startswith(f"{source.name}-reduced-")
    assert sorted(path.name for path in made.directory.iterdir()) == sorted([*contents, "tiny.txt", reduction.REPORT])
    assert made.faces < made.source_faces == sum((len(data) - 84) // 50 for data in contents.values())
    assert (made.directory / "tiny.txt").read_text() == "the notice"

    monkeypatch.setattr(reduction, "reduce_stl", None)
    assert find_reduced(world.store, tiny) == made
    assert make_reduced(world.store, tiny, source, "the notice") == made


@pytest.mark.parametrize("damage", ["byte", "cut", "missing", "report", "no report"])
def test_what_is_damaged_is_made_again(world, tiny, source, monkeypatch, damage):
    monkeypatch.setattr(reduction, "reduce_stl", lambda data, how: data)
    made = make_reduced(world.store, tiny, source, "the notice")
    mesh, report = made.directory / "part.stl", made.directory / reduction.REPORT
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
    monkeypatch.setattr(reduction, "recipe", lambda: "another")
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

    monkeypatch.setattr(reduction, "recipe", missing)
    for call in (lambda: find_reduced(world.store, tiny), lambda: make_reduced(world.store, tiny, source, "")):
        with pytest.raises(ResourceError, match="manifold3d"):
            call()
