"""Speed of a served arm with other programs' own clients: portal's calls, and chiral's observations with pictures.

    MUJOCO_GL=egl YAMSIM_CHIRAL=CHECKOUT python -m tools.bench.served

Leave the machine alone meanwhile. Clients run in environments of their own, as `make test-clients` makes them.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tests.clients.environments import checkout
from tests.clients.rows import ROWS
from tests.clients.served_robot import served_robot

_CALLS = 3000
_STATION = ("--rig", "yam_station_linear_4310_d405", "--size", "160x120", "--quality", "fast")


def main() -> None:
    """Measure, and print a table."""
    print("| | median | 95 % | a second |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        with served_robot(Path(folder) / "portal", "--portal", "0") as served:
            told = ROWS["portal"].environment.make().run("portal_arm.py", served.ports[0], _CALLS)
            print(_row("portal: `get_joint_pos`", told["p50_ms"], told["p95_ms"], told["calls_s"]))
        with served_robot(Path(folder) / "chiral", *_STATION, "--chiral", "0") as served:
            interpreter = ROWS["chiral"].environment.make()
            told = interpreter.run("drive_chiral.py", checkout("YAMSIM_CHIRAL"), served.chiral)
            print(_row(f"chiral: `get_obs`, {_seen(told)}", told["median_ms"], told["p95_ms"], told["a_second"]))


def _seen(told: Mapping[str, Any]) -> str:
    shapes = {"x".join(map(str, shape[1::-1])) for shape, *_ in told["cameras"].values()}
    return f"{len(told['cameras'])} pictures of {' and '.join(shapes)}"


def _row(name: str, median: float, most: float, rate: float) -> str:
    return f"| {name} | {median:.2g} ms | {most:.2g} ms | {rate:.0f} |"


if __name__ == "__main__":
    main()
