"""Errors of `yamsim identify` for arms with known parameters.

    python -m tools.bench.identify --plants 20
    python -m tools.bench.identify --plants 0 --bad 20

Plants have a physics of their own: other integrators, steps of 0.5 ms, another law of friction. They follow `yamsim
excite`, and are logged as by a bus (16 bits, jittered times). `--bad` logs arms of which one joint moves too little,
and counts the logs that are refused by that joint's name.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from dataclasses import dataclass

import numpy as np

from tests.planted_arms import TrueParameters, drive, random_plant
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.real.identify.excitation import Excitation, generate_excitation
from yamsim_cli.real.identify.identification import IdentificationResult, identify_arms

# Name -> largest error, as a share of the true value, or in its own unit.
_GOALS = {
    "delay_s": (0.002, False),
    "friction_nm": (0.05, True),
    "damping_nms": (0.15, True),
    "armature": (0.30, True),
    "offset_rad": (np.radians(0.2), False),
    "gravity_factor": (0.02, False),
}


@dataclass(frozen=True)
class _Row:
    name: str
    joint: str
    error: float
    inside: bool
    told: bool


def _true(planted: TrueParameters, name: str, joint: int) -> float:
    field = name.partition("_")[0]
    found = getattr(planted, field)
    return float(found if field == "delay" else found[joint])


def _rows(planted: TrueParameters, found: IdentificationResult, joints: tuple[str, ...]) -> list[_Row]:
    rows = []
    for each in found.estimates:
        true = _true(planted, each.name, joints.index(each.joint) if each.joint else 0)
        error = abs(each.value - true) / (true if _GOALS[each.name][1] else 1.0)
        rows.append(_Row(each.name, each.joint, error, each.low <= true <= each.high, each.is_determined))
    return rows


def _bad(commands: Array, joint: int, way: int, rng: np.random.Generator) -> str:
    """Reduce the motion (n, dof) of one joint in one of five ways, and name the way."""
    share, middle = np.linspace(0, 1, len(commands)), commands[0, joint]
    names = ("stands still", "trembles", "turns one way", "turns back twice", "is always slow")
    commands[:, joint] = (
        middle
        + (
            np.zeros(len(share)),
            0.02 * np.sin(2 * np.pi * rng.uniform(10, 60) * share),
            rng.choice([-0.4, 0.4]) * share,
            0.4 * np.sin(1.5 * np.pi * share) * rng.choice([-1, 1]),
            0.1 * np.sin(2 * np.pi * rng.uniform(3, 5) * share),
        )[way]
    )
    return names[way]


def _refused(rig: RigConfig, motion: Excitation, opened: float, number: int) -> bool:
    """Whether a badly excited log is refused with the name of its joint, and with what to record; prints the result."""
    rng, arm = np.random.default_rng([number, 1]), rig.arms[0]
    commands, joint = motion.commands.copy(), int(np.random.default_rng(number).integers(arm.robot.dof))
    way = _bad(commands, joint, number % 5, rng)
    log = drive(arm, random_plant(arm, rng), motion.times, commands, rng, opening=opened)
    name = arm.robot.joint_names[joint]
    try:
        identify_arms(rig, [log], [], "planted")
        said = "taken"
    except DatasetError as error:
        said = str(error)
    sys.stdout.write(f"log {number}: {name} {way}: {said}\n")
    sys.stdout.flush()
    return f" {name} " in said and "; record " in said


def main() -> None:
    """Plant, identify, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plants", type=int, default=20)
    parser.add_argument("--first", type=int, default=0, help="number of the first plant")
    parser.add_argument("--seconds", type=float, default=60.0, help="of each log")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin no plant after so long")
    parser.add_argument("--bad", type=int, default=0, help="how many badly excited logs of 30 s")
    parser.add_argument("--rig", default="single")
    options = parser.parse_args()
    where = Locations.from_environment(os.environ)
    rig = load_config(RigConfig, "rigs", options.rig, where)
    scene = load_config(SceneConfig, "scenes", "tabletop", where)
    opened = rig.arms[0].robot.fingers.initial_opening if rig.arms[0].robot.fingers else 0.0
    if options.bad:
        motion = generate_excitation(rig, 0, scene, where, 30.0, 0)
        refused = [_refused(rig, motion, opened, number) for number in range(options.bad)]
        sys.stdout.write(f"{sum(refused)} of {len(refused)} badly excited logs are refused by the joint's name\n")
    rows: list[_Row] = []
    falls: list[float] = []
    began = time.perf_counter()
    for number in range(options.first, options.first + options.plants):
        if time.perf_counter() - began > 60 * options.minutes:
            break
        motion = generate_excitation(rig, 0, scene, where, options.seconds, number)
        rng = np.random.default_rng(number)
        planted = random_plant(rig.arms[0], rng)
        log = drive(rig.arms[0], planted, motion.times, motion.commands, rng, opening=opened)
        begun = time.perf_counter()
        found = identify_arms(rig, [log], [], "planted")[0]
        here = _rows(planted, found, rig.arms[0].robot.joint_names)
        rows += here
        falls.append(found.held_out_error.relative_reduction)
        _tell(number, planted, found, here, time.perf_counter() - begun)
    if rows:
        _table(rows, falls)


def _tell(number: int, planted: TrueParameters, found: IdentificationResult, rows: list[_Row], spent: float) -> None:
    missed = [f"{r.joint} {r.name} {r.error:.3g}" for r in rows if r.told and r.error > _GOALS[r.name][0]]
    outside = [f"{r.joint} {r.name}" for r in rows if not r.inside]
    gap = f"gap {1000 * found.held_out_error.rms_before:.1f} -> {1000 * found.held_out_error.rms_after:.2f} mrad"
    sys.stdout.write(
        f"plant {number}: {planted.law}, {planted.integrator}, {spent:.0f} s, {gap}; missed: {', '.join(missed)}; "
        f"outside: {', '.join(outside)}\n"
    )
    sys.stdout.flush()


def _table(rows: list[_Row], falls: list[float]) -> None:
    sys.stdout.write(f"{len(falls)} plants\n")
    sys.stdout.write("| parameter | goal | median | 95 % | most | within the goal | inside its interval | told |\n")
    sys.stdout.write("|---|---|---|---|---|---|---|---|\n")
    for name, (goal, _) in _GOALS.items():
        mine = [row for row in rows if row.name == name]
        told = [row for row in mine if row.told]
        errors = np.array([row.error for row in told])
        sys.stdout.write(
            f"| {name} | {goal:.3g} | {np.median(errors):.3g} | {np.quantile(errors, 0.95):.3g} | {errors.max():.3g} | "
            f"{np.mean(errors <= goal):.1%} | {np.mean([row.inside for row in mine]):.1%} | "
            f"{len(told)} of {len(mine)} |\n"
        )
    sys.stdout.write(f"The gap on what was held out fell by {min(falls):.1%} at least, {np.median(falls):.1%} median\n")


if __name__ == "__main__":
    main()
