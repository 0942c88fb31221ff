"""Malicious datasets: huge, endless, special and misleading files."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.datasets.checks.sample import CAMERA, SampleDataset
from tests.datasets.checks.test_codes import EP, FRAME, IMAGE, rehash, write
from yamsim_cli.core.dataset.checks.problem import printable_line
from yamsim_cli.core.errors import DatasetError


def replace_by(path: Path, make: Any) -> None:
    path.unlink()
    make(path)


def test_a_pipe_is_not_waited_for(sample: SampleDataset, path: Path, found: Any) -> None:
    sample.write(path)
    replace_by(path / EP / FRAME, os.mkfifo)
    assert found(path) == [("file.unreadable", EP, FRAME)]
    replace_by(path / EP / FRAME, lambda file: file.symlink_to("/dev/zero"))
    assert found(path) == [("file.unreadable", EP, FRAME)]


def test_a_link_to_a_missing_file_is_reported(sample: SampleDataset, path: Path, survey_of: Any) -> None:
    sample.write(path)
    replace_by(path / EP / IMAGE, lambda file: file.symlink_to("nowhere"))
    (problem,) = survey_of(path).problems
    assert (problem.code, problem.file) == ("file.unreadable", IMAGE)
    assert "No such file" in problem.text


def test_links_to_what_was_recorded_are_as_good(sample: SampleDataset, path: Path, found: Any) -> None:
    sample.write(path)
    shutil.move(path / EP / "rgb", path.parent / "elsewhere")
    (path / EP / "rgb").symlink_to(path.parent / "elsewhere")
    assert found(path) == []


def test_a_link_that_leads_back_ends(sample: SampleDataset, path: Path, found: Any) -> None:
    sample.write(path)
    (path / EP / "rgb/again").symlink_to("..")
    problems = found(path)
    assert 0 < len(problems) < 100
    assert {code for code, _, _ in problems} == {"file.unexpected"}


def test_a_header_that_promises_gigabytes_is_not_believed(sample: SampleDataset, path: Path, survey_of: Any) -> None:
    data = bytearray(sample.episodes[1].images[CAMERA][2])
    at = data.index(b"\xff\xc0")
    data[at + 5 : at + 9] = b"\xff\xdc\xff\xdc"
    sample.write(path)
    rehash(IMAGE, bytes(data))(path)
    (problem,) = survey_of(path).problems
    assert problem.code == "image.size"
    assert "65500x65500; valid: at most" in problem.text


@pytest.mark.parametrize("name", ["lowdim/999999999999.pkl", f"rgb/{CAMERA}/999999999999.jpg"])
def test_a_huge_frame_number_is_one_gap(sample: SampleDataset, path: Path, survey_of: Any, name: str) -> None:
    sample.write(path)
    file = next((path / EP / name).parent.glob("000002.*"))
    shutil.copy(file, path / EP / name)
    codes = [problem.code for problem in survey_of(path).problems]
    assert codes.count("frames.gap") == 1
    assert codes.count("frames.count") == 1


def test_a_huge_episode_number_is_one_gap(sample: SampleDataset, path: Path, survey_of: Any) -> None:
    sample.write(path)
    (path / "ep_999999999999").mkdir()
    missing = [problem for problem in survey_of(path).problems if problem.code == "episode.missing"]
    assert [(p.episode, p.value) for p in missing] == [("ep_000003", "to ep_999999999998, 999999999996 episodes")]


def test_numbers_of_many_digits_are_no_frames(sample: SampleDataset, path: Path, found: Any) -> None:
    sample.write(path)
    write(f"{EP}/lowdim/{'9' * 200}.pkl", b"")(path)
    write(f"{EP}/lowdim/\u0663.pkl", b"")(path)
    assert {code for code, _, _ in found(path)} == {"file.unexpected"}


def test_names_cannot_steer_a_terminal(sample: SampleDataset, path: Path, survey_of: Any) -> None:
    sample.write(path)
    write(f"{EP}/\x1b[2Jgone\u202e\n", b"")(path)
    (path / EP / os.fsdecode(b"\xff\xfe")).touch()
    problems = survey_of(path).problems
    assert [problem.code for problem in problems] == ["file.unexpected"] * 2
    for problem in problems:
        assert problem.file.isprintable()
        assert problem.text.isprintable()


def test_a_disk_that_refuses_is_an_error_of_the_dataset(
    sample: SampleDataset, path: Path, found: Any, monkeypatch: Any
) -> None:
    sample.write(path)

    def refuse(_: Path) -> None:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(Path, "iterdir", refuse)
    with pytest.raises(DatasetError, match=r"dataset cannot be read: Input/output error; check"):
        found(path)


def test_long_values_are_cut() -> None:
    assert len(printable_line("x" * 10_000)) == 200


def test_text_in_records_cannot_break_out(sample: SampleDataset, path: Path, survey_of: Any) -> None:
    sample.episodes[1].over["rig"] = "a\x1b[31m\nb" * 100
    for problem in survey_of(sample.write(path)).problems:
        assert problem.text.isprintable()


def test_a_directory_in_the_place_of_a_file(sample: SampleDataset, path: Path, found: Any) -> None:
    sample.write(path)
    for name in ("manifest.json", "attempts.jsonl", f"{EP}/episode.json", f"{EP}/{FRAME}"):
        replace_by(path / name, Path.mkdir)
    assert sorted(found(path)) == [
        ("frames.gap", EP, FRAME),
        ("ledger.missing", "", "attempts.jsonl"),
        ("manifest.missing", "", "manifest.json"),
        ("record.missing", EP, "episode.json"),
    ]
