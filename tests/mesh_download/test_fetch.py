import multiprocessing
import runpy
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from yamsim_cli.core.errors import ResourceError, UsageError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.scene.assets import AssetStore, SourceError, load_lock
from yamsim_cli.mesh_download.fetch import default_sources, fetch


@dataclass
class Fake:
    """A source that returns given files, or fails, and counts requests."""

    name: str
    files: dict[str, bytes] | None = None
    error: BaseException | None = None
    asked: list[str] = field(default_factory=list)

    def has_set(self, assets):
        return True

    def read(self, assets, scratch, progress):
        self.asked.append(assets.name)
        (scratch / "leftover").write_bytes(b"x")
        if self.error is not None:
            raise self.error
        return self.files


def test_the_first_source_that_has_it_right_wins(world, contents):
    broken = Fake("broken", error=SourceError("no answer"))
    wrong = Fake("wrong", files=contents | {"tip.stl": b"solid tiP"})
    right, never = Fake("right", files=contents), Fake("never", files=contents)
    (fetched,) = fetch(world.lock, ["tiny"], world.store, [broken, wrong, right, never]).sets
    assert fetched.source == "right"
    assert world.store.find_verified_folder(world.lock.sets["tiny"]) == fetched.directory
    assert [source.asked for source in (broken, wrong, right, never)] == [["tiny"], ["tiny"], ["tiny"], []]


def test_after_a_fetch_no_source_is_asked_again(world, contents):
    source = Fake("once", files=contents)
    fetch(world.lock, [], world.store, [source])
    (again,) = fetch(world.lock, [], world.store, [source]).sets
    assert (again.source, source.asked) == ("store", ["tiny"])


def test_when_all_fail_one_line_names_each_and_what_to_do(world, contents):
    sources = [
        Fake("first", error=SourceError("no answer")),
        Fake("second", error=OSError(28, "No space left on device")),
        Fake("third", files=contents | {"tip.stl": b"other"}),
    ]
    with pytest.raises(ResourceError) as caught:
        fetch(world.lock, ["tiny"], world.store, sources)
    message = str(caught.value)
    for part in ("first: no answer", "second: ", "No space left", "third: not the locked content: tip.stl", "by hand"):
        assert part in message
    assert str(world.store.root) in message
    assert "\n" not in message
    assert {path.name for path in world.store.root.iterdir()} == {".lock"}, "nothing published, nothing left"


def test_one_set_that_fails_does_not_hold_up_the_others(world, contents):
    world.write_lock(world.raw | {"sets": {"bad": world.raw["sets"]["tiny"] | {"name": "bad"}} | world.raw["sets"]})

    class OnlyTiny(Fake):
        def has_set(self, assets):
            return assets.name == "tiny"

    with pytest.raises(ResourceError, match=r"could not fetch bad \(no source offers it\)"):
        fetch(world.lock, [], world.store, [OnlyTiny("half", files=contents)])
    assert world.store.find_verified_folder(world.lock.sets["tiny"]) is not None


@pytest.mark.parametrize("error", [KeyboardInterrupt(), ZeroDivisionError()])
def test_an_interrupt_or_a_bug_is_passed_on_and_leaves_nothing_behind(world, error):
    with pytest.raises(type(error)):
        fetch(world.lock, [], world.store, [Fake("stopped", error=error)])
    assert {path.name for path in world.store.root.iterdir()} == {".lock"}


def test_a_store_that_cannot_be_written_says_what_to_set(world, tmp_path, contents):
    (tmp_path / "file").write_text("")
    with pytest.raises(ResourceError, match=r"cannot write to the asset store .*YAMSIM_ASSETS"):
        fetch(world.lock, [], AssetStore(tmp_path / "file/store"), [Fake("right", files=contents)])


def test_an_unknown_name_is_refused_before_any_work(world):
    with pytest.raises(UsageError, match="unknown asset set 'tinny'; did you mean 'tiny'"):
        fetch(world.lock, ["tinny"], world.store, [])
    assert not world.store.root.exists()


@pytest.mark.slow
def test_two_processes_at_once_fetch_once(world, tmp_path):
    calls = tmp_path / "calls"
    settings = {"DATA": str(world.locations.data[0]), "STORE": str(world.store.root), "CALLS": str(calls)}
    worker = str(Path(__file__).with_name("fetch_worker.py"))
    context = multiprocessing.get_context("spawn")
    processes = [context.Process(target=runpy.run_path, args=(worker, settings)) for _ in range(2)]
    for process in processes:
        process.start()
    for process in processes:
        process.join(30)
    assert [process.exitcode for process in processes] == [0, 0]
    assert calls.read_text() == "called\n"
    assert world.store.find_verified_folder(world.lock.sets["tiny"]) is not None


@pytest.mark.long
@pytest.mark.network
def test_the_committed_lock_can_really_be_fetched(tmp_path):
    lock, store = load_lock(Locations.from_environment({})), AssetStore(tmp_path / "store")
    seen: list[tuple[str, int, int]] = []
    report = fetch(lock, lock.sets, store, default_sources(lock), lambda *event: seen.append(event))
    assert [fetched.name for fetched in report.sets] == list(lock.sets)
    assert all(store.find_verified_folder(assets) is not None for assets in lock.sets.values())
    assert {fetched.source for fetched in fetch(lock, lock.sets, store, []).sets} == {"store"}
    assert all(0 <= done <= total for _, done, total in seen)
    assert {path.name for path in store.root.iterdir()} == {a.directory_name for a in lock.sets.values()} | {".lock"}
