import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from yamsim_cli.core.statistics import (
    compute_coverage,
    compute_histogram,
    student_t_quantile_95,
    summarize_values,
    wilson_interval_95,
)

# Source: the formula of Wilson (1927) as in R's prop.test(correct=FALSE) and Newcombe (1998), table I, method 3.
PUBLISHED = [
    (0, 10, 0.0, 0.2775),
    (10, 10, 0.7225, 1.0),
    (5, 10, 0.2366, 0.7634),
    (81, 263, 0.2553, 0.3662),
    (15, 148, 0.0624, 0.1605),
    (0, 20, 0.0, 0.1611),
    (1, 29, 0.0061, 0.1718),
    (29, 29, 0.8830, 1.0),
    (98, 100, 0.9300, 0.9945),
]

# Source: NIST/SEMATECH e-Handbook of Statistical Methods, 1.3.6.7.2: two-sided 95 % by degrees of freedom.
STUDENT = {1: 12.706, 5: 2.571, 23: 2.069, 30: 2.042, 100: 1.984}

counts = st.integers(1, 10_000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n)))


@pytest.mark.parametrize("freedom", STUDENT)
def test_students_quantile_is_the_published_one(freedom: int) -> None:
    assert student_t_quantile_95(freedom) == pytest.approx(STUDENT[freedom], abs=6e-4)


@pytest.mark.parametrize(("successes", "n", "low", "high"), PUBLISHED)
def test_the_interval_is_the_published_one(successes, n, low, high):
    assert wilson_interval_95(successes, n) == pytest.approx((low, high), abs=6e-5)


@given(counts)
def test_the_interval_holds_the_rate_and_lies_in_the_range_of_rates(count):
    successes, n = count
    low, high = wilson_interval_95(successes, n)
    assert 0 <= low <= successes / n <= high <= 1
    assert low < high
    assert (low == 0) is (successes == 0) and (high == 1) is (successes == n)


@given(counts)
def test_successes_and_failures_mirror_each_other(count):
    successes, n = count
    low, high = wilson_interval_95(successes, n)
    assert wilson_interval_95(n - successes, n) == pytest.approx((1 - high, 1 - low), abs=1e-12)


@given(counts)
def test_its_bounds_are_where_the_rate_is_196_standard_errors_away(count):
    """By definition, from either bound, the observed rate is just as far away as 95 % allows."""
    successes, n = count
    for bound in wilson_interval_95(successes, n):
        if 0 < bound < 1:
            distance = abs(successes / n - bound) / math.sqrt(bound * (1 - bound) / n)
            assert distance == pytest.approx(1.959964, rel=1e-4)


def test_the_spread_of_a_few_values():
    assert summarize_values([3.0, 1.0, 2.0]) == {"median": 2.0, "p95": pytest.approx(2.9), "max": 3.0}
    assert summarize_values([0.5]) == {"median": 0.5, "p95": 0.5, "max": 0.5}


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=50))
def test_the_spread_is_ordered_and_of_plain_floats(values):
    result = summarize_values(values)
    assert result["median"] <= result["p95"] <= result["max"] == max(values)
    assert result["median"] == pytest.approx(np.sort(values)[[(len(values) - 1) // 2, len(values) // 2]].mean())
    assert {type(value) for value in result.values()} == {float}


def test_a_histogram_counts_every_value_in_round_bins():
    values = [0.0012, 0.0013, 0.0029, 0.0031, 0.0070]
    found = compute_histogram(values)
    edges, counts = found["edges"], found["counts"]
    assert sum(counts) == len(values)
    assert len(edges) == len(counts) + 1
    assert edges[0] <= min(values)
    assert edges[-1] >= max(values)
    width = edges[1] - edges[0]
    assert width == pytest.approx(0.0002)
    assert edges[0] / width == pytest.approx(round(edges[0] / width))


@given(st.lists(st.floats(-10, 10), min_size=1, max_size=50))
def test_a_histogram_of_anything_is_small_and_complete(values):
    found = compute_histogram(values)
    assert sum(found["counts"]) == len(values)
    assert len(found["counts"]) <= 45
    assert all(low < high for low, high in itertools.pairwise(found["edges"]))


def test_statistics_without_values():
    assert wilson_interval_95(0, 0) == (0.0, 1.0)
    assert summarize_values([]) is None
    assert compute_histogram([]) is None
    grid = compute_coverage([(0.3, 0.0)], (0.3, 0.3), (0.0, 0.0), 0.05)
    assert (grid.cell_count, grid.hit_cell_count, grid.outside) == (1, 1, 0)


def test_cells_of_a_box_are_counted():
    grid = compute_coverage(
        [(0.30, -0.18), (0.55, 0.18), (0.31, -0.17), (0.2, 0.0), (0.4, 0.19)], (0.30, 0.55), (-0.18, 0.18), 0.05
    )
    assert grid.shape == (5, 8)
    assert (grid.cell_count, grid.hit_cell_count, grid.outside) == (40, 2, 2)
    assert grid.hits[0][0] == 2
    assert grid.hits[4][7] == 1
