"""What differs between two datasets, as figures, JSON and page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli.run_cli import yamsim
from tests.core.dataset.making import FRAMES, frame, made, write_dataset
from yamsim_cli.review.dataset_diff import ColumnDifference, compare_rows


def rows(count: int, noise: int, **changes: Any) -> list[dict[str, Any]]:
    """Return rows whose distances are normal, with a mean of `shift` and one success in `success` failing."""
    rng = np.random.default_rng(noise)
    shift, failing = changes.get("shift", 0.0), changes.get("failing", 10)
    return [
        {
            "episode": k,
            "frames": 100 + int(rng.integers(20)),
            "distance_mm": None if k == 0 else float(rng.normal(20 + shift, 2)),
            "success": k % failing != 0,
            "phrase": ("pick", "take", "grab")[k % 3],
            "seed": changes.get("seed", 7),
            "attempt": 2 * k if changes.get("gaps") else k,
        }
        for k in range(count)
    ]


def compared(first: list[dict[str, Any]], second: list[dict[str, Any]]) -> dict[str, ColumnDifference]:
    return {column.column: column for column in compare_rows(first, second).columns}


def test_equal_distributions_agree_and_a_shift_is_found() -> None:
    assert not any(column.differs for column in compared(rows(200, 0), rows(200, 1)).values())
    found = compared(rows(200, 0), rows(200, 1, shift=2.0))
    assert {name for name, column in found.items() if column.differs} == {"distance_mm"}
    shifted = found["distance_mm"]
    assert (shifted.test, shifted.first["n"]) == ("ks", 199), "unknown values do not count"
    assert shifted.second["median"] - shifted.first["median"] == pytest.approx(2.0, abs=0.5)
    assert next(iter(found)) == "distance_mm", "the most significant is first"


def test_texts_and_truth_values_are_counted() -> None:
    second = rows(200, 1, failing=2)
    for row in second[::2]:
        row["phrase"] = "lift"
    found = compared(rows(200, 0), second)
    assert found["success"].test == "fisher"
    assert (found["success"].first, found["success"].second) == ({"no": 20, "yes": 180}, {"no": 100, "yes": 100})
    assert found["phrase"].test == "chi2"
    assert found["phrase"].second["lift"] == 100
    assert found["success"].differs
    assert found["phrase"].differs


def test_p_values_are_corrected_for_the_number_of_tests() -> None:
    """Holm's procedure by its definition, see Holm (1979)."""
    columns = sorted(compare_rows(rows(50, 0), rows(50, 1, shift=0.7)).columns, key=lambda column: column.p)
    steps = [(len(columns) - k) * column.p for k, column in enumerate(columns)]
    assert [column.p_holm for column in columns] == [
        pytest.approx(min(1.0, max(steps[: k + 1]))) for k in range(len(columns))
    ]


def test_episodes_of_the_same_seed_and_attempt_are_pairs() -> None:
    assert compare_rows(rows(6, 0), rows(6, 1, gaps=True)).pairs == ((0, 0), (2, 1), (4, 2))
    assert compare_rows(rows(6, 0), rows(6, 1, seed=8)).pairs == ()


@pytest.fixture
def datasets(tmp_path: Path) -> tuple[Path, Path]:
    slow = [[frame(k, episode) for k in range(FRAMES + 2)] for episode in range(8)]
    return (
        write_dataset(tmp_path / "before", *(made(k) for k in range(8))),
        write_dataset(tmp_path / "after", *(made(k, frames=slow[k]) for k in range(8))),
    )


def test_two_datasets_as_json_and_as_a_page(datasets: tuple[Path, Path], tmp_path: Path) -> None:
    page = tmp_path / "diff.html"
    report = yamsim("review", "--diff", *datasets, "--motion", "--html", page, "--json").json
    values = {value["column"]: value for value in report["values"]}
    assert (values["frames"]["differs"], values["x_m"]["differs"]) == (True, False)
    assert (values["duration_s"]["first"]["median"], values["frames"]["second"]["median"]) == (0.192, FRAMES + 2)
    assert report["pairs"] == [[k, k] for k in range(8)]
    text = page.read_text()
    assert "before, episode 3" in text
    assert "after, episode 3" in text
    assert text.count("data:image/jpeg;base64,") == 16
    assert "Kolmogorov-Smirnov" in text
    assert "http://" not in text.replace("http://www.w3.org/2000/svg", "")


def test_the_command_says_what_differs(datasets: tuple[Path, Path]) -> None:
    run = yamsim("review", "--diff", *datasets)
    assert run.code == 0
    assert "frames: median 4 and 6" in run.out.splitlines()[0]
    assert "8 pairs of episodes have the same seed and attempt" in run.out


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (("--diff",), "--diff takes two datasets, not 1"),
        (("--diff", "--merge"), "exclude each other"),
        (("--html", "x.html"), "--html needs --diff"),
        (("--diff", "--out", "x.yaml"), "--out is not for --diff"),
    ],
)
def test_flags_that_do_not_fit_are_refused(flags: tuple[str, ...], said: str, tmp_path: Path) -> None:
    run = yamsim("review", tmp_path, *flags)
    assert run.code == 2
    assert said in run.err


@pytest.mark.parametrize("flags", [(), ("--motion",)])
def test_a_missing_folder_is_one_line(datasets: tuple[Path, Path], tmp_path: Path, flags: tuple[str, ...]) -> None:
    done = yamsim("review", "--diff", datasets[0], tmp_path / "nowhere", *flags)
    assert done.code not in (0, 1)
    assert done.err.strip() == f"yamsim: {tmp_path / 'nowhere'} is not a folder; give the folder of a dataset"
