"""A program of the maker's station, from its checkout: `maker_program.py CHECKOUT PROGRAM ARGUMENTS...`.

PROGRAM is gui, deploy, cameras or tests.
"""

from __future__ import annotations

import os
import sys


def main(checkout: str, name: str, *arguments: str) -> None:
    sys.path.insert(0, checkout)
    if name == "tests":
        import pytest

        os.chdir(checkout)
        sys.exit(pytest.main([*arguments, "tests"]))
    from yam_abc_reproduce import cli
    from yam_abc_reproduce.deploy.run import deploy

    {"gui": cli.gui, "cameras": cli.cameras, "deploy": deploy}[name]([*arguments])


if __name__ == "__main__":
    main(*sys.argv[1:])
