"""Decisions on episodes: the file, what it does to a dataset, and two reviewers."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import yamsim_cli
from tests.cli.run_cli import yamsim
from tests.core.dataset.making import CAMERA, FRAMES, made, write_dataset
from yamsim_cli.core.dataset.dataset_paths import EPISODE_FILE
from yamsim_cli.core.errors import ConfigError, DatasetError
from yamsim_cli.selection import (
    EpisodeDecision,
    Selection,
    apply_selection,
    episode_hash,
    merge_selections,
    read_selection,
    selection_text,
    write_selection,
)


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    return write_dataset(tmp_path / "dataset", *(made(k) for k in range(4)))


Decide = Callable[..., EpisodeDecision]


@pytest.fixture
def decide(dataset: Path) -> Decide:
    def make(episode: int, decision: str = "keep", **values: object) -> EpisodeDecision:
        sha256 = episode_hash(dataset / f"ep_{episode:06d}")
        return EpisodeDecision(episode=episode, decision=decision, sha256=sha256, **values)

    return make


def selection_of(*decisions: EpisodeDecision, undecided: str = "keep") -> Selection:
    return Selection("dataset", undecided, {decision.episode: decision for decision in decisions})


def write(path: Path, *decisions: EpisodeDecision, undecided: str = "keep") -> Path:
    write_selection(path, selection_of(*decisions, undecided=undecided))
    return path


def test_a_file_has_a_line_for_each_episode_and_is_read_back(tmp_path: Path, decide: Decide) -> None:
    decisions = [
        decide(2, "drop", tags=("blurred", "späť: {x}"), note='she said "no"; a: b # c', reviewer="ann"),
        decide(0, first_frame=1, last_frame=2),
    ]
    file = write(tmp_path / "s.yaml", *decisions)
    assert len([line for line in file.read_text().splitlines() if line.startswith("- ")]) == 2
    assert read_selection(file) == selection_of(*decisions)
    assert selection_text(read_selection(file)) == file.read_text()


def test_a_line_that_a_person_wrote_is_read(tmp_path: Path, decide: Decide) -> None:
    sha256 = decide(1).sha256
    file = tmp_path / "s.yaml"
    file.write_text(
        "format: yamsim-selection\nformat_version: 1\nepisodes:\n# mine\n"
        f"- {{episode: 1, decision: drop, sha256: '{sha256}', tags: [dark]}}\n"
    )
    assert read_selection(file).decisions == {1: decide(1, "drop", tags=("dark",))}


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ('- {"episode": 1, "decision": "perhaps", "sha256": "SHA"}', ":5: decision: Input should be 'keep', 'drop'"),
        ('- {"episode": 1, "decision": "keep", "sha256": "12"}', ":5: sha256: "),
        ('- {"episode": 1, "decision": "keep", "sha256": "SHA", "trim": 3}', "valid: episode, decision, sha256"),
        ('- {"episode": 1, "decision": "keep", "sha256": "SHA", "last_frame": 2, "first_frame": 3}', "not be above"),
        ('- {"episode": 1, "decision": "keep", "sha256": "SHA", "note": "a\\u2028b"}', "one line of printable"),
        ('- {"episode": 1, "decision": "keep", "sha256": "SHA"}\n' * 2,
         ":6: episode 1 has an earlier line"),
        ('- {"episode": 1, "deci', ":5"),
        ("episode: 3", ":5: a line of an episode must begin"),
    ],
)  # fmt: skip
def test_a_fault_is_told_with_its_line(tmp_path: Path, line: str, told: str) -> None:
    file = tmp_path / "s.yaml"
    head = "format: yamsim-selection\nformat_version: 1\nundecided: keep\nepisodes:\n"
    file.write_text(head + line.replace("SHA", "a" * 64) + "\n")
    with pytest.raises(ConfigError) as refused:
        read_selection(file)
    assert told in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_file_that_is_cut_off_is_refused(tmp_path: Path, decide: Decide) -> None:
    file = write(tmp_path / "s.yaml", decide(0), decide(1))
    whole = file.read_bytes()
    heads = whole.index(b"- {")
    for end in (0, 5, heads - 12, heads + 9, len(whole) - 1):
        file.write_bytes(whole[:end])
        with pytest.raises(ConfigError, match=r"s\.yaml"):
            read_selection(file)


def test_open_dataset_leaves_out_and_trims(tmp_path: Path, dataset: Path, decide: Decide) -> None:
    file = write(tmp_path / "s.yaml", decide(1, "drop"), decide(2, first_frame=1, last_frame=2))
    kept = yamsim_cli.open_dataset(dataset, selection=file)
    whole = yamsim_cli.open_dataset(dataset)
    assert [episode.record.episode for episode in kept] == [0, 2, 3]
    assert [episode.record.episode for episode in kept[1:]] == [2, 3]
    trimmed, full = kept[1], whole[2]
    assert [frame["timestamp"] for frame in trimmed.frames()] == [f["timestamp"] for f in full.frames()[1:3]]
    assert trimmed.record.frames == len(trimmed.frames()) == 2
    assert np.array_equal(trimmed.frames()[0]["joints"], full.frames()[1]["joints"])
    assert [trimmed.image(CAMERA, k) for k in range(2)] == [full.image(CAMERA, k) for k in (1, 2)]
    assert len(kept[0].frames()) == FRAMES


def test_undecided_episodes_can_be_left_out(tmp_path: Path, dataset: Path, decide: Decide) -> None:
    file = write(tmp_path / "s.yaml", decide(1), decide(2, "drop"), undecided="drop")
    applied = apply_selection(dataset, file)
    assert applied.kept == {1}
    assert (applied.dropped, applied.undecided) == (1, 2)
    assert "1 of 4 episodes kept, 1 dropped, 2 undecided and left out" in applied.summary()


@pytest.mark.parametrize("command", ["summarize", "verify", "export mp4", "replay"])
def test_a_stale_decision_is_one_line(command: str, tmp_path: Path, dataset: Path, decide: Decide) -> None:
    file = write(tmp_path / "s.yaml", decide(0), decide(1, "drop"))
    record = dataset / "ep_000001" / EPISODE_FILE
    record.write_text(json.dumps(json.loads(record.read_text()) | {"rig": "other"}))
    words = {"export mp4": ["out"], "replay": ["--episode", "0", "--video", "a.mp4"]}.get(command, [])
    run = yamsim(*command.split(), dataset, *words, "--selection", file, cwd=tmp_path)
    assert run.code == 4
    assert "the decision on ep_000001 is stale" in run.message


def test_a_decision_on_a_missing_episode_and_a_trim_outside_are_refused(
    tmp_path: Path, dataset: Path, decide: Decide
) -> None:
    gone = decide(1).model_copy(update={"episode": 9})
    with pytest.raises(DatasetError, match="ep_000009 is not in"):
        apply_selection(dataset, write(tmp_path / "a.yaml", gone))
    with pytest.raises(DatasetError, match=r"has frames 0 to 3, and is trimmed to 2 to 9"):
        apply_selection(dataset, write(tmp_path / "b.yaml", decide(1, first_frame=2, last_frame=9)))
    with pytest.raises(DatasetError, match="keeps no episode"):
        apply_selection(dataset, write(tmp_path / "c.yaml", undecided="drop"))


def test_summarize_counts_what_is_kept(tmp_path: Path, dataset: Path, decide: Decide) -> None:
    file = write(tmp_path / "s.yaml", decide(3, "drop"))
    run = yamsim("summarize", dataset, "--selection", file, "--json")
    report = run.json
    assert report["episodes"] == 3
    assert report["selection"] | {"file": "", "sha256": ""} == {
        "file": "", "sha256": "", "kept": 3, "dropped": 1, "undecided_left_out": 0, "trimmed": 0,
    }  # fmt: skip
    assert "ep_000003" not in {problem["episode"] for problem in report["problems"]}
    assert "ep_000003" in {problem["episode"] for problem in yamsim("summarize", dataset, "--json").json["problems"]}


def test_replay_refuses_a_dropped_episode(tmp_path: Path, dataset: Path, decide: Decide) -> None:
    file = write(tmp_path / "s.yaml", decide(3, "drop"))
    run = yamsim("replay", dataset, "--episode", "3", "--video", tmp_path / "a.mp4", "--selection", file)
    assert run.code == 2
    assert "left out by --selection" in run.message


def test_two_reviewers_are_merged(tmp_path: Path, decide: Decide) -> None:
    ann = selection_of(
        decide(0, "drop", reviewer="ann", note="dark"),
        decide(1, tags=("a",), reviewer="ann"),
        decide(2, first_frame=1, reviewer="ann"),
    )
    bob = selection_of(
        decide(0, "keep", reviewer="bob"),
        decide(1, "undecided", tags=("b",), reviewer="bob"),
        decide(2, first_frame=1, reviewer="bob"),
        decide(3, "drop", reviewer="bob"),
    )
    merged, conflicts = merge_selections(ann, bob)
    assert [(c.episode, c.first, c.second) for c in conflicts] == [(0, "drop (ann)", "keep (bob)")]
    assert {k: d.decision for k, d in merged.decisions.items()} == {0: "undecided", 1: "keep", 2: "keep", 3: "drop"}
    assert merged.decisions[0].note == "dark"
    assert merged.decisions[1].tags == ("a", "b")
    assert (merged.decisions[2].first_frame, merged.decisions[2].reviewer) == (1, "ann, bob")
    files = [tmp_path / name for name in ("ann.yaml", "bob.yaml", "both.yaml")]
    write_selection(files[0], ann)
    write_selection(files[1], bob)
    run = yamsim("review", "--merge", *files[:2], "--out", files[2])
    assert run.code == 6
    assert "conflict in ep_000000: drop (ann), and keep (bob)" in run.out
    assert read_selection(files[2]) == merged


def test_reviewers_of_other_contents_are_not_merged(decide: Decide) -> None:
    other = decide(0).model_copy(update={"sha256": "a" * 64})
    with pytest.raises(DatasetError, match="different contents"):
        merge_selections(selection_of(decide(0)), selection_of(other))
