"""Differences between two datasets: a test for each value that both have, and the episodes with equal starts."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from .episode_index import COLUMN_NAMES

ALPHA = 0.05  # probability of at least one false difference among all tests of a comparison
_NO_VALUES = frozenset({"episode", "seed", "attempt", "origin", "bytes"})  # columns that name episodes or files
_MIN_VALUES = 2  # of each dataset, for a test

Row = Mapping[str, Any]


@dataclass(frozen=True)
class ColumnDifference:
    """A test whether a value has the same distribution in two datasets.

    Attributes:
        column: name of the value.
        test: `ks`, the two-sample Kolmogorov-Smirnov test, for numbers; for texts and truth values, `fisher`, Fisher's
            exact test of two categories, or `chi2`, the chi-squared test of more.
        statistic: largest difference of the cumulative distributions; odds ratio; chi-squared. None if it is infinite.
        p: probability of such a difference between samples of the same distribution.
        p_holm: that probability after Holm's correction for the number of tests.
        first, second: figures of each dataset: number, median and quantiles of values, or counts of categories.
    """

    column: str
    test: Literal["ks", "fisher", "chi2"]
    statistic: float | None
    p: float
    p_holm: float
    first: dict[str, Any]
    second: dict[str, Any]

    @property
    def differs(self) -> bool:
        """Whether the difference is significant at `ALPHA` among all tests."""
        return self.p_holm < ALPHA

    def describe(self) -> str:
        """Return the value's name, and its medians or most frequent categories, as one line."""
        name = COLUMN_NAMES.get(self.column, self.column)
        if self.test == "ks":
            return f"{name}: median {self.first['median']:.4g} and {self.second['median']:.4g}"
        texts = (
            ", ".join(f"{key or 'none'} {count}" for key, count in side.items()) for side in (self.first, self.second)
        )
        return f"{name}: {' / '.join(texts)}"

    def to_json_data(self) -> dict[str, Any]:
        """Return JSON data."""
        return {**vars(self), "name": COLUMN_NAMES.get(self.column, self.column), "differs": self.differs}


@dataclass(frozen=True)
class DatasetDifference:
    """The comparison of two datasets.

    Attributes:
        columns: a test for each value, the most significant first.
        pairs: numbers of the episodes of the first and the second dataset with equal seed and attempt.
    """

    columns: tuple[ColumnDifference, ...]
    pairs: tuple[tuple[int, int], ...]


def compare_rows(first: Sequence[Row], second: Sequence[Row]) -> DatasetDifference:
    """Compare rows of `read_rows` of two datasets, with all values that both have."""
    keys = [key for key in first[0] if key in second[0] and key not in _NO_VALUES]
    tests = [test for key in keys if (test := _test_column(key, first, second))]
    corrected = _holm([test["p"] for test in tests])
    columns = [ColumnDifference(**test, p_holm=p) for test, p in zip(tests, corrected, strict=True)]
    return DatasetDifference(tuple(sorted(columns, key=lambda each: (each.p_holm, each.p))), _pairs(first, second))


def numbers(rows: Sequence[Row], column: str) -> list[float]:
    """Return the known numbers of a column."""
    return [float(row[column]) for row in rows if row.get(column) is not None]


def _test_column(column: str, first: Sequence[Row], second: Sequence[Row]) -> dict[str, Any] | None:
    values = [row[column] for row in (*first, *second) if row[column] is not None]
    if not values or not isinstance(values[0], float | int) or isinstance(values[0], bool):
        return _test_categories(column, first, second)
    a, b = numbers(first, column), numbers(second, column)
    if min(len(a), len(b)) < _MIN_VALUES:
        return None
    from scipy.stats import ks_2samp

    found = ks_2samp(a, b)
    figures = {"first": _quantiles(a), "second": _quantiles(b)}
    return {"column": column, "test": "ks", "statistic": float(found.statistic), "p": float(found.pvalue), **figures}


def _quantiles(values: Sequence[float]) -> dict[str, Any]:
    low, median, high = np.percentile(values, [5, 50, 95])
    return {"n": len(values), "p5": float(low), "median": float(median), "p95": float(high)}


def _test_categories(column: str, first: Sequence[Row], second: Sequence[Row]) -> dict[str, Any] | None:
    a, b = (Counter(_category(row[column]) for row in rows) for rows in (first, second))
    names = sorted({*a, *b})
    if len(names) < 2 or min(a.total(), b.total()) < _MIN_VALUES:
        return None
    from scipy.stats import chi2_contingency, fisher_exact

    table = [[a[name] for name in names], [b[name] for name in names]]
    test, found = ("fisher", fisher_exact(table)) if len(names) == 2 else ("chi2", chi2_contingency(table))
    statistic = float(found.statistic)
    return {
        "column": column,
        "test": test,
        "statistic": statistic if math.isfinite(statistic) else None,
        "p": float(found.pvalue),
        "first": {name: a[name] for name in names},
        "second": {name: b[name] for name in names},
    }


def _category(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return ", ".join(value) if isinstance(value, tuple | list) else str(value if value is not None else "")


def _holm(values: Sequence[float]) -> list[float]:
    """Return p values after the correction of Holm (1979), by which any of them is false with probability ALPHA."""
    corrected = [1.0] * len(values)
    largest = 0.0
    for rank, k in enumerate(sorted(range(len(values)), key=lambda k: values[k])):
        largest = max(largest, min(1.0, (len(values) - rank) * values[k]))
        corrected[k] = largest
    return corrected


def _pairs(first: Sequence[Row], second: Sequence[Row]) -> tuple[tuple[int, int], ...]:
    places = {start: row["episode"] for row in second if (start := _start(row))}
    return tuple((row["episode"], places[start]) for row in first if (start := _start(row)) and start in places)


def _start(row: Row) -> tuple[int, int] | None:
    seed, attempt = row.get("seed"), row.get("attempt")
    return None if seed is None or attempt is None else (seed, attempt)
