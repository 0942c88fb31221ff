import errno
import json
import os
import shutil
from pathlib import Path

import pytest

from tests.core.dataset.making import CONFIG, failed_attempt, made, publish, tree
from yamsim_cli.core.dataset.records import AttemptRecord, Manifest, from_json, to_json
from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode
from yamsim_cli.core.dataset.writing.ledger import LOST_LINE_OUTCOME, Ledger
from yamsim_cli.core.dataset.writing.writer import DatasetWriter
from yamsim_cli.core.errors import ConfigError, DatasetError, ResourceError, UsageError
from yamsim_cli.core.files.documents.yaml_document import load_yaml


def resume(path: Path, config: dict = CONFIG, mode: ExistingDatasetMode = ExistingDatasetMode.RESUME) -> DatasetWriter:
    """A writer that has released its lock, so that a test can open a dataset several times."""
    with DatasetWriter(path, config, mode) as writer:
        return writer


def numbers(writer: DatasetWriter) -> list[tuple[int, int | None]]:
    return [(attempt.attempt, attempt.episode) for attempt in writer.attempts]


@pytest.mark.parametrize("mode", ExistingDatasetMode)
@pytest.mark.parametrize("exists", [True, False])
def test_a_new_or_empty_directory_is_taken_in_every_mode(tmp_path, mode, exists):
    path = tmp_path / "some/where"
    if exists:
        path.mkdir(parents=True)
    writer = resume(path, CONFIG, mode)
    assert load_yaml(path / "config.yaml").data == CONFIG
    assert (writer.episodes, writer.attempts, writer.attempts_without_episode, writer.moved_aside) == (0, [], [], None)


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
        resume(dataset, CONFIG, ExistingDatasetMode.NEW)
    assert tree(dataset) == before


@pytest.mark.parametrize(
    ("what", "obstacle"), [("file", "it is a file"), ("link", "it is a link to gone, which does not exist")]
)
def test_a_path_that_is_no_directory_is_refused_and_can_be_moved_aside(tmp_path, what, obstacle):
    path = tmp_path / "out"
    path.write_text("precious") if what == "file" else path.symlink_to("gone")
    with pytest.raises(UsageError, match=f"{path} is not a directory: {obstacle}; move it aside with --overwrite"):
        resume(path, CONFIG, ExistingDatasetMode.NEW)
    with pytest.raises(UsageError, match=f"{path} is not a dataset to resume: {obstacle}; choose another --out"):
        resume(path)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert resume(path, CONFIG, ExistingDatasetMode.OVERWRITE).moved_aside == tmp_path / "out.old-1"
    assert os.path.lexists(tmp_path / "out.old-1")
    assert (path / "config.yaml").is_file()


def test_overwriting_moves_aside_as_often_as_it_is_asked(dataset):
    first = tree(dataset)
    for k in (1, 2):
        writer = resume(dataset, {**CONFIG, "seed": k}, ExistingDatasetMode.OVERWRITE)
        assert writer.moved_aside == dataset.with_name(f"dataset.old-{k}")
        assert tree(dataset).keys() == {"config.yaml"}
    assert tree(dataset.with_name("dataset.old-1")) == first
    assert load_yaml(dataset.with_name("dataset.old-2") / "config.yaml").data["seed"] == 1


@pytest.mark.parametrize("mode", ExistingDatasetMode)
def test_a_disk_that_refuses_is_a_resource_error_with_its_reason(tmp_path, monkeypatch, mode):
    monkeypatch.setattr("yamsim_cli.core.dataset.writing.writer.write_file", refuse)
    with pytest.raises(ResourceError, match=r"cannot be written: Read-only file system: .*; choose another --out"):
        resume(tmp_path / "dataset", CONFIG, mode)


def test_resuming_goes_on_where_it_ended(dataset):
    writer = resume(dataset)
    assert numbers(writer) == [(0, 0), (1, 1), (2, 2)]
    writer.log_attempt(failed_attempt(3))
    publish(writer, made(3, attempt=4))
    manifest = writer.write_manifest()
    assert (manifest.attempts, len(manifest.episodes)) == (5, 4)
    assert numbers(resume(dataset)) == [(0, 0), (1, 1), (2, 2), (3, None), (4, 3)]


def test_resuming_and_finishing_changes_nothing(dataset):
    before = tree(dataset)
    resume(dataset).write_manifest()
    assert tree(dataset) == before


def test_a_directory_without_a_dataset_is_not_resumed(tmp_path):
    (tmp_path / "thesis.tex").write_text("")
    with pytest.raises(DatasetError, match=r"has no config\.yaml, so it cannot be resumed"):
        resume(tmp_path)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"seed": 8}, "another configuration: seed: 7 there, 8 now; run with"),
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


def test_a_long_list_of_changes_is_cut(dataset):
    with pytest.raises(ConfigError, match="and 5 more"):
        resume(dataset, CONFIG | {f"key{k}": k for k in range(10)})


def test_tuples_and_lists_are_the_same_configuration(tmp_path):
    path = tmp_path / "d"
    config = CONFIG | {"size": (640, 480)}
    resume(path, config, ExistingDatasetMode.NEW)
    resume(path, config)


def test_a_damaged_config_is_not_resumed(dataset):
    (dataset / "config.yaml").write_bytes(b"\x00\xff")
    with pytest.raises(ConfigError, match="not valid YAML"):
        resume(dataset)


def refuse(*_):
    raise OSError(errno.EROFS, os.strerror(errno.EROFS))


def test_an_attempt_that_could_not_be_written_does_not_count(dataset, monkeypatch):
    writer = resume(dataset)
    monkeypatch.setattr("yamsim_cli.core.dataset.writing.writer.append_line", refuse)
    with pytest.raises(OSError, match="Read-only"):
        writer.log_attempt(failed_attempt(3))
    assert len(writer.attempts) == 3


@pytest.mark.parametrize("kept", [b"", b"{", b'{"attempt": 2, "seed": 7, "epi', '{"detail": "3°'.encode()[:-1]])
def test_a_cut_off_last_line_of_the_ledger_is_forgotten_and_its_episode_adopted(dataset, kept):
    ledger = dataset / "attempts.jsonl"
    whole = ledger.read_bytes()
    ledger.write_bytes(b"".join(whole.splitlines(keepends=True)[:2]) + kept)
    assert len(Ledger(dataset).known_attempts) == 2
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
    writer.log_attempt(failed_attempt(1))
    writer.log_attempt(failed_attempt(2))
    assert numbers(resume(path)) == [(0, 0), (1, None), (2, None)]


def test_a_last_line_that_only_lacks_its_end_counts(dataset):
    ledger = dataset / "attempts.jsonl"
    ledger.write_bytes(ledger.read_bytes()[:-1])
    writer = resume(dataset)
    assert len(writer.attempts) == 3
    writer.log_attempt(failed_attempt(3))
    assert len(Ledger(dataset).known_attempts) == 4


BROKEN = [b"{\n", b"\xff\xfe\n", b"null\n", b"{}\n", b"\n", b""]


@pytest.fixture
def with_failures(build):
    """Attempts 0 to 5; 1 and 4 failed."""
    path = build(made(0))
    writer = resume(path)
    for attempt, episode in enumerate((0, None, 1, 2, None, 3)):
        if attempt and episode is None:
            writer.log_attempt(failed_attempt(attempt))
        elif attempt:
            publish(writer, made(episode, attempt))
    writer.write_manifest()
    return path


def damage(dataset: Path, change) -> bytes:
    """Damage the ledger's lines (bytes), and return the original."""
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
    assert (writer.lost_lines, writer.attempts_without_episode, len(writer.attempts), writer.episodes) == (
        set(),
        [],
        6,
        4,
    )
    kept = with_failures / ".damaged/attempts.jsonl.1"
    if broken.strip():
        assert kept.read_bytes() == spoiled
        assert writer.repairs[0].startswith(f"attempts.jsonl was damaged (line {number + 1}: ")
        assert writer.repairs[0].endswith(f"): repaired; the damaged file is {kept}")
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
        assert writer.attempts[1].outcome == LOST_LINE_OUTCOME
        assert writer.repairs[-1] == "the line of attempt 1 in attempts.jsonl is lost"
    writer.log_attempt(failed_attempt(1))
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
        writer.log_attempt(failed_attempt(attempt))
    assert (with_failures / "attempts.jsonl").read_bytes() == whole
    assert resume(with_failures).repairs == []


def test_other_lines_stay_the_bytes_that_they_were(with_failures):
    """Lines of an earlier version may lack a key, or have one that is unknown today."""

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
        (lambda lines: lines.insert(2, lines[1]), "line 3: attempt 1 is listed twice"),
        (lambda lines: lines.__setitem__(1, to_json(failed_attempt(4))), "line 5: attempt 4 is listed twice"),
        (
            lambda lines: lines.__setitem__(4, to_json(failed_attempt(99))),
            "attempt 99 is listed, but attempt 6 is missing",
        ),
        (lambda lines: lines.__setitem__(4, to_json(failed_attempt(-4))), "line 5: attempt: -4 is not the number"),
        (
            lambda lines: lines.__setitem__(3, to_json(made(2, 93).attempt)),
            "attempt 93 is listed as ep_000002, but ep_000002 is attempt 3",
        ),
    ],
)
def test_an_impossible_line_of_the_ledger_is_dropped(with_failures, change, fault):
    whole = damage(with_failures, change)
    writer = resume(with_failures)
    assert f"({fault}" in writer.repairs[0]
    for attempt in writer.lost_lines & {1, 4}:
        writer.log_attempt(failed_attempt(attempt))
    assert writer.lost_lines == set()
    assert (with_failures / "attempts.jsonl").read_bytes() == whole


def test_lines_out_of_order_are_put_into_order(with_failures):
    whole = damage(with_failures, lambda lines: lines.reverse())
    assert resume(with_failures).repairs == []
    assert (with_failures / "attempts.jsonl").read_bytes() == whole


def test_a_ledger_that_contradicts_an_episode_is_not_resumed(with_failures):
    damage(with_failures, lambda lines: lines.__setitem__(2, to_json(failed_attempt(2))))
    before = tree(with_failures)
    with pytest.raises(DatasetError, match=r"ep_000001 is attempt 2, but attempts\.jsonl lists another episode"):
        resume(with_failures)
    assert tree(with_failures) == before


def test_episodes_out_of_order_are_not_resumed(build):
    path = build(made(0, 3), made(1, 2))
    with pytest.raises(DatasetError, match="not in the order of their attempts"):
        resume(path)


def test_a_ledger_that_cannot_be_mended_stays_as_it_is(with_failures, monkeypatch):
    def change(lines):
        lines[2] = b"{\n"

    damage(with_failures, change)
    before = tree(with_failures)
    monkeypatch.setattr("yamsim_cli.core.dataset.writing.ledger.write_file", refuse)
    with pytest.raises(ResourceError, match="cannot be written"):
        resume(with_failures)
    monkeypatch.undo()
    assert tree(with_failures) == before


def test_an_episode_published_just_before_a_crash_is_adopted(dataset):
    writer = resume(dataset)
    writer.log_attempt(failed_attempt(3))
    writer.publish_episode(made(3, attempt=4).record, made(3).files)
    again = resume(dataset)
    assert numbers(again)[-2:] == [(3, None), (4, 3)]
    assert again.attempts[-1] == made(3, attempt=4).attempt
    assert again.attempts_without_episode == []
    assert from_json(AttemptRecord, (dataset / "attempts.jsonl").read_text().splitlines()[-1], "x").episode == 3


def test_an_episode_far_ahead_of_the_ledger_leaves_attempts_to_be_made_again(dataset):
    resume(dataset).publish_episode(made(3, attempt=9).record, made(3).files)
    writer = resume(dataset)
    assert writer.lost_lines == set(range(3, 9))
    assert writer.attempts[9] == made(3, attempt=9).attempt


def test_a_lost_manifest_is_built_again(dataset):
    before = (dataset / "manifest.json").read_bytes()
    (dataset / "manifest.json").unlink()
    resume(dataset).write_manifest()
    assert (dataset / "manifest.json").read_bytes() == before


def test_a_lost_episode_is_missing_and_can_be_made_again(dataset):
    before = tree(dataset)
    shutil.rmtree(dataset / "ep_000001")
    writer = resume(dataset)
    assert writer.attempts_without_episode == [made(1).attempt]
    assert writer.episodes == 3
    assert [entry.episode for entry in writer.write_manifest().episodes] == [0, 2]
    writer.publish_episode(made(1).record, made(1).files)
    assert writer.attempts_without_episode == []
    writer.write_manifest()
    assert tree(dataset) == before


def test_a_file_in_the_place_of_an_episode_is_moved_out_of_the_way(dataset):
    shutil.rmtree(dataset / "ep_000001")
    (dataset / "ep_000001").write_text("")
    writer = resume(dataset)
    assert [attempt.episode for attempt in writer.attempts_without_episode] == [1]
    assert "ep_000001 is not a directory" in writer.repairs[0]
    writer.publish_episode(made(1).record, made(1).files)


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
        ("episode.json", lambda path: path.write_bytes(to_json(made(2).record)), "episode.json is of episode 2"),
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
    assert writer.attempts_without_episode == [made(1).attempt]
    assert len(writer.repairs) == 1
    aside = dataset / ".damaged/ep_000001.1"
    assert writer.repairs[0].startswith(f"ep_000001: {fault}")
    assert writer.repairs[0].endswith(f"; moved to {aside}, to be recorded again")
    assert tree(aside) == damaged, "nothing is thrown away"

    writer.publish_episode(made(1).record, made(1).files)
    writer.write_manifest()
    shutil.rmtree(dataset / ".damaged")
    assert tree(dataset) == before
    assert resume(dataset).repairs == []


def test_an_episode_damaged_twice_is_moved_to_two_places(dataset):
    for k in (1, 2):
        (dataset / "ep_000001/lowdim/000000.pkl").unlink()
        writer = resume(dataset)
        assert (dataset / f".damaged/ep_000001.{k}").is_dir()
        writer.publish_episode(made(1).record, made(1).files)


def test_a_damaged_episode_that_is_not_in_the_ledger_yet_is_simply_the_next(dataset):
    resume(dataset).publish_episode(made(3).record, made(3).files)
    (dataset / "ep_000003/lowdim/000000.pkl").unlink()
    writer = resume(dataset)
    assert (len(writer.attempts), writer.attempts_without_episode) == (3, [])
    assert not (dataset / "ep_000003").exists()


def test_what_a_crash_left_half_written_is_removed_and_never_counted(dataset):
    before = tree(dataset)
    (dataset / ".staging/ep_000003.abc").mkdir(parents=True)
    (dataset / ".staging/ep_000003.abc/episode.json").write_bytes(to_json(made(3).record))
    (dataset / f".manifest.json.{'0' * 32}.part").write_bytes(b"{")
    assert resume(dataset).episodes == 3
    assert tree(dataset) == before


@pytest.mark.parametrize("name", [".lock", ".staging", ".config.yaml.0123456789abcdef0123456789abcdef.part"])
@pytest.mark.parametrize("mode", ExistingDatasetMode)
def test_leftovers_of_a_crash_in_an_empty_dataset_do_not_block_a_new_recording(tmp_path, name, mode):
    (tmp_path / name).mkdir() if name == ".staging" else (tmp_path / name).touch()
    writer = resume(tmp_path, mode=mode)
    assert writer.moved_aside is None
    assert tree(tmp_path).keys() == {"config.yaml"}
