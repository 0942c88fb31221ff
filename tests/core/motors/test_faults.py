from __future__ import annotations

import pytest

from yamsim_cli.core.errors import UsageError
from yamsim_cli.core.motors.faults import Fault, parse_fault


def test_a_fault_by_its_flag() -> None:
    assert parse_fault("lost:motor=3,at=5,for=2,channel=can_left") == Fault("lost", "can_left", 3, 5.0, 2.0)
    assert parse_fault("stuck") == Fault("stuck")
    assert parse_fault("drop:share=0.5").share == 0.5


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("broken", "unknown fault 'broken'; valid: lost, hot, drop, stuck"),
        ("lost", "say which motor"),
        ("lost:motor=x", "motor 'x' is not valid; it must lie in 1..15"),
        ("lost:motor=1.5", "motor '1.5' is not valid"),
        ("drop:motor=1", "a drop fault has no 'motor'; valid: share, channel, at, for"),
        ("drop:share=2", "it must lie in 0..1"),
        ("drop:share=0.1,share=0.2", "share is there twice"),
    ],
)
def test_a_wrong_flag_says_what_would_be_valid(text: str, says: str) -> None:
    with pytest.raises(UsageError) as caught:
        parse_fault(text)
    assert says in str(caught.value)
