"""The manufacturer's SDK on the simulated arm: period of its loop, and drift of an arm in gravity compensation.

    python -m tools.bench.can [--hold 60] [--float 10] [--rig RIG] [--channel CHANNEL]

It runs in its own environment, as `make test-clients` makes it. Leave the machine alone meanwhile.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import tempfile
from pathlib import Path

from tests.clients.environments import Environment
from tests.clients.served_robot import served_robot


def main() -> None:
    """Measure, and print JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hold", type=float, default=60.0, help="seconds for which a pose is held")
    parser.add_argument("--float", type=float, default=10.0, dest="drift", help="seconds for which the arm floats")
    parser.add_argument("--rig", default="yam_v1+linear_4310")
    parser.add_argument("--channel", default="can0")
    arguments = parser.parse_args()
    interpreter = Environment("i2rt").make()
    before = os.getloadavg()[0]
    with (
        tempfile.TemporaryDirectory() as folder,
        served_robot(Path(folder) / "buses", "--rig", arguments.rig) as served,
    ):
        told = served.run(
            interpreter,
            "i2rt_arm.py",
            arguments.channel,
            arguments.hold,
            arguments.drift,
            timeout_s=arguments.hold + arguments.drift + 60,
        )
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    load = {"before": before, "after": os.getloadavg()[0], "cores": os.cpu_count()}
    both = {"sdk": told, "server": served.report, "load": load, "cpu_s_of_both": used.ru_utime + used.ru_stime}
    print(json.dumps(both, indent=2))


if __name__ == "__main__":
    main()
