"""The report page: complete, self-contained, and without markup from a dataset."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.core.test_markup import Reader, read
from tests.datasets.checks.sample import CAMERA, SampleDataset, episode, look, picture
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.errors import ResourceError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.datasets.check_summary import summarize_checks
from yamsim_cli.datasets.dataset_page import FrameStrip, dataset_page
from yamsim_cli.datasets.summarize import contact_sheet, write_report

FETCHING = {"script", "link", "iframe", "object", "embed", "a", "form", "base", "use", "image", "foreignobject"}
EVIL = "<img src=x onerror=alert(1)>"


@pytest.fixture
def sample(config: RecordConfig) -> SampleDataset:
    return SampleDataset(config.data_config(), [episode(k) for k in range(3)])


@pytest.fixture
def report(tmp_path: Path, locations: Locations) -> Callable[[SampleDataset], str]:
    def of(sample: SampleDataset, change: Callable[[Path], object] = lambda path: None) -> str:
        path = sample.write(tmp_path / "dataset")
        change(path)
        survey = look(path, locations)
        return dataset_page(survey, summarize_checks(survey, (0.001, 0.05)), contact_sheet(survey), "Made by a test.")

    return of


def headings(text: str) -> list[str]:
    return re.findall(r"<h[123]>(.*?)</h[123]>", text)


def needs_nothing_else(text: str) -> Reader:
    """Whether a page is self-contained: no script, no link, no external address."""
    reader = read(text)
    names = {name for name, _ in reader.tags}
    assert not names & FETCHING
    for name, attributes in reader.tags:
        assert not any(key.startswith("on") for key in attributes), attributes
        for key in ("src", "href", "srcset", "data", "action", "poster"):
            assert (attributes.get(key) or "data:").startswith("data:image/jpeg;base64,") or key not in attributes, name
    assert not re.findall(r"url\(|@import|https?:(?!//www\.w3\.org/2000/svg)", text)
    policy = dict(next(a for n, a in reader.tags if n == "meta" and "http-equiv" in a))
    assert policy["content"] == "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
    return reader


def pictures_are_well_formed(text: str) -> int:
    found = re.findall(r"<svg.*?</svg>", text, re.DOTALL)
    for svg in found:
        ElementTree.fromstring(svg)
        assert not re.search(r"\b(nan|inf)\b", svg)
    return len(found)


def test_a_whole_dataset(sample: SampleDataset, report: Any) -> None:
    sample.fail("off_target", layout={"banana": (0.5, 0.1, 0.0, 1.0, 0.0, 0.0, 0.0)})
    text = report(sample)
    reader = needs_nothing_else(text)
    assert headings(text) == [
        "dataset",
        "Success",
        "Success by threshold",
        "Distance from the target&#x27;s centre",
        "Height over the target",
        "Failures by cause",
        "Workspace",
        "banana, start",
        "banana, end",
        "plate, start",
        "Pictures",
        "Settings and versions",
    ]
    assert pictures_are_well_formed(text) == 7
    assert "Complete: every file was opened" in reader.text
    assert "Made by a test." in reader.text
    assert "failed attempt" in reader.text
    assert sum(name == "img" for name, _ in reader.tags) == 9
    assert text.startswith("<!doctype html>")


def test_a_damaged_dataset_shows_its_problems_first(sample: SampleDataset, report: Any) -> None:
    def spoil(path: Path) -> None:
        (path / "ep_000001/lowdim/000002.pkl").unlink()
        for k in range(12):
            (path / f"ep_000002/extra{k:02d}").touch()

    text = report(sample, spoil)
    assert headings(text)[1] == "Problems"
    reader = needs_nothing_else(text)
    assert "1 error and 12 warnings: correct the errors before you train on" in reader.text
    assert "frames.gap" in reader.text
    assert "ep_000001/lowdim/000002.pkl: 2; valid: 0 to 5" in reader.text
    assert "<code>yamsim record --resume</code>" in text
    assert reader.text.index("frames.gap") < reader.text.index("file.unexpected")
    assert (text.count("file.unexpected"), text.count("ep_000002/extra")) == (1, 5)
    assert "and 7 more" in text


def test_a_dataset_without_episodes(sample: SampleDataset, report: Any) -> None:
    sample.episodes = []
    text = report(sample)
    needs_nothing_else(text)
    assert headings(text) == ["dataset", "Problems"]
    assert "The dataset has no episodes yet." in text


def test_a_plain_recording(sample: SampleDataset, tmp_path: Path, locations: Locations) -> None:
    survey = look(sample.write_plain(tmp_path / "plain"), locations)
    text = dataset_page(survey, summarize_checks(survey, (0.05,)), contact_sheet(survey), "")
    needs_nothing_else(text)
    assert pictures_are_well_formed(text) == 6
    assert "y, m, in the robot&#x27;s base" in text
    assert "sampling box unknown" in text


def test_nothing_in_a_dataset_becomes_markup(sample: SampleDataset, tmp_path: Path, locations: Locations) -> None:
    """Every text of the dataset is hostile; names of cameras and objects are refused when read."""
    made = sample.episodes[1]
    for frame in made.frames:
        frame[EVIL] = EVIL
        frame["language_task"] = EVIL
        frame[f"{EVIL}_pose"] = frame["banana_pose"]
    made.over = {
        **dict.fromkeys(("task", "grasp", "rig", "renderer", "source"), EVIL),
        "versions": {EVIL: EVIL},
    }
    sample.fail(EVIL)
    path = sample.write(tmp_path / EVIL)
    (path / "ep_000002" / EVIL).touch()
    (path / f"ep_{EVIL}").mkdir()
    survey = look(path, locations)
    text = dataset_page(
        survey, summarize_checks(survey, (0.05,)), [*contact_sheet(survey), FrameStrip(EVIL, EVIL, [b"x"])], EVIL
    )
    reader = needs_nothing_else(text)
    assert EVIL not in text
    assert all(attributes.get("src") != "x" for _, attributes in reader.tags)
    assert reader.text.count(EVIL) > 10
    assert pictures_are_well_formed(text) > 6


def test_the_worst_episodes_come_first(config: RecordConfig, tmp_path: Path, locations: Locations) -> None:
    sample = SampleDataset(config.data_config(), [episode(k) for k in range(8)])
    for made in sample.episodes:
        made.frames[-1]["banana_pose"][0, 3] += 0.001 * ((made.number * 3) % 8)
    sheet = contact_sheet(look(sample.write(tmp_path / "dataset"), locations))
    assert [strip.episode for strip in sheet] == [f"ep_{k:06d}" for k in (5, 2, 7, 4, 1, 6)]
    assert [len(strip.pictures) for strip in sheet] == [3] * 6
    assert sheet[0].caption == "ended 9.0 mm off"


def test_pictures_are_of_the_camera_that_stands_still(
    sample: SampleDataset, tmp_path: Path, locations: Locations
) -> None:
    for made in sample.episodes:
        made.images = {"a_wrist_camera": [picture(k, 9) for k in range(6)], "b": made.images[CAMERA]}
    both = contact_sheet(look(sample.write_plain(tmp_path / "dataset"), locations))
    for made in sample.episodes:
        made.images = {"b": made.images["b"]}
    alone = contact_sheet(look(sample.write_plain(tmp_path / "only"), locations))
    assert both[0].pictures == alone[0].pictures


def test_a_report_is_written_whole_or_not_at_all(sample: SampleDataset, tmp_path: Path, locations: Locations) -> None:
    survey = look(sample.write(tmp_path / "dataset"), locations)
    summary = summarize_checks(survey, (0.05,))
    write_report(survey, summary, tmp_path / "report.html")
    assert (tmp_path / "report.html").read_text().endswith("</html>\n")
    assert sorted(file.name for file in tmp_path.iterdir()) == ["dataset", "report.html"]
    with pytest.raises(ResourceError, match=r"nowhere/report\.html cannot be written: No such file"):
        write_report(survey, summary, tmp_path / "nowhere/report.html")
