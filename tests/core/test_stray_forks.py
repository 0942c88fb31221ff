"""Forks of foreign code end where they come back; what happens in this process stays as it is."""

from __future__ import annotations

import os
import sys

import pytest

from yamsim_cli.core.workers.serving import forks_end_here


def _code(child: int) -> int:
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


@pytest.mark.parametrize(("how", "code"), [("returns", 1), ("raises", 1), (None, 0), (3, 3), ("a word", 1)])
def test_a_fork_ends_however_it_leaves(how: object, code: int) -> None:
    with forks_end_here():
        child = os.fork()
        if child == 0 and how == "raises":
            raise ValueError
        if child == 0 and how != "returns":
            sys.exit(how)  # type: ignore[arg-type]
    # Only the parent gets here.
    assert _code(child) == code


def test_this_process_is_not_ended() -> None:
    with forks_end_here():
        pass
    for error in (ValueError, SystemExit):
        with pytest.raises(error), forks_end_here():
            raise error
