import os
from pathlib import Path

import pytest

from yamsim_cli.core.scene.assets import AssetStore, FileStatus


def publish(world, contents) -> Path:
    with world.store.write_lock():
        return world.store.publish(world.lock.sets["tiny"], contents, "the notice")


def test_an_empty_store_has_nothing_and_says_so(world):
    tiny = world.lock.sets["tiny"]
    assert world.store.find_verified_folder(tiny) is None
    assert {state.status for state in world.store.file_states(tiny)} == {FileStatus.MISSING}
    assert not world.store.root.exists(), "looking must not create anything"


def test_a_published_set_resolves_with_its_notice(world, contents):
    folder = publish(world, contents)
    assert world.store.find_verified_folder(world.lock.sets["tiny"]) == folder
    assert {path.name for path in folder.iterdir()} == {"part.stl", "tip.stl", "tiny.txt"}
    assert (folder / "tiny.txt").read_text() == "the notice"
    assert {path.name for path in world.store.root.iterdir()} == {folder.name, ".lock"}


@pytest.mark.parametrize("damage", [b"solid tiP", b"solid", b""])
def test_a_changed_byte_is_found(world, contents, damage):
    folder = publish(world, contents)
    (folder / "tip.stl").write_bytes(damage)
    tiny = world.lock.sets["tiny"]
    assert world.store.find_verified_folder(tiny) is None
    assert [(state.name, state.status) for state in world.store.file_states(tiny)] == [
        ("part.stl", FileStatus.OK),
        ("tip.stl", FileStatus.CHANGED),
    ]


def test_what_is_no_regular_file_is_never_opened(world, contents):
    folder = publish(world, contents)
    (folder / "tip.stl").unlink()
    os.mkfifo(folder / "tip.stl")  # opening it would wait for ever
    assert world.store.find_verified_folder(world.lock.sets["tiny"]) is None
    assert world.store.file_states(world.lock.sets["tiny"])[1].status is FileStatus.CHANGED


def test_a_file_of_the_wrong_size_is_not_read(tmp_path, world, monkeypatch):
    def never(path):
        raise AssertionError(f"{path} was read")

    monkeypatch.setattr("yamsim_cli.core.scene.assets.asset_store.sha256_file", never)
    (tmp_path / "part.stl").write_bytes(b"x" * 100)
    assert AssetStore(tmp_path).find_verified_folder(world.lock.sets["tiny"]) is None


def test_a_damaged_set_is_replaced_whole(world, contents):
    folder = publish(world, contents)
    (folder / "tip.stl").write_bytes(b"junk")
    (folder / "stray.stl").write_bytes(b"junk")
    assert publish(world, contents) == folder
    assert world.store.find_verified_folder(world.lock.sets["tiny"]) == folder
    assert not (folder / "stray.stl").exists()


@pytest.mark.parametrize("place", [".", "tiny"])
def test_files_put_there_by_hand_count(world, contents, place):
    folder = world.store.root / place
    folder.mkdir(parents=True)
    for name, data in contents.items():
        (folder / name).write_bytes(data)
    assert world.store.find_verified_folder(world.lock.sets["tiny"]) == folder


def test_a_half_filled_folder_does_not_count_and_its_state_is_told(world, contents):
    (world.store.root / "tiny").mkdir(parents=True)
    (world.store.root / "tiny/part.stl").write_bytes(contents["part.stl"])
    tiny = world.lock.sets["tiny"]
    assert world.store.find_verified_folder(tiny) is None
    assert [state.status for state in world.store.file_states(tiny)] == [FileStatus.OK, FileStatus.MISSING]
    assert world.store.file_states(tiny)[0].path == world.store.root / "tiny/part.stl"


@pytest.mark.parametrize(("owner", "call"), [(os, "open"), (Path, "mkdir"), (os, "fsync"), (os, "rename")])
def test_publishing_is_all_or_nothing(world, contents, owner, call, monkeypatch):
    """For every n, the n-th file operation fails: the set is never incomplete."""
    tiny, real = world.lock.sets["tiny"], getattr(owner, call)
    calls_left = 0

    def flaky(*arguments, **options):
        nonlocal calls_left
        calls_left -= 1
        if calls_left == -1:
            raise OSError("disk full")
        return real(*arguments, **options)

    failures = 0
    while True:
        with world.store.write_lock(), monkeypatch.context() as patch:
            calls_left = failures
            patch.setattr(owner, call, flaky)
            try:
                world.store.publish(tiny, contents, "the notice")
            except OSError:
                failures += 1
            else:
                break
        # If flushing the parent failed, the set is complete already.
        assert (world.store.find_verified_folder(tiny) is not None) == world.store.folder_of_set(tiny).exists()
    assert failures > 0, "the fault was never injected"
    assert world.store.find_verified_folder(tiny) is not None


def test_files_outside_the_lock_are_not_published(world, contents):
    folder = publish(world, contents | {"../evil.stl": b"evil", "more.stl": b"more"})
    assert {path.name for path in folder.iterdir()} == {"part.stl", "tip.stl", "tiny.txt"}


def test_what_a_killed_process_left_behind_is_cleared(world, contents):
    left = world.store.root / ".staging/half"
    left.mkdir(parents=True)
    publish(world, contents)
    assert not left.exists()
