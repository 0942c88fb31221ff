"""Shake closed vessels with loose pieces: pieces that leak through walls, depths of contacts, time of a step.

python -m tools.bench.shaken_vessels --n 3
"""

from __future__ import annotations

import argparse

from tests.shaken_vessel import filled_task, shake
from yamsim_cli.kitchenbench.benchmark_scene import open_station_session

# Vessel, piece and grams.
_FILLINGS = (
    ("kitchen_measuring_cup", "kitchen_dry_pasta", 80.0),
    ("kitchen_measuring_cup", "kitchen_dry_pasta", 150.0),
    ("kitchen_measuring_cup", "kitchen_dry_pasta", 200.0),
    ("kitchen_cup", "kitchen_dry_pasta", 120.0),
    ("kitchen_bowl", "kitchen_dry_pasta", 200.0),
    ("kitchen_jar", "kitchen_penne", 70.0),
    ("kitchen_pot", "kitchen_dry_pasta", 500.0),
    ("kitchen_food_container", "kitchen_rigatoni", 190.0),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--n", type=int, default=3, help="seeds of each filling")
    parser.add_argument("--seconds", type=float, default=1.5, help="of shaking, simulated")
    given = parser.parse_args()
    locations = open_station_session("64x48", images=False).locations
    leaked = vessels = 0
    for vessel, piece, grams in _FILLINGS:
        task = filled_task(vessel, piece, grams, locations)
        for seed in range(given.n):
            one = shake(task, seed, given.seconds)
            leaked, vessels = leaked + (one.leaked > 0), vessels + 1
            deepest = f"{1000 * one.piece_depth:.2f} mm between pieces, {1000 * one.wall_depth:.2f} mm in the vessel"
            print(f"{vessel} {grams:g} g, {one.pieces} x {piece}, seed {seed}: fell out {one.fell_out}", end=", ")
            print(f"leaked {one.leaked}, deepest {deepest}, {1000 * one.step_seconds:.1f} ms a step", flush=True)
    print(f"{leaked} of {vessels} vessels leaked")


if __name__ == "__main__":
    main()
