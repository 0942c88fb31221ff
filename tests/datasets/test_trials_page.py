"""The page of a batch: all figures, self-contained, and without markup from names."""

from __future__ import annotations

from typing import Any

import pytest

from tests.core.test_markup import read
from tests.datasets.test_page import EVIL, headings, needs_nothing_else
from yamsim_cli.datasets.trials_page import start_boxes, trials_page

BOXES = dict.fromkeys(("banana", "plate"), ((0.30, 0.55), (-0.18, 0.18)))


def _trial(number: int, success: bool, x: float, y: float) -> dict[str, Any]:
    outcome = {"success": success, "cause": None if success else "slipped", "detail": "" if success else EVIL}
    return {
        "trial": number,
        "outcome": outcome | {"dxy_m": 0.002 + 0.001 * number},
        "layout": {"banana": [x, y, 0.0, 0.0], "plate": [0.4, 0.1, 0.0, 0.0]},
    }


@pytest.fixture
def report() -> dict[str, Any]:
    trials = [_trial(k, k != 2, 0.31 + 0.05 * k, -0.1) for k in range(4)]
    return {
        "n": 4,
        "n_success": 3,
        "success_rate": 0.75,
        "wilson95": (0.3, 0.95),
        "threshold_m": 0.05,
        "dxy_m": {"median": 0.0035, "p95": 0.0048, "max": 0.005},
        "margins": {"velocity_share": 0.81, "torque_share": 0.42, "joint_rad": 0.21},
        "causes": {"slipped": 1},
        "recovered": 0,
        "rig": "single_linear",
        "task": "pickplace",
        "grasp": "contact",
        "trials": trials,
    }


def test_the_page_has_the_figures_and_a_panel_for_each_object(report: dict[str, Any]) -> None:
    text = trials_page(report, BOXES, "Made by a test.")
    page = needs_nothing_else(text)
    for figure in (
        "pickplace on single_linear, grasp contact",
        "75.0",
        "3.5 mm",
        "81",
        "0.21 rad",
        "Made by a test.",
    ):
        assert figure in page.text
    assert headings(text)[1:] == [
        "Success",
        "Distance from the target&#x27;s centre",
        "Failures by cause",
        "Workspace",
        "banana, start",
        "plate, start",
        "Failures",
    ]
    assert "3 of 40 cells with a success" in page.text
    # A cross for the failure, dots for the others.
    crosses = [attributes["d"] for name, attributes in page.tags if attributes.get("class") == "crosses"]
    assert [path.count("M") for path in crosses] == [1, 1]
    dots = [attributes["d"] for name, attributes in page.tags if "dots" in (attributes.get("class") or "")]
    assert [path.count("M") for path in dots] == [3, 3]


def test_a_detail_is_text_and_no_markup(report: dict[str, Any]) -> None:
    page = read(trials_page(report, BOXES, ""))
    assert EVIL in page.text
    assert "img" not in {name for name, _ in page.tags}


def test_without_anything_that_moved_there_is_still_a_page(report: dict[str, Any]) -> None:
    nothing = report | {"margins": None, "dxy_m": None, "causes": {"no_layout": 1}, "n": 1, "n_success": 0}
    nothing["trials"] = [
        {"trial": 0, "outcome": {"success": False, "cause": "no_layout", "detail": "", "dxy_m": None}, "layout": {}}
    ]
    text = trials_page(nothing, BOXES, "")
    assert headings(text)[1:] == ["Success", "Failures by cause", "Failures"]


def test_of_a_task_that_is_data_the_goal_is_told_and_each_thing_has_a_panel(make_config: Any) -> None:
    config = make_config({("task",): "drawer", ("rig",): "yam_station_linear_4310_d405"})
    boxes = start_boxes(config)
    assert boxes == {"cabinet": ((0.52, 0.54), (-0.03, 0.03)), "cube": ((0.20, 0.265), (-0.34, 0.34))}
    trials = [
        {
            "trial": k,
            "outcome": {
                "success": k == 0,
                "cause": None if k == 0 else "goal",
                "detail": "",
                "dxy_m": None,
                "measures": [{"what": "in(cube, cabinet)", "margin": margin, "unit": "share", "detail": ""}],
            },
            "layout": {name: [0.25, 0.0, 0.1, 1, 0, 0, 0] for name in ("cabinet", "cube", "lid")},
        }
        for k, margin in enumerate((0.5, -0.5))
    ]
    report = {"n": 2, "n_success": 1, "success_rate": 0.5, "wilson95": (0.1, 0.9), "threshold_m": None, "dxy_m": None}
    report |= {"margins": None, "causes": {"goal": 1}, "recovered": 1, "rig": "r", "task": "drawer", "grasp": "contact"}
    text = trials_page({**report, "trials": trials}, boxes, "")
    page = read(text)
    assert headings(text)[1:] == [
        "Success", "Failures by cause", "Goal", "Workspace", "cabinet, start", "cube, start", "lid, start", "Failures"
    ]  # fmt: skip
    for said in (
        "success (10.0",
        "1 of 2",
        "0.5 share",
        "successes in which a skill was tried again",
        "starts on another",
    ):
        assert said in page.text, said
