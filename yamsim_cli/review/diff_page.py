"""The page on differences between two datasets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..core.dataset.dataset_paths import episode_name
from ..core.errors import DatasetError
from ..core.markup import (
    Markup,
    captioned_jpeg,
    captioned_plot,
    grid_section,
    html_page,
    html_section,
    html_table,
    html_tag,
    key_figures,
    page_footer,
    plot_legend,
    verdict_sentence,
)
from ..plots import format_number, plot_curves
from .dataset_diff import ALPHA, ColumnDifference, DatasetDifference, numbers
from .episode_detail import film_strip
from .episode_index import COLUMN_NAMES

_MAX_PAIRS = 12  # with pictures; each pair adds 16 kB to the page
_MAX_PLOTS = 12  # of values that differ most
_POINTS = 300  # of a curve
_STRIP_PX = 384  # px, width of a film strip
_TESTS = {"ks": "Kolmogorov-Smirnov", "fisher": "Fisher, exact", "chi2": "chi-squared"}


def diff_page(
    difference: DatasetDifference,
    rows: tuple[Sequence[Mapping[str, Any]], Sequence[Mapping[str, Any]]],
    datasets: tuple[Path, Path],
) -> str:
    """Return the page as HTML.

    Args:
        rows: of `read_rows`, of both datasets.
        datasets: their directories, for pictures.
    """
    names = [path.absolute().name for path in datasets]
    differing = [each for each in difference.columns if each.differs]
    if differing:
        found = ", ".join(COLUMN_NAMES.get(each.column, each.column) for each in differing[:4])
        text = f"{len(differing)} of {len(difference.columns)} values differ, most of all: {found}."
    else:
        text = f"None of {len(difference.columns)} values differs significantly."
    body = [
        key_figures(
            [
                (f"{len(rows[0]):,}", f"episodes of {names[0]}"),
                (f"{len(rows[1]):,}", f"episodes of {names[1]}"),
                (f"{len(difference.pairs):,}", "pairs with the same seed and attempt"),
            ]
        ),
        verdict_sentence(text, "warning" if differing else "fine"),
        _test_section(difference, names),
        _plot_section(difference, rows, names),
        _pair_section(difference, datasets, names),
    ]
    title = f"{names[0]} and {names[1]}"
    return html_page(f"{title}: differences", "Two datasets", title, body, page_footer())


def _test_section(difference: DatasetDifference, names: Sequence[str]) -> Markup:
    note = (
        f"A value differs if its p after Holm's correction is below {ALPHA:g}. If the datasets had the same "
        f"distributions, a page would list a difference in {ALPHA:.0%} of cases at most. Kolmogorov-Smirnov compares "
        "whole distributions, so it also finds differences of spread."
    )
    cells = [
        [
            COLUMN_NAMES.get(each.column, each.column),
            "differs" if each.differs else "",
            f"{each.p_holm:.2g}",
            _TESTS[each.test],
            _figures_text(each, each.first),
            _figures_text(each, each.second),
        ]
        for each in difference.columns
    ]
    headings = ["value", "", "p (Holm)", "test", *names]
    return html_section("Values", html_tag("p", note, class_="note"), html_table(headings, cells))


def _figures_text(column: ColumnDifference, figures: Mapping[str, Any]) -> str:
    if column.test == "ks":
        low, median, high = (format_number(float(f"{figures[key]:.3g}")) for key in ("p5", "median", "p95"))
        return f"median {median}, 90 % in {low} to {high}"
    total = sum(figures.values())
    most = sorted(figures.items(), key=lambda item: -item[1])[:3]
    return ", ".join(f"{name or 'none'} {count / total:.1%}" for name, count in most)


def _plot_section(
    difference: DatasetDifference,
    rows: tuple[Sequence[Mapping[str, Any]], Sequence[Mapping[str, Any]]],
    names: Sequence[str],
) -> Markup | None:
    figures = []
    for each in [column for column in difference.columns if column.test == "ks"][:_MAX_PLOTS]:
        a, b = (np.sort(numbers(of, each.column)) for of in rows)
        ends = min(a[0], b[0]), max(a[-1], b[-1])
        if ends[0] == ends[1]:
            continue
        across = np.linspace(*ends, _POINTS)
        curves = {
            kind: np.searchsorted(values, across, side="right") / len(values)
            for kind, values in (("measured", a), ("simulated", b))
        }
        title = COLUMN_NAMES.get(each.column, each.column)
        picture = plot_curves(title, across, curves, "share of episodes", x_label=title)
        figures.append(
            captioned_plot(
                title, picture, f"Largest difference of the curves {each.statistic:.2f}, p {each.p_holm:.2g}."
            )
        )
    legend = plot_legend([(None, names[0]), ("simulated", names[1])])
    return grid_section("Share of episodes below a value", figures, "columns", legend)


def _pair_section(difference: DatasetDifference, datasets: tuple[Path, Path], names: Sequence[str]) -> Markup | None:
    count = len(difference.pairs)
    figures = []
    for k in dict.fromkeys(np.linspace(0, count - 1, min(count, _MAX_PAIRS)).round().astype(int).tolist()):
        a, b = difference.pairs[k]
        for number, dataset, name in zip((a, b), datasets, names, strict=True):
            try:
                strip = film_strip(dataset / episode_name(number), dataset)
            except DatasetError:
                continue  # no pictures, or a damaged record
            figures.append(captioned_jpeg(f"{name}, episode {number}", strip, _STRIP_PX))
    return grid_section("The same seed and attempt in both", figures, "strips")
