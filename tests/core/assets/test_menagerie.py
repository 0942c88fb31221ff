import socket
import time

import pytest

from yamsim_cli.core.assets import SourceError, fetch
from yamsim_cli.core.assets.downloads import Menagerie
from yamsim_cli.core.assets.sources import no_progress


@pytest.fixture
def package():
    return pytest.importorskip("mujoco_menagerie")


@pytest.fixture
def checkout(package, tmp_path, monkeypatch, contents):
    """A MENAGERIE_ROOT in which the files have names of their own."""
    folder = tmp_path / "menagerie/i2rt_yam/assets/linear"
    folder.mkdir(parents=True)
    (folder / "renamed_part.stl").write_bytes(contents["part.stl"])
    (folder / "tip.stl").write_bytes(contents["tip.stl"])
    (folder / "part.stl").write_bytes(b"other part")
    monkeypatch.setenv("MENAGERIE_ROOT", str(tmp_path / "menagerie"))
    return folder


@pytest.fixture
def empty_cache(package, tmp_path, monkeypatch):
    monkeypatch.delenv("MENAGERIE_ROOT", raising=False)
    monkeypatch.setenv("MENAGERIE_CACHE_DIR", str(tmp_path / "menagerie_cache"))


def test_a_local_checkout_is_read_by_content_without_a_probe(world, checkout):
    report = fetch(world.lock, ["tiny"], world.store, [Menagerie(probe_s=0)])
    assert report.sets[0].source == "mujoco-menagerie"
    assert world.store.resolve(world.lock.sets["tiny"]) == report.sets[0].directory


def test_a_checkout_with_other_files_is_a_reason(world, checkout, tmp_path):
    (checkout / "tip.stl").write_bytes(b"solid tiP")
    with pytest.raises(SourceError, match=r"locked content of tip\.stl"):
        Menagerie().read(world.lock.sets["tiny"], tmp_path, no_progress)


def test_a_checkout_without_the_model_gives_the_packages_own_words(world, package, tmp_path, monkeypatch):
    monkeypatch.setenv("MENAGERIE_ROOT", str(tmp_path))
    with pytest.raises(SourceError, match=r"'i2rt_yam' not found under MENAGERIE_ROOT"):
        Menagerie().read(world.lock.sets["tiny"], tmp_path, no_progress)


def test_a_host_that_refuses_is_not_tried_further(world, empty_cache, tmp_path, monkeypatch):
    monkeypatch.setenv("MENAGERIE_BASE_URL", "http://127.0.0.1:1/assets")
    started = time.monotonic()
    with pytest.raises(SourceError, match=r"127\.0\.0\.1 does not answer within 2 s"):
        Menagerie().read(world.lock.sets["tiny"], tmp_path, no_progress)
    assert time.monotonic() - started < 1.5


def test_a_name_lookup_that_hangs_is_given_up(world, empty_cache, tmp_path, monkeypatch):
    def hang(*_):
        time.sleep(5)
        raise OSError

    monkeypatch.setenv("MENAGERIE_BASE_URL", "http://meshes.invalid/assets")
    monkeypatch.setattr(socket, "create_connection", hang)
    started = time.monotonic()
    with pytest.raises(SourceError, match=r"meshes\.invalid does not answer"):
        Menagerie(probe_s=0.2).read(world.lock.sets["tiny"], tmp_path, no_progress)
    assert time.monotonic() - started < 1.5


def test_a_download_that_hangs_is_given_up(world, empty_cache, tmp_path, monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as silent:  # accepts, and never says a word
        monkeypatch.setenv("MENAGERIE_BASE_URL", f"http://127.0.0.1:{silent.getsockname()[1]}")
        with pytest.raises(SourceError, match=r"not done after 0\.5 s"):
            Menagerie(limit_s=0.5).read(world.lock.sets["tiny"], tmp_path, no_progress)


def test_a_package_that_is_not_installed_is_a_reason(world, tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(SourceError, match="not installed"):
        Menagerie().read(world.lock.sets["tiny"], tmp_path, no_progress)
