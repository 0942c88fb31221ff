"""`yamsim summarize` as a user runs it."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from tests.cli.run_cli import yamsim
from tests.datasets.checks.sample import SampleDataset, episode
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.dataset.checks.problem import PROBLEM_CODES

WHOLE, BAD, USAGE, MISSING = 0, 4, 2, 4


@pytest.fixture
def dataset(tmp_path: Path, config: RecordConfig) -> Path:
    sample = SampleDataset(config.data_config(), [episode(k) for k in range(3)])
    sample.fail("off_target", dxy=0.06)
    return sample.write(tmp_path / "dataset")


def test_a_whole_dataset(dataset: Path) -> None:
    run = yamsim("summarize", dataset, "--json", "--threshold", "0.07", "--threshold", "0.001", "--strict")
    assert (run.code, run.err) == (WHOLE, "")
    assert run.json["success_rate"] == {"0.001": 0.0, "0.07": 1.0}
    assert run.json["attempts"]["rates"] == {"0.001": 0.0, "0.07": 1.0}
    assert run.json["problems"] == []


def test_warnings_are_told_and_fail_only_when_strict(dataset: Path) -> None:
    (dataset / "manifest.json").unlink()
    run = yamsim("summarize", dataset, "--json")
    assert (run.code, run.err) == (WHOLE, "")
    assert [problem["code"] for problem in run.json["problems"]] == ["manifest.missing"]
    run = yamsim("summarize", dataset, "--strict", "--json")
    assert run.code == BAD
    assert "manifest.json: the manifest is missing [manifest.missing]" in run.message
    assert run.json["warnings"] == 1


def test_a_damaged_dataset_gets_its_whole_report(dataset: Path, tmp_path: Path) -> None:
    (dataset / "ep_000001/lowdim/000002.pkl").unlink()
    shutil.rmtree(dataset / "ep_000002/rgb")
    (dataset / "ep_000000/notes\x1b[31m.txt").touch()
    run = yamsim("summarize", dataset, "--html", tmp_path / "report.html")
    assert run.code == BAD
    last = run.err.splitlines()[-1]
    assert last.startswith(f"yamsim: {dataset}: ep_000001/lowdim/000002.pkl: frames are missing")
    assert last.endswith("(and 1 more); " + PROBLEM_CODES["frames.gap"].advice)
    assert "2 errors, 1 warning" in run.out
    for code in ("frames.gap", "frames.count", "file.unexpected"):
        assert code in run.out
        assert code in (tmp_path / "report.html").read_text()


def test_the_report_for_a_person_fits_80_columns_and_has_no_colour_in_a_pipe(dataset: Path) -> None:
    (dataset / "ep_000001/lowdim/000002.pkl").write_bytes(b"x")
    (dataset / "ep_000001" / ("long_" * 30)).touch()
    run = yamsim("summarize", dataset)
    assert run.code == BAD
    assert max(map(len, run.out.splitlines())) <= 80
    assert "\x1b" not in run.out
    words = " ".join(run.out.split())
    assert "3: 18 frames, 1.0 s" in words
    assert "1 off_target" in words
    assert "5 cm 100.0%" in words


def test_names_in_a_dataset_cannot_steer_the_terminal(tmp_path: Path, config: RecordConfig) -> None:
    sample = SampleDataset(config.data_config(), [episode(k) for k in range(2)])
    for made in sample.episodes:
        made.images = {"cam\x1b[2J\udcff": made.images["scene_camera"]}
        for frame in made.frames:
            frame["\x1b[31m_pose"] = frame["plate_pose"]
    dataset = sample.write_plain(tmp_path / "plain\x1b[31m")
    for options in ((), ("--json",), ("--html", tmp_path / "report.html")):
        run = yamsim("summarize", dataset, *options)
        assert run.code == WHOLE, run.err
        assert "\x1b" not in run.out
        assert "cam\N{REPLACEMENT CHARACTER}[2J\N{REPLACEMENT CHARACTER}" in run.out


def test_a_page_is_written(dataset: Path, tmp_path: Path) -> None:
    run = yamsim("summarize", dataset, "--html", "report.html", "--json", cwd=tmp_path)
    assert (run.code, run.err) == (WHOLE, "")
    assert run.json["html"] == "report.html"
    assert (tmp_path / "report.html").read_text().startswith("<!doctype html>")
    run = yamsim("summarize", dataset, "--html", "report.html", "--overwrite", cwd=tmp_path)
    assert run.err == "The report is in report.html.\n"


def test_a_file_that_is_there_is_not_replaced_unasked(dataset: Path, tmp_path: Path) -> None:
    file = tmp_path / "report.html"
    file.write_text("precious")
    run = yamsim("summarize", dataset, "--html", file)
    assert (run.code, run.out) == (USAGE, "")
    assert f"--html {file} exists; replace it with --overwrite" in run.message
    assert file.read_text() == "precious"


@pytest.mark.parametrize(
    ("name", "said"), [("", "is a directory; give a file"), ("nowhere/x.html", "there is no directory")]
)
def test_a_page_that_cannot_be_written_is_refused_before_the_work(tmp_path: Path, name: str, said: str) -> None:
    run = yamsim("summarize", "no/dataset", "--html", tmp_path / name)
    assert run.code == USAGE
    assert said in run.message


@pytest.mark.parametrize("value", ["0", "-1", "nan", "inf"])
def test_a_threshold_is_a_distance(dataset: Path, value: str) -> None:
    run = yamsim("summarize", dataset, "--threshold", value)
    assert run.code == USAGE
    assert "give a distance in metres above 0" in run.message


def test_one_episode_is_no_dataset(dataset: Path) -> None:
    run = yamsim("summarize", dataset / "ep_000001")
    assert (run.code, run.out) == (MISSING, "")
    assert f"give the directory around it, {dataset}" in run.message


def test_the_worker_count_changes_nothing(dataset: Path) -> None:
    one, three = (yamsim("summarize", dataset, "--json", "--workers", n).json for n in ("1", "3"))
    assert one == three
    assert json.dumps(one)


def test_every_code_is_on_its_page(repository: Path) -> None:
    text = (repository / "docs" / "checking.md").read_text()
    assert [code for code in PROBLEM_CODES if f"`{code}`" not in text] == []
