import errno
import json
import os
import shutil
from pathlib import Path

import pytest

from tests.core.dataset.making import CONFIG, failed_attempt, made, publish
from yamsim_cli.core.config.document import load_yaml
from yamsim_cli.core.dataset.records import AttemptRecord, Manifest, from_json, to_json
from yamsim_cli.core.dataset.writer import DatasetWriter, OpenMode, read_attempts
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

    monkeypatch.setattr("yamsim_cli.core.dataset.writer.write_file", refuse)
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
    assert len(read_attempts(dataset)) == 2
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
    assert len(read_attempts(dataset)) == 4


def test_a_line_cut_off_inside_a_letter_is_forgotten_too(dataset):
    attempt = failed_attempt(3)
    attempt = attempt.model_copy(update={"outcome": attempt.outcome.model_copy(update={"detail": "3° off"})})
    cut = to_json(attempt).split("°".encode())[0] + "°".encode()[:1]
    with (dataset / "attempts.jsonl").open("ab") as stream:
        stream.write(cut)
    assert len(read_attempts(dataset)) == 3


@pytest.mark.parametrize("damage", [b"{\n", b"\xff\xfe\n", b"null\n", b"{}\n"])
def test_a_damaged_line_in_the_middle_of_the_ledger_is_named(dataset, damage):
    ledger = dataset / "attempts.jsonl"
    lines = ledger.read_bytes().splitlines(keepends=True)
    ledger.write_bytes(lines[0] + damage + lines[2])
    with pytest.raises(DatasetError, match=r"attempts\.jsonl:2: "):
        resume(dataset)


@pytest.mark.parametrize("order", [(0, 2), (1, 2), (0, 0), (0, 2, 1)])
def test_an_attempt_missing_from_the_ledger_is_named(dataset, order):
    ledger = dataset / "attempts.jsonl"
    lines = ledger.read_text().splitlines(keepends=True)
    ledger.write_text("".join(lines[k] for k in order))
    with pytest.raises(DatasetError, match=r"attempts\.jsonl:\d: attempt \d where \d was expected"):
        read_attempts(dataset)


def test_no_ledger_is_no_attempts(tmp_path):
    assert read_attempts(tmp_path) == []


def test_an_episode_published_just_before_a_crash_is_adopted(dataset):
    writer = resume(dataset)
    writer.log(failed_attempt(3))
    writer.publish(made(3, attempt=4).record, made(3).files)
    again = resume(dataset)
    assert numbers(again)[-2:] == [(3, None), (4, 3)]
    assert again.attempts[-1] == made(3, attempt=4).attempt
    assert again.missing == []
    assert from_json(AttemptRecord, (dataset / "attempts.jsonl").read_text().splitlines()[-1], "x").episode == 3


def test_an_episode_far_ahead_of_the_ledger_is_not_adopted(dataset):
    resume(dataset).publish(made(3, attempt=9).record, made(3).files)
    with pytest.raises(DatasetError, match=r"ep_000003 is attempt 9, but attempts\.jsonl ends before it"):
        resume(dataset)


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
