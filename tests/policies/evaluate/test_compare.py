"""Two policies on the same starts: the exact test, reports from files, and the leaderboard."""

from __future__ import annotations

import copy
import itertools
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from yamsim_cli.core.errors import UsageError
from yamsim_cli.datasets.leaderboard_page import leaderboard_page
from yamsim_cli.policies.evaluate.compare import (
    compare_reports,
    difference_interval_95,
    mcnemar_p_value,
    read_report,
)
from yamsim_cli.policies.evaluate.run import compare_report_files


def report(name: str, good: str) -> dict[str, Any]:
    """A report of trials, in which `1` stands for a success."""
    wins = good.count("1")
    figures = {"n": len(good), "n_success": wins, "success_rate": wins / len(good), "wilson95": [0.1, 0.9]}
    policy_s = {"median": 0.010, "p95": 0.020, "max": 0.030}
    return {
        "policy": name,
        "task": "pickplace",
        "rig": "single",
        "grasp": "weld",
        "arms": ["right"],
        "seed": 3,
        "stats": {
            **figures,
            "policy_s": policy_s,
            "chunks": {"chunks": 7, "actions": 56, "stale": 5, "waited_s": 0.25},
            "by_instance": [{"instance": "banana, plate", **figures, "policy_s": policy_s}],
        },
        "trials": [
            {"trial": k, "seed": 3, "outcome": {"success": one == "1"}, "layout": {"banana": [0.1 * k, 0.0]}}
            for k, one in enumerate(good)
        ],
    }


def test_the_p_value_is_that_of_the_exact_sign_test() -> None:
    """Of every way in which so many coins may fall, the share of those at least as uneven."""
    for n in range(1, 11):
        uneven = np.array([abs(2 * sum(coins) - n) for coins in itertools.product((0, 1), repeat=n)])
        for k in range(n + 1):
            assert mcnemar_p_value(k, n - k) == pytest.approx((uneven >= abs(2 * k - n)).mean())
    assert mcnemar_p_value(0, 0) == 1.0
    assert mcnemar_p_value(3000, 2000) < 1e-40


def test_trials_are_paired() -> None:
    found = compare_reports(report("a", "1111100000"), report("b", "1100000001"), "b.json")
    assert found == {
        "policy": "b", "success_rate": 0.3, "n": 10,
        "both": 2, "only_first": 3, "only_second": 1, "neither": 4, "difference": 0.2,
        "difference95": difference_interval_95(3, 1, 10), "p_value": 0.625, "settings_differ": {},
    }  # fmt: skip


def test_the_interval_of_the_difference_holds_the_true_difference_as_often_as_it_says() -> None:
    """For two dependent policies on few trials: of all outcomes, weighted by their probability."""
    n, only_first, only_second = 30, 0.25, 0.1
    other = 1 - only_first - only_second
    covered = 0.0
    for k in range(n + 1):
        for m in range(n + 1 - k):
            ways = math.factorial(n) // (math.factorial(k) * math.factorial(m) * math.factorial(n - k - m))
            low, high = difference_interval_95(k, m, n)
            chance = ways * only_first**k * only_second**m * other ** (n - k - m)
            covered += chance * (low <= only_first - only_second <= high)
    assert 0.94 < covered < 0.975


def test_the_interval_of_the_difference_is_that_of_the_formula_and_symmetric() -> None:
    # By hand: 7 / 102 = 0.068627, and 1.959964 sqrt((13 / 102 - 0.068627^2) / 102) = 0.067990
    assert difference_interval_95(9, 2, 100) == pytest.approx((0.000638, 0.136617), abs=1e-6)
    low, high = difference_interval_95(2, 9, 100)
    assert (-high, -low) == pytest.approx(difference_interval_95(9, 2, 100))
    assert difference_interval_95(3, 0, 3)[1] == 1.0


def test_reports_in_files_are_compared_and_unequal_settings_named(tmp_path: Path) -> None:
    """What is of the policies alone, such as their arguments, may differ."""
    for name, good, settings in (
        ("a", "1110", {"execute": 2, "quality": "fast", "policy_arguments": {"steps": 1}}),
        ("b", "1000", {"execute": 8, "quality": "fast", "policy_arguments": {}}),
        ("older", "0000", None),
    ):
        made = report(name, good) | ({} if settings is None else {"settings": settings})
        (tmp_path / f"{name}.json").write_text(json.dumps(made))
    first, others = compare_report_files([str(tmp_path / f"{name}.json") for name in ("a", "b", "older")])
    assert [other["policy"] for other in others] == ["b", "older"]
    assert [pair["settings_differ"] for pair in first["compared"]] == [{"execute": [2, 8]}, {}]
    assert [pair["difference"] for pair in first["compared"]] == [0.5, 0.75]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"seed": 4}, "its seed is 4, not 3: trials cannot be paired"),
        ({"task": "tower"}, "its task is tower"),
        ({"trials": []}, r"it has other trials \(0\) than the first \(3\): give the same --n"),
    ],
)
def test_reports_with_other_trials_are_not_compared(change: dict[str, Any], told: str) -> None:
    with pytest.raises(UsageError, match=f"--compare b.json: {told}"):
        compare_reports(report("a", "101"), report("b", "101") | change, "b.json")


def test_trials_with_other_starts_are_not_compared() -> None:
    other = copy.deepcopy(report("b", "101"))
    other["trials"][1]["layout"]["banana"][0] += 1e-6
    with pytest.raises(UsageError, match="trial 1 has another start"):
        compare_reports(report("a", "101"), other, "b.json")
    # A trial with a lost worker has no start.
    other["trials"][1]["layout"] = {}
    assert compare_reports(report("a", "101"), other, "b.json")["both"] == 2


@pytest.mark.parametrize("text", ["", "{", "[]", '{"trials": 1}', '{"trials": [], "stats": {}}', "[" * 100_000])
def test_files_that_are_not_reports_are_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "r.json").write_text(text)
    with pytest.raises(UsageError, match=r"r.json: is not a report of yamsim eval --out"):
        read_report(tmp_path / "r.json")
    with pytest.raises(UsageError, match="cannot be read: No such file"):
        read_report(tmp_path / "nowhere.json")


def test_a_report_is_read(tmp_path: Path) -> None:
    (tmp_path / "r.json").write_text(json.dumps(report("a", "10")))
    assert read_report(tmp_path / "r.json") == report("a", "10")


def test_the_leaderboard_has_the_best_first_and_breaks_out_of_nothing() -> None:
    one, other = report("<script>worse</script>", "1000"), report("better", "1110")
    page = leaderboard_page([one, other], [compare_reports(one, other, "b")], "Made by a test.")
    assert "<script>" not in page
    assert page.index(">better<") < page.index("&lt;script&gt;worse")
    for text in ("3 of 4", "1 of 4", "10.0 ms", "20.0 ms", "0.25 s", "McNemar", "banana, plate"):
        assert text in page.replace("\N{NO-BREAK SPACE}", " ")
