"""Let the expert open and seal containers, judged by the benchmark's checker in its planning scene.

python -m tools.bench.lids --open --realizations 0 1 2 3 4 --seed 0
python -m tools.bench.lids --seal twist-lid-jar --realizations 0 1 2 3 4 --seed 0
"""

from __future__ import annotations

from .pouring import run_expert_by_options

_TASKS = {"open": "open_container", "seal": "seal_container"}  # option -> the benchmark's task


def main() -> None:
    """Measure from the command line."""
    run_expert_by_options(__doc__, _TASKS)


if __name__ == "__main__":
    main()
