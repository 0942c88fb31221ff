import errno
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from yamsim_cli.core.errors import ResourceError, UsageError
from yamsim_cli.core.files import writing as files
from yamsim_cli.core.files.writing import (
    append_line,
    describe_refusal,
    directory_obstacle,
    exclusive_lock,
    move_to_backup,
    publish_directory,
    write_file,
    write_outputs,
)

EPISODE = {"episode.json": b"{}", "rgb/cam/000000.jpg": b"jpeg", "lowdim/000000.pkl": b"pickle", "empty": b""}


class InjectedError(OSError):
    """Stands for a full disk or a failing device."""


@pytest.fixture
def failing(monkeypatch):
    """Make the n-th call that changes the disk fail, and count the calls."""

    def arm(n: int, error: BaseException) -> list[str]:
        calls: list[str] = []

        def wrap(owner, name):
            real = getattr(owner, name)

            def step(*arguments, **options):
                calls.append(name)
                if len(calls) == n:
                    raise error
                return real(*arguments, **options)

            monkeypatch.setattr(owner, name, step)

        for name in ("fsync", "rename", "replace", "mkdir", "open"):
            wrap(os, name)
        wrap(Path, "open")
        return calls

    return arm


def steps_of(monkeypatch, failing, action) -> int:
    with monkeypatch.context():
        calls = failing(0, InjectedError())
        action()
    monkeypatch.undo()
    return len(calls)


def tree(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def test_a_file_is_created_and_replaced_and_nothing_else_is_left(tmp_path):
    path = tmp_path / "manifest.json"
    write_file(path, b"one")
    write_file(path, b"two")
    assert tree(tmp_path) == {"manifest.json": b"two"}


@pytest.mark.parametrize("error", [InjectedError(errno.ENOSPC, "No space left"), KeyboardInterrupt()])
def test_a_file_keeps_its_old_content_whatever_step_fails(tmp_path, monkeypatch, failing, error):
    path = tmp_path / "manifest.json"
    steps = steps_of(monkeypatch, failing, lambda: write_file(path, b"old"))
    assert steps >= 4
    for n in range(1, steps + 1):
        write_file(path, b"old")
        calls = failing(n, error)
        with pytest.raises(type(error)):
            write_file(path, b"the new content")
        monkeypatch.undo()
        renamed = "replace" in calls[:-1]
        assert tree(tmp_path) == {"manifest.json": b"the new content" if renamed else b"old"}


def test_the_content_is_flushed_before_the_name_points_to_it(tmp_path, failing):
    calls = failing(0, InjectedError())
    write_file(tmp_path / "f", b"x")
    assert calls.index("fsync") < calls.index("replace") < len(calls) - 1 - calls[::-1].index("fsync")


def test_lines_are_appended_to_a_file_that_is_made_when_missing(tmp_path):
    path = tmp_path / "attempts.jsonl"
    for line in ("one", "zwei ü", ""):
        append_line(path, line)
    assert path.read_bytes() == "one\nzwei ü\n\n".encode()


@pytest.mark.parametrize("tail", ["{cut", "ü"])
def test_a_cut_off_line_never_swallows_the_next(tmp_path, tail):
    path = tmp_path / "attempts.jsonl"
    path.write_bytes(b"one\n" + tail.encode()[:-1] + b"x")
    append_line(path, "two")
    assert path.read_bytes().split(b"\n")[-2:] == [b"two", b""]
    assert path.read_bytes().startswith(b"one\n")


def test_a_line_that_does_not_fit_leaves_nothing_of_it(tmp_path, monkeypatch):
    path = tmp_path / "attempts.jsonl"
    append_line(path, "one")
    real = os.write
    monkeypatch.setattr(files.os, "write", lambda descriptor, data: real(descriptor, data[: len(data) // 2]))
    with pytest.raises(OSError, match="No space left on device"):
        append_line(path, "a line longer than what is left")
    assert path.read_bytes() == b"one\n"


def test_a_directory_appears_with_all_its_files(tmp_path):
    publish_directory(tmp_path / "ep_000000", EPISODE, tmp_path / ".staging")
    assert tree(tmp_path / "ep_000000") == EPISODE
    assert list((tmp_path / ".staging").iterdir()) == []


@pytest.mark.parametrize("error", [InjectedError(errno.ENOSPC, "No space left"), KeyboardInterrupt()])
def test_nothing_of_a_directory_appears_whatever_step_fails(tmp_path, monkeypatch, failing, error):
    def publish(number: int) -> None:
        publish_directory(tmp_path / f"ep_{number:06d}", EPISODE, tmp_path / ".staging")

    publish(0)
    steps = steps_of(monkeypatch, failing, lambda: publish(1))
    assert steps >= 3 * len(EPISODE)
    for n in range(1, steps + 1):
        failing(n, error)
        with pytest.raises(type(error)):
            publish(2)
        monkeypatch.undo()
        assert {path.name for path in tmp_path.iterdir()} == {"ep_000000", "ep_000001", ".staging"}
        assert list((tmp_path / ".staging").iterdir()) == [], f"step {n} of {steps} left its tree behind"
    publish(2)
    assert tree(tmp_path / "ep_000002") == EPISODE


def test_everything_is_flushed_before_the_directory_gets_its_name(tmp_path, failing):
    calls = failing(0, InjectedError())
    publish_directory(tmp_path / "ep", EPISODE, tmp_path / ".staging")
    before, after = calls[: calls.index("rename")], calls[calls.index("rename") :]
    staged_directories = 1 + len({"rgb", "rgb/cam", "lowdim"})
    assert before.count("fsync") == len(EPISODE) + staged_directories
    assert after.count("fsync") == 1


@pytest.mark.parametrize("content", [{}, {"kept": b"x"}])
def test_an_existing_directory_is_never_replaced(tmp_path, content):
    final = tmp_path / "ep"
    final.mkdir()
    for name, data in content.items():
        (final / name).write_bytes(data)
    with pytest.raises(FileExistsError):
        publish_directory(final, EPISODE, tmp_path / ".staging")
    assert tree(final) == content
    assert list((tmp_path / ".staging").iterdir()) == []


def test_what_is_in_the_way_is_moved_to_the_first_free_name(tmp_path):
    path = tmp_path / "dataset"
    for k in (1, 2):
        path.mkdir()
        (path / "f").write_text(str(k))
        assert move_to_backup(path) == tmp_path / f"dataset.old-{k}"
    assert tree(tmp_path) == {"dataset.old-1/f": b"1", "dataset.old-2/f": b"2"}


@pytest.mark.parametrize("path", [".", "..", "/", "{here}", "../inside", "below/..", "../../around/inside"])
def test_the_current_directory_is_not_moved_aside(tmp_path, monkeypatch, path):
    here = tmp_path / "around/inside"
    (here / "below").mkdir(parents=True)
    monkeypatch.chdir(here)
    with pytest.raises(UsageError, match=r"cannot be moved aside, because you are in it: run from another directory"):
        move_to_backup(Path(path.format(here=here)))
    assert Path.cwd() == here


def test_a_directory_without_a_name_of_its_own_is_moved_by_its_real_one(tmp_path, monkeypatch):
    (tmp_path / "dataset/below").mkdir(parents=True)
    monkeypatch.chdir(tmp_path)
    assert move_to_backup(Path("dataset/below/..")) == tmp_path / "dataset.old-1"
    assert (tmp_path / "dataset.old-1/below").is_dir()


def test_of_a_link_to_the_current_directory_only_the_link_is_moved(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link").symlink_to(tmp_path)
    assert move_to_backup(Path("link")) == Path("link.old-1")
    assert Path("link.old-1").resolve() == Path.cwd()


@pytest.mark.parametrize(
    ("path", "told"),
    [
        ("dataset", None),
        ("dataset/new/deep", None),
        ("new", None),
        ("file", "it is a file"),
        ("file/new", "{here}/file is a file"),
        ("pipe", "it is not a directory"),
        ("link", "it is a link to gone, which does not exist"),
        ("link/new", "{here}/link is a link to gone, which does not exist"),
        ("loop", "it is a link to loop, which does not exist"),
        ("to_file", "it is a file"),
        ("to_dataset", None),
        ("x" * 300, "it is too long: a name may have 255 bytes, and a whole path 4,095"),
    ],
)
def test_a_refusal_says_why_a_directory_cannot_exist(tmp_path, path, told):
    (tmp_path / "dataset").mkdir()
    (tmp_path / "file").touch()
    os.mkfifo(tmp_path / "pipe")
    for name, target in {"link": "gone", "loop": "loop", "to_file": "file", "to_dataset": "dataset"}.items():
        (tmp_path / name).symlink_to(target)
    assert directory_obstacle(tmp_path / path) == (told and told.format(here=tmp_path))


def test_a_refusal_names_what_is_in_the_way_where_that_is_the_reason(tmp_path):
    (tmp_path / "file").touch()
    said = {
        number: describe_refusal(OSError(number, os.strerror(number)), tmp_path / "file") for number in (17, 20, 28)
    }
    assert said == {17: "it is a file", 20: "it is a file", 28: "No space left on device"}
    assert describe_refusal(OSError(20, "Not a directory"), tmp_path) == "Not a directory"


def test_a_lock_keeps_another_process_out_until_it_is_let_go(tmp_path):
    lock, log = tmp_path / "lock", tmp_path / "log"
    script = f"""
from pathlib import Path
from yamsim_cli.core.files.writing import append_line, exclusive_lock
print("started", flush=True)
with exclusive_lock(Path({str(lock)!r})):
    append_line(Path({str(log)!r}), "other")
"""
    with exclusive_lock(lock):
        other = subprocess.Popen(
            [sys.executable, "-c", script],
            stdout=subprocess.PIPE,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        )
        try:
            assert other.stdout.readline() == b"started\n"
            with pytest.raises(subprocess.TimeoutExpired):
                other.wait(0.3)
            append_line(log, "mine")
        except BaseException:
            other.kill()
            raise
    assert other.wait(30) == 0
    other.stdout.close()
    assert log.read_text() == "mine\nother\n"


@pytest.fixture
def full(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A folder in which there is room for one file only."""
    folder, write, written = tmp_path / "full", files.write_and_fsync, list[Path]()
    folder.mkdir()

    def write_or_fail(path: Path, data: bytes) -> None:
        if path.parent == folder:
            if written:
                raise OSError(errno.ENOSPC, "No space left on device", str(path))
            written.append(path)
        write(path, data)

    monkeypatch.setattr(files, "write_and_fsync", write_or_fail)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return folder


def test_of_several_files_all_are_written_or_none_and_the_result_is_kept_elsewhere(full: Path) -> None:
    wanted = {full / "a.png": b"a", full / "b.png": b"b"}
    with pytest.raises(
        ResourceError, match=r"No space left on device; choose another --out\. The result is kept"
    ) as told:
        write_outputs(wanted)
    assert list(full.iterdir()) == []
    kept = Path(str(told.value).rpartition(" ")[2])
    assert {path.name: path.read_bytes() for path in kept.iterdir()} == {"a.png": b"a", "b.png": b"b"}


@pytest.mark.parametrize("kind", ["staged", "scratch"])
def test_a_killed_processs_folder_is_removed_by_the_next_one_and_a_living_ones_is_not(tmp_path, monkeypatch, kind):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    call = (
        f"staged_directory(Path({str(tmp_path / 'out')!r}))" if kind == "staged" else "scratch_directory('yamsim-t-')"
    )
    script = f"""
import time
from pathlib import Path
from yamsim_cli.core.files.writing import scratch_directory, staged_directory
with {call}:
    print("made", flush=True)
    time.sleep(60)
"""
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "TMPDIR": str(tmp_path)}
    other = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, env=env)
    try:
        assert other.stdout.readline() == b"made\n"
        (theirs,) = tmp_path.iterdir()
        (theirs / "file").write_text("half")
        bystander = tmp_path / (".other.part" if kind == "staged" else "yamsim-tools")
        bystander.mkdir()

        def work() -> None:
            with files.staged_directory(tmp_path / "out") if kind == "staged" else files.scratch_directory("yamsim-t-"):
                pass
            if kind == "staged":
                (tmp_path / "out").rmdir()

        work()
        assert set(tmp_path.iterdir()) == {theirs, bystander}
    finally:
        other.kill()
        other.wait()
        other.stdout.close()
    work()
    assert set(tmp_path.iterdir()) == {bystander}
