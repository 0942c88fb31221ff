import errno
import json
import os
import shutil
from pathlib import Path

import pytest

from tests.core.dataset.making import CONFIG, failed_attempt, made, publish
from yamsim_cli.core.dataset.records import AttemptRecord, Manifest, from_json, to_json
from yamsim_cli.core.dataset.writing.ledger import LINE_LOST, Ledger
from yamsim_cli.core.dataset.writing.opening import OpenMode
from yamsim_cli.core.dataset.writing.writer import DatasetWriter
from yamsim_cli.core.documents.document import load_yaml
from yamsim_cli.core.errors import ConfigError, DatasetError, ResourceError, UsageError


def tree(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def opened(path: Path, config: dict = CONFIG, mode: OpenMode = OpenMode.RESUME) -> DatasetWriter:
    """A writer that has let go of its lock, so that one test can open a dataset again and again."""
    with DatasetWriter(path, config, mode) as writer:
        return writer


def resume(path: Path, config: dict = CONFIG) -> DatasetWriter:
    return opened(path, config)


def numbers(writer: DatasetWriter) -> list[tuple[int, int | None]]:
    return [(attempt.attempt, attempt.episode) for attempt in writer.attempts]


@pytest.mark.parametrize("mode", OpenMode)
@pytest.mark.parametrize("exists", [True, False])
def test_a_new_or_empty_directory_is_taken_in_every_mode(tmp_path, mode, exists):
    path = tmp_path / "some/where"
    if exists:
        path.mkdir(parents=True)
    writer = opened(path, CONFIG, mode)
    assert load_yaml(path / "config.yaml").data == CONFIG
    assert (writer.episodes, writer.attempts, writer.missing, writer.moved_aside) == (0, [], [], None)


def test_a_finished_dataset_holds_its_episodes_ledger_and_manifest(dataset):
    assert sorted(path.name for path in dataset.iterdir()) == [
        *("attempts.jsonl", "config.yaml", "ep_000000", "ep_000001", "ep_000002", "manifest.json")
    ]
    lines = (dataset / "attempts.jsonl").read_text().splitlines()
    assert [json.loads(line)["episode"] for line in lines] == [0, 1, 2]
    one = made(1)
    assert tree(dataset / "ep_000001") == {**one.files, "episode.json": to_json(one.record)}


def test_the_manifest_counts_what_is_published(dataset):
    manifest = from_json(Manifest, (dataset / "manifest.json").read_bytes(), "manifest")
    assert (manifest.task, manifest.seed, manifest.attempts, manifest.frames) == ("pickplace", 7, 3, 12)
    sizes = [sum(map(len, tree(dataset / f"ep_{k:06d}").values())) for k in range(3)]
    assert [entry.bytes for entry in manifest.episodes] == sizes
    assert manifest.bytes == sum(sizes)
    assert [entry.path for entry in manifest.episodes] == ["ep_000000", "ep_000001", "ep_000002"]


def test_what_is_in_a_directory_is_never_written_over_unasked(dataset):
    before = tree(dataset)
    with pytest.raises(UsageError, match=r"is not empty; continue it with --resume, move it aside with --overwrite"):
        opened(dataset, CONFIG, OpenMode.NEW)
    assert tree(dataset) == before


def put_in_the_way(path: Path, what: str) -> None:
    """A file, or a link that leads nowhere."""
    if what == "file":
        path.write_text("precious")
    else:
        path.symlink_to("gone")


@pytest.mark.parametrize(
    ("what", "told"), [("file", "it is a file"), ("link", "it is a link to gone, where nothing is")]
)
class TestWhatIsNoDirectory:
    def test_is_refused_and_kept(self, tmp_path, what, told):
        put_in_the_way(tmp_path / "out", what)
        with pytest.raises(UsageError) as caught:
            opened(tmp_path / "out", CONFIG, OpenMode.NEW)
        assert str(caught.value) == (
            f"{tmp_path}/out is not a directory: {told}; move it aside with --overwrite, or choose another --out"
        )
        assert [path.name for path in tmp_path.iterdir()] == ["out"]

    def test_is_not_resumed(self, tmp_path, what, told):
        put_in_the_way(tmp_path / "out", what)
        with pytest.raises(UsageError) as caught:
            opened(tmp_path / "out", CONFIG, OpenMode.RESUME)
        assert str(caught.value) == f"{tmp_path}/out is no dataset to resume: {told}; choose another --out"
        assert [path.name for path in tmp_path.iterdir()] == ["out"]

    def test_can_be_moved_aside(self, tmp_path, what, told):
        put_in_the_way(tmp_path / "out", what)
        writer = opened(tmp_path / "out", CONFIG, OpenMode.OVERWRITE)
        assert writer.moved_aside == tmp_path / "out.old-1"
        if what == "file":
            assert (tmp_path / "out.old-1").read_text() == "precious"
        else:
            assert (tmp_path / "out.old-1").readlink() == Path("gone")
        assert (tmp_path / "out/config.yaml").is_file()


def test_where_one_stands_is_not_moved_aside(dataset, monkeypatch):
    before = tree(dataset)
    monkeypatch.chdir(dataset)
    with pytest.raises(UsageError, match=r"dataset cannot be moved aside, because you are in it"):
        opened(Path(), CONFIG, OpenMode.OVERWRITE)
    assert tree(dataset) == before
    assert resume(Path()).episodes == 3


def test_overwriting_moves_aside_as_often_as_it_is_asked(dataset):
    first = tree(dataset)
    for k in (1, 2):
        writer = opened(dataset, {**CONFIG, "seed": k}, OpenMode.OVERWRITE)
        assert writer.moved_aside == dataset.with_name(f"dataset.old-{k}")
        assert tree(dataset).keys() == {"config.yaml"}
    assert tree(dataset.with_name("dataset.old-1")) == first
    assert load_yaml(dataset.with_name("dataset.old-2") / "config.yaml").data["seed"] == 1


def test_a_place_that_cannot_be_written_is_a_resource_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ResourceError) as caught:
        opened(tmp_path / "file/dataset", CONFIG, OpenMode.NEW)
    assert (
        str(caught.value)
        == f"{tmp_path}/file/dataset cannot be written: {tmp_path}/file is a file; choose another --out"
    )


@pytest.mark.parametrize("mode", OpenMode)
def test_a_name_that_is_too_long_is_a_resource_error(tmp_path, mode):
    with pytest.raises(
        ResourceError, match=r"x cannot be written: it is too long: .* 255 bytes, .*; choose another --out"
    ):
        opened(tmp_path / ("x" * 300), CONFIG, mode)


@pytest.mark.parametrize("mode", OpenMode)
def test_a_disk_that_refuses_is_a_resource_error_with_its_reason(tmp_path, monkeypatch, mode):
    def refuse(*_):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr("yamsim_cli.core.dataset.writing.writer.write_file", refuse)
    with pytest.raises(ResourceError, match=r"cannot be written: Read-only file system: .*; choose another --out"):
        opened(tmp_path / "dataset", CONFIG, mode)


def test_resuming_goes_on_where_it_ended(dataset):
    writer = resume(dataset)
    assert numbers(writer) == [(0, 0), (1, 1), (2, 2)]
    writer.log(failed_attempt(3))
    publish(writer, made(3, attempt=4))
    manifest = writer.finish()
    assert (manifest.attempts, len(manifest.episodes)) == (5, 4)
    assert numbers(resume(dataset)) == [(0, 0), (1, 1), (2, 2), (3, None), (4, 3)]


def test_resuming_and_finishing_changes_nothing(dataset):
    before = tree(dataset)
    resume(dataset).finish()
    assert tree(dataset) == before


def test_what_is_no_dataset_is_not_resumed(tmp_path):
    (tmp_path / "thesis.tex").write_text("")
    with pytest.raises(DatasetError, match=r"has no config\.yaml, so it is no dataset"):
        resume(tmp_path)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"seed": 8}, "seed: 7 there, 8 now"),
        ({"task": {"name": "other", "success": {"threshold": 0.05}}}, "task.name: 'pickplace' there, 'other' now"),
        (
            {"task": {"name": "pickplace", "success": {"threshold": 0.08}}},
            "task.success.threshold: 0.05 there, 0.08 now",
        ),
        ({"arms": [{"name": "arm2"}]}, "arms[0].name: 'arm1' there, 'arm2' now"),
        ({"arms": []}, "arms[0].name: 'arm1' there, None now"),
        ({"wrist": True}, "wrist: None there, True now"),
    ],
)
def test_another_configuration_is_refused_and_its_keys_named(dataset, change, named):
    before = tree(dataset)
    with pytest.raises(ConfigError) as caught:
        resume(dataset, CONFIG | change)
    assert named in str(caught.value)
    assert "\n" not in str(caught.value)
    assert tree(dataset) == before


def test_only_what_changed_is_named(dataset):
    with pytest.raises(ConfigError) as caught:
        resume(dataset, {**CONFIG, "seed": 8})
    assert "task" not in str(caught.value)
    assert "arms" not in str(caught.value)


def test_a_long_list_of_changes_is_cut(dataset):
    with pytest.raises(ConfigError, match="and 5 more"):
        resume(dataset, CONFIG | {f"key{k}": k for k in range(10)})


def test_tuples_and_lists_are_the_same_configuration(tmp_path):
    path = tmp_path / "d"
    config = CONFIG | {"size": (640, 480)}
    opened(path, config, OpenMode.NEW)
    resume(path, config)


def test_a_damaged_config_is_not_resumed(dataset):
    (dataset / "config.yaml").write_bytes(b"\x00\xff")
    with pytest.raises(ConfigError, match="not valid YAML"):
        resume(dataset)


class InjectedError(OSError):
    """Stands for a full disk or a failing device."""


@pytest.fixture
def failing(monkeypatch):
    """Makes the n-th call that changes the disk fail."""

    def arm(n: int) -> list[str]:
        calls: list[str] = []

        def wrap(owner, name):
            real = getattr(owner, name)

            def step(*arguments, **options):
                calls.append(name)
                if len(calls) == n:
                    raise InjectedError(errno.ENOSPC, "No space left on device")
                return real(*arguments, **options)

            monkeypatch.setattr(owner, name, step)

        for name in ("fsync", "rename", "replace", "mkdir", "open", "write"):
            wrap(os, name)
        wrap(Path, "open")
        return calls

    return arm


def test_an_episode_appears_whole_or_not_at_all_whatever_step_fails(dataset, monkeypatch, failing):
    episode = made(3)
    writer = resume(dataset)
    before = tree(dataset)
    calls = failing(0)
    writer.publish(episode.record, episode.files)
    monkeypatch.undo()
    steps = len(calls)
    assert steps > 3 * len(episode.files)
    wanted = tree(dataset / "ep_000003")
    shutil.rmtree(dataset / "ep_000003")

    for n in range(1, steps + 1):
        writer = resume(dataset)
        failing(n)
        with pytest.raises(InjectedError):
            writer.publish(episode.record, episode.files)
        monkeypatch.undo()
        assert tree(dataset) == before, f"step {n} of {steps}"
        assert not any(dataset.glob(".staging/*"))
        assert len(writer.finish().episodes) == 3
    publish(resume(dataset), episode)
    assert tree(dataset / "ep_000003") == wanted


def test_the_manifest_keeps_its_old_content_when_the_disk_refuses(dataset, monkeypatch, failing):
    writer = resume(dataset)
    publish(writer, made(3))
    before = (dataset / "manifest.json").read_bytes()
    failing(1)
    with pytest.raises(InjectedError):
        writer.finish()
    monkeypatch.undo()
    assert (dataset / "manifest.json").read_bytes() == before
    assert len(writer.finish().episodes) == 4


def test_an_attempt_that_could_not_be_written_does_not_count(dataset, monkeypatch, failing):
    writer = resume(dataset)
    failing(1)
    with pytest.raises(InjectedError):
        writer.log(failed_attempt(3))
    assert len(writer.attempts) == 3


@pytest.mark.parametrize("kept", ["", "{", '{"attempt": 2, "seed": 7, "epi'])
def test_a_cut_off_last_line_of_the_ledger_is_forgotten_and_its_episode_adopted(dataset, kept):
    ledger = dataset / "attempts.jsonl"
    lines = ledger.read_text().splitlines(keepends=True)
    whole = ledger.read_bytes()
    ledger.write_text("".join(lines[:2]) + kept)
    assert len(Ledger(dataset).known) == 2
    writer = resume(dataset)
    assert numbers(writer) == [(0, 0), (1, 1), (2, 2)]
    assert ledger.read_bytes() == whole


def test_after_a_cut_off_line_the_ledger_can_go_on_and_be_read_again(build):
    path = build(made(0))
    ledger = path / "attempts.jsonl"
    with ledger.open("ab") as stream:
        stream.write(to_json(failed_attempt(1))[:-20])
    writer = resume(path)
    assert numbers(writer) == [(0, 0)]
    writer.log(failed_attempt(1))
    writer.log(failed_attempt(2))
    assert numbers(resume(path)) == [(0, 0), (1, None), (2, None)]


def test_a_last_line_that_only_lacks_its_end_counts(dataset):
    ledger = dataset / "attempts.jsonl"
    ledger.write_bytes(ledger.read_bytes()[:-1])
    writer = resume(dataset)
    assert len(writer.attempts) == 3
    writer.log(failed_attempt(3))
    assert len(Ledger(dataset).known) == 4


def test_a_line_cut_off_inside_a_letter_is_forgotten_too(dataset):
    attempt = failed_attempt(3)
    attempt = attempt.model_copy(update={"outcome": attempt.outcome.model_copy(update={"detail": "3° off"})})
    cut = to_json(attempt).split("°".encode())[0] + "°".encode()[:1]
    with (dataset / "attempts.jsonl").open("ab") as stream:
        stream.write(cut)
    assert len(Ledger(dataset).known) == 3


BROKEN = [b"{\n", b"\xff\xfe\n", b"null\n", b"{}\n", b"\n", b""]


@pytest.fixture
def with_failures(build):
    """Attempts 0 to 5, of which 1 and 4 failed."""
    path = build(made(0))
    writer = resume(path)
    for attempt, episode in enumerate((0, None, 1, 2, None, 3)):
        if attempt and episode is None:
            writer.log(failed_attempt(attempt))
        elif attempt:
            publish(writer, made(episode, attempt))
    writer.finish()
    return path


def damage(dataset: Path, change) -> bytes:
    """Spoil the ledger's lines, a list of bytes; returns what it was."""
    ledger = dataset / "attempts.jsonl"
    whole = ledger.read_bytes()
    lines = whole.splitlines(keepends=True)
    change(lines)
    ledger.write_bytes(b"".join(lines))
    return whole


@pytest.mark.parametrize("broken", BROKEN)
@pytest.mark.parametrize("number", [0, 2, 3, 5])
def test_the_line_of_an_episode_is_read_from_the_episode(with_failures, number, broken):
    def change(lines):
        lines[number] = broken

    whole = damage(with_failures, change)
    spoiled = (with_failures / "attempts.jsonl").read_bytes()
    writer = resume(with_failures)
    assert (with_failures / "attempts.jsonl").read_bytes() == whole
    assert (writer.lost_lines, writer.missing, len(writer.attempts), writer.episodes) == (set(), [], 6, 4)
    kept = with_failures / ".damaged/attempts.jsonl.1"
    if broken.strip():
        assert kept.read_bytes() == spoiled
        assert writer.repairs[0].startswith(f"attempts.jsonl is damaged (line {number + 1}: ")
        assert writer.repairs[0].endswith(f"): it is mended, and kept as it was in {kept}")
    else:
        assert not kept.exists(), "nothing was in it that is not in the new one"
    assert resume(with_failures).repairs == []


@pytest.mark.parametrize("broken", BROKEN)
def test_the_line_of_a_failure_has_to_be_made_again(with_failures, broken):
    def change(lines):
        lines[1] = broken

    whole = damage(with_failures, change)
    for _ in range(2):
        writer = resume(with_failures)
        assert writer.lost_lines == {1}
        assert numbers(writer) == [(0, 0), (1, None), (2, 1), (3, 2), (4, None), (5, 3)]
        assert writer.attempts[1].outcome == LINE_LOST
        assert writer.repairs[-1] == "what attempts.jsonl said of attempt 1 is lost, and made again"
    writer.log(failed_attempt(1))
    assert (writer.lost_lines, writer.attempts[1]) == (set(), failed_attempt(1))
    assert (with_failures / "attempts.jsonl").read_bytes() == whole
    assert len(list(with_failures.glob(".damaged/*"))) == bool(broken.strip())


@pytest.mark.parametrize("lost", [lambda path: path.unlink(), lambda path: path.write_bytes(b"")])
def test_a_ledger_that_is_gone_is_built_from_the_episodes(with_failures, lost):
    whole = (with_failures / "attempts.jsonl").read_bytes()
    lost(with_failures / "attempts.jsonl")
    writer = resume(with_failures)
    assert writer.lost_lines == {1, 4}
    for attempt in (4, 1):
        writer.log(failed_attempt(attempt))
    assert (with_failures / "attempts.jsonl").read_bytes() == whole
    assert resume(with_failures).repairs == []


def test_other_lines_stay_the_bytes_that_they_were(with_failures):
    """Those of an earlier version may lack a key, or have one that is unknown today."""

    def change(lines):
        lines[2] = lines[2].replace(b'"seed"', b'"mood": "good", "seed"')
        lines[3] = b"{\n"

    damage(with_failures, change)
    resume(with_failures)
    lines = (with_failures / "attempts.jsonl").read_bytes().splitlines(keepends=True)
    assert b'"mood": "good"' in lines[2]
    assert lines[3] == to_json(made(2, 3).attempt)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda lines: lines.insert(2, lines[1]), "line 3: attempt 1 is there twice"),
        (lambda lines: lines.__setitem__(1, to_json(failed_attempt(4))), "line 5: attempt 4 is there twice"),
        (lambda lines: lines.__setitem__(4, to_json(failed_attempt(99))), "attempt 99 is there, and 6 is not"),
        (lambda lines: lines.__setitem__(4, to_json(failed_attempt(-4))), "line 5: attempt: -4 is no number"),
        (
            lambda lines: lines.__setitem__(3, to_json(made(2, 93).attempt)),
            "attempt 93 is to be ep_000002, which is attempt 3",
        ),
    ],
)
def test_a_line_that_tells_what_cannot_be_is_left_out(with_failures, change, fault):
    whole = damage(with_failures, change)
    writer = resume(with_failures)
    assert f"({fault}" in writer.repairs[0]
    for attempt in writer.lost_lines & {1, 4}:
        writer.log(failed_attempt(attempt))
    assert writer.lost_lines == set()
    assert (with_failures / "attempts.jsonl").read_bytes() == whole


def test_lines_out_of_order_are_put_into_order(with_failures):
    whole = damage(with_failures, lambda lines: lines.reverse())
    assert resume(with_failures).repairs == []
    assert (with_failures / "attempts.jsonl").read_bytes() == whole


def test_what_contradicts_its_episode_is_not_resumed(with_failures):
    damage(with_failures, lambda lines: lines.__setitem__(2, to_json(failed_attempt(2))))
    before = tree(with_failures)
    with pytest.raises(DatasetError, match=r"ep_000001 is attempt 2, which attempts\.jsonl tells otherwise"):
        resume(with_failures)
    assert tree(with_failures) == before


def test_episodes_out_of_order_are_not_resumed(build):
    path = build(made(0, 3), made(1, 2))
    with pytest.raises(DatasetError, match="not in the order of their attempts"):
        resume(path)


def test_a_ledger_that_cannot_be_mended_stays_as_it_is(with_failures, monkeypatch, failing):
    def change(lines):
        lines[2] = b"{\n"

    damage(with_failures, change)
    before = tree(with_failures)
    failing(3)
    with pytest.raises(ResourceError, match="cannot be written"):
        resume(with_failures)
    monkeypatch.undo()
    assert tree(with_failures) | before == tree(with_failures)


def test_no_ledger_is_no_attempts(tmp_path):
    assert Ledger(tmp_path).known == {}


def test_an_episode_published_just_before_a_crash_is_adopted(dataset):
    writer = resume(dataset)
    writer.log(failed_attempt(3))
    writer.publish(made(3, attempt=4).record, made(3).files)
    again = resume(dataset)
    assert numbers(again)[-2:] == [(3, None), (4, 3)]
    assert again.attempts[-1] == made(3, attempt=4).attempt
    assert again.missing == []
    assert from_json(AttemptRecord, (dataset / "attempts.jsonl").read_text().splitlines()[-1], "x").episode == 3


def test_an_episode_far_ahead_of_the_ledger_leaves_attempts_to_be_made_again(dataset):
    resume(dataset).publish(made(3, attempt=9).record, made(3).files)
    writer = resume(dataset)
    assert writer.lost_lines == set(range(3, 9))
    assert writer.attempts[9] == made(3, attempt=9).attempt


def test_a_lost_manifest_is_built_again(dataset):
    before = (dataset / "manifest.json").read_bytes()
    (dataset / "manifest.json").unlink()
    resume(dataset).finish()
    assert (dataset / "manifest.json").read_bytes() == before


def test_a_lost_episode_is_missing_and_can_be_made_again(dataset):
    before = tree(dataset)
    shutil.rmtree(dataset / "ep_000001")
    writer = resume(dataset)
    assert writer.missing == [made(1).attempt]
    assert writer.episodes == 3
    assert [entry.episode for entry in writer.finish().episodes] == [0, 2]
    writer.publish(made(1).record, made(1).files)
    assert writer.missing == []
    writer.finish()
    assert tree(dataset) == before


def test_a_file_in_the_place_of_an_episode_is_moved_out_of_the_way(dataset):
    shutil.rmtree(dataset / "ep_000001")
    (dataset / "ep_000001").write_text("")
    writer = resume(dataset)
    assert [attempt.episode for attempt in writer.missing] == [1]
    assert "ep_000001 is no directory" in writer.repairs[0]
    writer.publish(made(1).record, made(1).files)


def truncate(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1])


def alter(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1] + b"\0")


@pytest.mark.parametrize(
    ("file", "damage", "fault"),
    [
        ("episode.json", lambda path: path.write_bytes(b""), "episode.json: "),
        ("episode.json", lambda path: path.write_bytes(b"{"), "episode.json: "),
        ("episode.json", lambda path: path.write_bytes(b"\xff"), "episode.json: "),
        ("episode.json", lambda path: path.write_bytes(to_json(made(2).record)), "episode.json is that of episode 2"),
        ("episode.json", Path.unlink, "episode.json is missing"),
        ("rgb/scene_camera/000003.jpg", truncate, "rgb/scene_camera/000003.jpg is not what was recorded"),
        ("rgb/scene_camera/000003.jpg", alter, "rgb/scene_camera/000003.jpg is not what was recorded"),
        ("lowdim/000000.pkl", truncate, "lowdim/000000.pkl is not what was recorded"),
        ("lowdim/000000.pkl", Path.unlink, "lowdim/000000.pkl is missing"),
    ],
)
def test_a_damaged_episode_is_moved_out_of_the_way_named_and_made_again(dataset, file, damage, fault):
    before = tree(dataset)
    damage(dataset / "ep_000001" / file)
    damaged = tree(dataset / "ep_000001")
    writer = resume(dataset)
    assert writer.missing == [made(1).attempt]
    assert len(writer.repairs) == 1
    aside = dataset / ".damaged/ep_000001.1"
    assert writer.repairs[0].startswith(f"ep_000001: {fault}")
    assert writer.repairs[0].endswith(f"; moved to {aside}, and made again")
    assert tree(aside) == damaged, "nothing is thrown away"

    writer.publish(made(1).record, made(1).files)
    writer.finish()
    shutil.rmtree(dataset / ".damaged")
    assert tree(dataset) == before
    assert resume(dataset).repairs == []


def test_an_episode_damaged_twice_is_moved_to_two_places(dataset):
    for k in (1, 2):
        (dataset / "ep_000001/lowdim/000000.pkl").unlink()
        writer = resume(dataset)
        assert (dataset / f".damaged/ep_000001.{k}").is_dir()
        writer.publish(made(1).record, made(1).files)


def test_a_damaged_episode_that_is_not_in_the_ledger_yet_is_simply_the_next(dataset):
    resume(dataset).publish(made(3).record, made(3).files)
    (dataset / "ep_000003/lowdim/000000.pkl").unlink()
    writer = resume(dataset)
    assert (len(writer.attempts), writer.missing) == (3, [])
    assert not (dataset / "ep_000003").exists()


def test_what_a_crash_left_half_written_is_removed_and_never_counted(dataset):
    (dataset / ".staging/ep_000003.abc").mkdir(parents=True)
    (dataset / ".staging/ep_000003.abc/episode.json").write_bytes(to_json(made(3).record))
    writer = resume(dataset)
    assert writer.episodes == 3
    assert not (dataset / ".staging").exists()


@pytest.mark.parametrize("name", [".lock", ".staging", ".config.yaml.0123456789abcdef0123456789abcdef.part"])
@pytest.mark.parametrize("mode", OpenMode)
def test_what_a_crash_left_of_an_empty_dataset_is_in_nobodys_way(tmp_path, name, mode):
    (tmp_path / name).mkdir() if name == ".staging" else (tmp_path / name).touch()
    writer = opened(tmp_path, mode=mode)
    assert writer.moved_aside is None
    assert tree(tmp_path).keys() == {"config.yaml"}


def test_what_a_crash_left_beside_the_manifest_is_removed(dataset):
    before = tree(dataset)
    (dataset / f".manifest.json.{'0' * 32}.part").write_bytes(b"{")
    resume(dataset)
    assert tree(dataset) == before


def test_an_episode_is_never_published_over_another(dataset):
    before = tree(dataset)
    with pytest.raises(FileExistsError):
        resume(dataset).publish(made(1, frames=[]).record, {})
    assert tree(dataset) == before
