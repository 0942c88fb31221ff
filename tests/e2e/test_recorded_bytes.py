"""Recordings stay reproducible: the same seeds give the same bytes as before."""

from __future__ import annotations

import pytest

from tests.recorded_bytes import CASES, kept, recorded, sums


@pytest.mark.slow
@pytest.mark.render
@pytest.mark.parametrize("case", CASES)
def test_the_same_seed_gives_the_bytes_that_it_gave(case: str) -> None:
    lists, here = kept(), sums()
    if here not in lists:
        pytest.skip("sums differ in their last bits on this machine, and so do recordings")
    wanted, found = lists[here][case], recorded(case, None)
    if found["versions"] != wanted["versions"]:
        pytest.skip(f"written down with other versions: {wanted['versions']}, here {found['versions']}")
    numbers = ("attempt", "content")
    assert {key: found[key] for key in numbers} == {key: wanted[key] for key in numbers}
    if found["renderer"] != wanted["renderer"]:
        pytest.skip(f"pictures were written down with {wanted['renderer']}, here {found['renderer']} draws")
    assert found == wanted
