"""Print the torque or force that lids need on their way from shut to off, without a hand.

python -m tools.bench.lids

With `--open` or `--seal`, let the expert act, judged by the benchmark's checker in the expert's planning scene after
every motion:

python -m tools.bench.lids --open --realizations 0 1 2 3 4 --seed 0
python -m tools.bench.lids --seal twist-lid-jar food-container --realizations 0 1 2 3 4 --seed 0
"""

from __future__ import annotations

import math

import mujoco
import numpy as np
from inspect_robots.rollout import derive_seed
from kitchenbench.sim import build_blueprint

from tools.bench.kitchen_expert import run_expert_by_options, scenes_of
from yamsim_cli.core.config.objects.articulation import LinkJoint
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.kitchenbench.benchmark_scene import BenchmarkScene, build_benchmark_scene, open_station_session
from yamsim_cli.kitchenbench.lids import LID

_TASKS = {"open": "open_container", "seal": "seal_container"}  # option -> the benchmark's task
_CURVES = {"bottle-cap": 9, "tilted": 9, "snap-lid": 11}  # scene with another lid each -> points of its curve
_SCREW_SPEED, _SLIDE_SPEED = 0.2, 0.002  # rad/s and m/s, of a slow hand at a screw lid and at a snap lid


def main() -> None:
    """Measure from the command line."""
    if not run_expert_by_options(__doc__, _TASKS):
        for name, count in _CURVES.items():
            print_curve(name, count)


def print_curve(name: str, count: int) -> None:
    """Print a lid's curve in the first realization of a scene of `open_container`."""
    scene = scenes_of(_TASKS["open"])[name]
    blueprint = build_blueprint(scene, int(derive_seed(0, scene.init_seed, 0)))
    built = build_benchmark_scene(blueprint, open_station_session("64x48", images=False))
    container = blueprint.roles["container"][0]
    asset = next(item.asset for item in blueprint.objects if item.name == container)
    joint = next(link for link in built.object_configs[container].links if link.name == LID).joint
    if joint.type == "screw":
        unit, last, scale = "N m at degrees", math.radians(joint.range[1]), math.degrees(1)
    else:  # over the clips only
        unit, last, scale = "N at mm", joint.detents[0].at + joint.detents[0].width / 2, 1000
    places = np.linspace(0.0, last, count)
    efforts = opening_efforts(built, container, joint, places)
    curve = ", ".join(f"{effort:.2f} at {scale * place:.1f}" for place, effort in zip(places, efforts, strict=True))
    print(f"{scene.id}, lid of a {asset}, {unit}: {curve}")
    built.simulator.close()


def opening_efforts(built: BenchmarkScene, container: str, joint: LinkJoint, places: Array) -> Array:
    """Return the efforts (n,) that move a lid slowly through positions (n,) of its joint: N m and rad, or N and m."""
    model = built.simulator.scene.model
    data = mujoco.MjData(model)
    speed = _SCREW_SPEED if joint.type == "screw" else _SLIDE_SPEED
    lid, efforts = model.joint(f"{container}_{LID}"), np.empty(len(places))
    for k, place in enumerate(places):
        data.qpos[:], data.qvel[:], data.qacc[:] = built.start, 0.0, 0.0
        data.qpos[lid.qposadr[0]], data.qvel[lid.dofadr[0]] = place, speed
        if joint.type == "screw":  # the lift belongs to the angle
            thread, lead = model.joint(f"{container}_{LID}_thread"), (joint.pitch or 0.0) / (2 * math.pi)
            data.qpos[thread.qposadr[0]], data.qvel[thread.dofadr[0]] = lead * place, lead * speed
        mujoco.mj_inverse(model, data)
        efforts[k] = data.qfrc_inverse[lid.dofadr[0]]
    return efforts


if __name__ == "__main__":
    main()
