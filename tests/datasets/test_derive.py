"""Datasets from datasets: merged, split and filtered, by hash, resumable and never half visible."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.cli.run_cli import yamsim
from tests.core.dataset.making import CONFIG, made, tree, write_dataset
from yamsim_cli.core.dataset.reader import open_recorded_episode
from yamsim_cli.core.dataset.writing.directory_claim import ExistingDatasetMode
from yamsim_cli.core.dataset.writing.writer import DatasetWriter
from yamsim_cli.core.errors import DatasetError
from yamsim_cli.datasets.derive import (
    assign_parts,
    filter_dataset,
    group_by_start,
    merge_datasets,
    open_source_dataset,
    split_dataset,
)
from yamsim_cli.selection import EpisodeDecision, Selection, episode_hash, read_selection, write_selection


def ignore(done: int, total: int) -> None:
    """Ignore progress."""


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    return write_dataset(tmp_path / "dataset", *(made(k) for k in range(10)))


def test_merge_copies_whole_episodes_once_with_provenance(tmp_path: Path, dataset: Path) -> None:
    other = write_dataset(tmp_path / "other", made(0), made(1))  # equal those of the dataset
    shutil.rmtree(dataset / "ep_000001")
    run = yamsim("merge", dataset, other, "--out", tmp_path / "both", "--json")
    assert run.code == 0, run.err
    assert (run.json["episodes"], run.json["duplicates"]) == (10, 1)
    both = tmp_path / "both"
    assert json.loads((both / "ep_000009/episode.json").read_text())["episode"] == 9
    wanted = tree(other / "ep_000001")
    wanted["episode.json"] = (both / "ep_000009/episode.json").read_bytes()
    assert tree(both / "ep_000009") == wanted
    record, copied = (open_recorded_episode(path).record for path in (other / "ep_000001", both / "ep_000009"))
    assert copied == record.model_copy(update={"episode": 9})
    provenance = json.loads((both / "provenance.json").read_text())
    assert [source["dataset"] for source in provenance["sources"]] == ["dataset", "other"]
    assert provenance["episodes"][9] == {
        "episode": 9, "source": 1, "source_episode": 1, "source_sha256": episode_hash(other / "ep_000001"),
    }  # fmt: skip
    assert not [path for path in tmp_path.iterdir() if path.name.endswith(".part")]


def test_the_result_is_a_dataset_without_problems_of_its_own(tmp_path: Path, dataset: Path) -> None:
    filter_dataset(open_source_dataset(0, dataset, episodes="2-5"), tmp_path / "some", ignore)
    before, after = (
        {p["code"] for p in yamsim("summarize", path, "--json").json["problems"]}
        for path in (dataset, tmp_path / "some")
    )
    assert after <= before
    with pytest.raises(DatasetError, match="made from other datasets"):
        DatasetWriter(tmp_path / "some", CONFIG, ExistingDatasetMode.RESUME)


def test_datasets_of_other_configs_are_not_merged(tmp_path: Path, dataset: Path) -> None:
    other = write_dataset(tmp_path / "other", made(0))
    config = other / "config.yaml"
    config.write_text(config.read_text().replace("arm1", "arm2").replace("seed: 7", "seed: 8"))
    run = yamsim("merge", dataset, other, "--out", tmp_path / "both")
    assert run.code == 3
    assert "arms differ from" in run.message
    config.write_text(config.read_text().replace("arm2", "arm1"))
    assert yamsim("merge", dataset, other, "--out", tmp_path / "both").code == 0


@pytest.mark.slow
def test_an_interrupted_copy_is_not_visible_and_continues(tmp_path: Path, dataset: Path) -> None:
    out = tmp_path / "out"

    def interrupt(done: int, total: int) -> None:
        if done == 4:
            raise KeyboardInterrupt

    source = open_source_dataset(0, dataset, episodes="0-7")
    with pytest.raises(Exception, match="the same command continues it"):
        filter_dataset(source, out, interrupt)
    assert not out.exists()
    damaged = next((tmp_path / "out.part/ep_000002/lowdim").iterdir())
    damaged.write_bytes(b"cut")
    done = filter_dataset(source, out, ignore)
    assert (done.episodes, done.kept) == (8, 3)
    filter_dataset(source, tmp_path / "again", ignore)
    assert tree(out) == tree(tmp_path / "again")
    assert filter_dataset(source, out, ignore).kept == 8
    run = yamsim("filter", dataset, "--episodes", "1", "--out", out)
    assert run.code == 2
    assert "was not made from these episodes" in run.message


def test_an_altered_file_is_refused(tmp_path: Path, dataset: Path) -> None:
    next((dataset / "ep_000003/lowdim").iterdir()).write_bytes(b"altered")
    run = yamsim("filter", dataset, "--episodes", "2-4", "--out", tmp_path / "out")
    assert run.code == 4
    assert "is not what was recorded" in run.message
    assert not (tmp_path / "out").exists()


def test_decisions_travel_with_the_copies(tmp_path: Path, dataset: Path) -> None:
    def decide(number: int, **values: object) -> EpisodeDecision:
        return EpisodeDecision(episode=number, sha256=episode_hash(dataset / f"ep_{number:06d}"), **values)

    decisions = {0: decide(0, decision="drop"), 4: decide(4, decision="keep", first_frame=1, tags=("slow",))}
    file = tmp_path / "s.yaml"
    write_selection(file, Selection("dataset", "keep", decisions))
    run = yamsim("filter", dataset, "--selection", file, "--out", tmp_path / "kept", "--json")
    assert (run.json["episodes"], run.json["selections"][0]["dropped"]) == (9, 1)
    kept = read_selection(tmp_path / "kept/selection.yaml").decisions
    assert set(kept) == {3}
    assert (kept[3].first_frame, kept[3].tags) == (1, ("slow",))
    assert kept[3].sha256 == episode_hash(tmp_path / "kept/ep_000003")


def test_parts_share_no_start(tmp_path: Path, dataset: Path) -> None:
    starts = [made(k, attempt=20 + k) for k in range(10)]  # the starts of the dataset, with other attempts
    other = write_dataset(tmp_path / "other", *starts)
    for k in range(10):  # other values
        file = other / f"ep_{k:06d}/episode.json"
        file.write_text(json.dumps(json.loads(file.read_text()) | {"content_sha256": f"{k:064d}"}))
    sources = [open_source_dataset(k, path) for k, path in enumerate((dataset, other))]
    merge_datasets(sources, tmp_path / "both", ignore)
    source = open_source_dataset(0, tmp_path / "both")
    assert [len(group) for group in group_by_start(source.episodes)] == [2] * 10
    parts = assign_parts(source.episodes, {"train": 0.7, "test": 0.3}, seed=1)
    assert {name: len(items) for name, items in parts.items()} == {"train": 14, "test": 6}
    layouts = {name: {str(item.episode.record.layout) for item in items} for name, items in parts.items()}
    assert not layouts["train"] & layouts["test"]
    assert assign_parts(source.episodes, {"train": 0.7, "test": 0.3}, seed=2) != parts
    done = split_dataset(source, tmp_path / "parts", {"train": 0.7, "test": 0.3}, 1, ignore)
    assert {name: made.episodes for name, made in done.items()} == {"train": 14, "test": 6}
    assert len(list((tmp_path / "parts/test").glob("ep_*"))) == 6


@pytest.mark.parametrize("parts", [["train=0.8"], ["train=2"], ["a=0.5", "a=0.5"], ["../x=0.5", "b=0.5"], ["a=0.5.5"]])
def test_a_wrong_share_is_one_line(tmp_path: Path, dataset: Path, parts: list[str]) -> None:
    words = [word for part in parts for word in ("--part", part)]
    run = yamsim("split", dataset, "--out", tmp_path / "parts", *words)
    assert run.code == 2
    assert "--part" in run.message


def test_a_part_without_episodes_is_one_line(tmp_path: Path, dataset: Path) -> None:
    run = yamsim("split", dataset, "--out", tmp_path / "parts", "--part", "a=0.99", "--part", "b=0.01")
    assert run.code == 2
    assert "no episode is left for it" in run.message
