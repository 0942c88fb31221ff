"""Measure loose pasta as a bulk solid: bulk density, angle of repose, and flow rate out of a tilted carton.

python -m tools.bench.pasta_heap --seeds 3

Pieces fall into an open cylinder, which is then lifted. The bench takes the pieces of KitchenBench's scenes, and the
kitchen's pieces at their own size. Penne and rigatoni of their own size are rods with the outline and mass of the tube.
"""

from __future__ import annotations

import argparse
import itertools
import math
import time
from typing import Any, NamedTuple, cast

import mujoco
import numpy as np
from inspect_robots.rollout import derive_seed
from kitchenbench.sim import build_blueprint

from tools.bench import heap_shape
from tools.bench.kitchen_expert import scenes_of
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.objects.object_config import ObjectConfig
from yamsim_cli.core.config.program_task import ProgramTask
from yamsim_cli.core.config.task_objects import Filling, Role
from yamsim_cli.core.geometry.se3 import quat_from_rotation, rotation_between
from yamsim_cli.core.scene.compose import set_friction_cones
from yamsim_cli.core.scene.objects.scene_object import add_object
from yamsim_cli.kitchenbench.benchmark_scene import open_station_session
from yamsim_cli.kitchenbench.pasta import fillings_of, pasta_config_of
from yamsim_cli.loose_pieces import loose_pieces, stacked_poses

_SCENES = {"full-box": "pour_pasta", "spoon-penne": "scoop_pasta", "measuring-cup-level": "scoop_pasta"}
_NOMINAL = ("kitchen_dry_pasta", "kitchen_penne", "kitchen_rigatoni")
_TILTS = (120.0, 135.0, 145.0)  # degrees, of the carton; the expert tilts by up to 150 degrees
_TIMESTEP = 1 / 480  # s, of the physics of KitchenBench's scenes
_VOLUME, _MOST = 0.3e-3, 300  # m3, total volume of the pieces in the cylinder; their largest number, as in `Filling`
_RADIUS = 0.05  # m, of the cylinder inside: about the length of a piece
_BASE = 0.07  # m, radius of the base with a rim: pieces cover it up to a slope of 40 degrees, and the rest falls off
_FLOOR = 0.3  # m, radius of the base without a rim
_SETTLE_S = 1.0  # s, until pieces rest in the cylinder, and on the base
_LIFT, _LIFT_SPEED = 0.12, 0.15  # m and m/s, of the cylinder
_LEVEL = 0.8  # height below which bulk density is measured, as a share of the surface's mean height
_CLOSED_S, _PATIENCE_S = 0.5, 3.0  # s, in which the closed carton tilts; until an open carton counts as blocked
_JITTER = 0.1  # m/s, standard deviation of a piece's first velocity in a carton, which makes seeds differ


class Heap(NamedTuple):
    """Bulk density (kg/m3), share of the volume that is pieces, angle of repose (degrees), height over the rim (m)."""

    density: float
    solid: float
    angle: float
    height: float


def measure_heap(task: ProgramTask, seed: int, has_rim: bool = True) -> Heap:
    """Drop a task's pieces into a cylinder, measure their bulk density, lift the cylinder, and measure the heap.

    With a rim as high as a piece is thick, pieces do not roll off the base, and the heap is measured above the rim.
    """
    pieces = next(iter(loose_pieces(task).values()))
    part: Any = pieces[0].collision[0]
    axis = np.array([part.start, part.end])
    length = float(np.linalg.norm(axis[1] - axis[0]))
    spec, rim = _world(pieces), 2 * part.radius if has_rim else 0.0
    wall, base = spec.worldbody.add_body(name="cylinder", mocap=True), spec.worldbody.add_body(name="base")
    contact = {"friction": pieces[0].contact.friction, "condim": 3, "solref": [pieces[0].contact.push_out_s, 1.0]}
    radius = _BASE if has_rim else _FLOOR
    wide = [radius + 2 * heap_shape.HALF_WALL, 0.05, 0]
    disc = {"type": mujoco.mjtGeom.mjGEOM_CYLINDER, "size": wide, "pos": [0, 0, -0.05]}
    base.add_geom(**disc, group=heap_shape.BENCH_GROUP, **contact)
    heap_shape.add_ring(wall, _RADIUS, 1.0, contact)
    if has_rim:
        heap_shape.add_ring(base, radius, rim, contact)
    model = spec.compile()
    data, bodies = mujoco.MjData(model), [model.body(piece.name).id for piece in pieces]
    starts = heap_shape.random_ends(len(pieces), length, part.radius, _RADIUS, np.random.default_rng(seed))
    for body, ends in zip(bodies, starts, strict=True):
        R = rotation_between((axis[1] - axis[0]) / length, (ends[1] - ends[0]) / length)
        first = model.jnt_qposadr[model.body_jntadr[body]]
        data.qpos[first : first + 7] = [*(ends.mean(axis=0) - R @ axis.mean(axis=0)), *quat_from_rotation(R)]
    mujoco.mj_step(model, data, round(_SETTLE_S / _TIMESTEP))
    level = _LEVEL * float(heap_shape.surface_heights(model, data, heap_shape.disc_points(0.9 * _RADIUS)).mean())
    ends = data.xpos[bodies][:, None] + axis @ data.xmat[bodies].reshape(-1, 3, 3).transpose(0, 2, 1)
    filled = heap_shape.pieces_below(level, ends, part.radius) / (math.pi * _RADIUS**2 * level)  # pieces in a m3
    for _ in range(round(_LIFT / _LIFT_SPEED / _TIMESTEP)):
        data.mocap_pos[0, 2] += _LIFT_SPEED * _TIMESTEP
        mujoco.mj_step(model, data)
    mujoco.mj_step(model, data, round(_SETTLE_S / _TIMESTEP))
    volume = heap_shape.capsule_volume(length, part.radius)
    radii, heights = heap_shape.heap_profile(model, data, np.zeros(2), radius, rim)
    angle = heap_shape.slope_of(radii, heights)
    return Heap(filled * pieces[0].inertia.mass, filled * volume, angle, float(heights.max()))


def _world(pieces: tuple[ObjectConfig, ...]) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.integrator = _TIMESTEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    set_friction_cones(spec)
    for piece in pieces:
        add_object(spec, piece, {})
    return spec


def measure_flow(task: ProgramTask, seed: int, tilt_deg: float, towards: int) -> tuple[float, float]:
    """Tilt a task's closed carton towards its x (0) or y (1) axis, and open it.

    Return the flow rate (g/s) of the middle 80 % of the pieces, not a number if less than 90 % leave, and the share
    that leaves.
    """
    (vessel,) = task.objects
    pieces = loose_pieces(task)[vessel.name]
    spec = _world(pieces)
    add_object(spec, vessel, {}, fixed=True)
    rim = float(vessel.shape.size_mm[2]) / 1000  # type: ignore[union-attr]
    lid = spec.worldbody.add_body(name="lid", mocap=True, pos=[0, 0, 1.0])
    lid.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.1, 0.1, 0.01])
    model = spec.compile()
    data, bodies = mujoco.MjData(model), [model.body(piece.name).id for piece in pieces]
    joints = model.body_jntadr[bodies]
    data.qpos[model.jnt_qposadr[joints][:, None] + np.arange(7)] = stacked_poses(task, vessel.name)
    jitter = np.random.default_rng(seed).normal(0, _JITTER, (len(pieces), 3))
    data.qvel[model.jnt_dofadr[joints][:, None] + np.arange(3)] = jitter
    mujoco.mj_step(model, data, round(_CLOSED_S / _TIMESTEP))
    lid_index, down = model.body("lid").mocapid[0], float(np.linalg.norm(model.opt.gravity))
    data.mocap_pos[lid_index, 2] = max(rim, float(data.xipos[bodies, 2].max()) + 0.01) + 0.012
    # Instead of the carton, gravity turns.
    for angle in np.radians(np.linspace(0, tilt_deg, round(_CLOSED_S / _TIMESTEP))):
        model.opt.gravity[:] = -math.cos(angle) * down * np.eye(3)[2] + math.sin(angle) * down * np.eye(3)[towards]
        mujoco.mj_step(model, data)
    mujoco.mj_step(model, data, round(_CLOSED_S / _TIMESTEP))
    data.mocap_pos[lid_index, 2] = 10.0
    left = []
    for _ in range(round(_PATIENCE_S / _TIMESTEP)):
        mujoco.mj_step(model, data)
        left.append(float((data.xipos[bodies, 2] > rim).mean()))
        if left[-1] == 1.0:
            break
    grams = 1000 * pieces[0].inertia.mass * len(pieces)
    between = float(np.interp(0.9, left, np.arange(len(left))) - np.interp(0.1, left, np.arange(len(left)))) * _TIMESTEP
    return 0.8 * grams / between if max(left) >= 0.9 else math.nan, max(left)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=3, help="of each measurement")
    parser.add_argument("--only", choices=("heap", "flow"), help="measure only these")
    parser.add_argument("--flat", action="store_true", help="heaps on a base without a rim")
    parser.add_argument(
        "--friction", type=float, help="of the pieces in the cylinder, instead of the tasks' 0.35; with --only heap"
    )
    given = parser.parse_args()
    heaps, cartons = _tasks(given.friction)
    for name, task in heaps.items() if given.only != "flow" else ():
        for seed in range(given.seeds):
            begin, heap = time.process_time(), measure_heap(task, seed, not given.flat)
            print(f"{name}, seed {seed}: {heap.density:.0f} kg/m3, {heap.solid:.2f} of the volume is pieces", end=", ")
            print(f"{heap.angle:.1f} degrees, {1000 * heap.height:.0f} mm high", end=", ")
            print(f"{time.process_time() - begin:.0f} s", flush=True)
    for name, task in cartons.items() if given.only != "heap" else ():
        for tilt, towards, seed in itertools.product(_TILTS, (0, 1), range(given.seeds)):
            rate, share = measure_flow(task, seed, tilt, towards)
            where = f"{name}, {tilt:g} degrees towards its {'xy'[towards]} axis, seed {seed}"
            print(f"{where}: {'blocked' if share < 0.9 else f'{rate:.0f} g/s'}, {share:.0%} left", flush=True)


def _tasks(friction: float | None) -> tuple[dict[str, ProgramTask], dict[str, ProgramTask]]:
    """Return name -> a task whose pieces fall into the cylinder, and name -> a task with a carton of pieces."""
    base = open_station_session("64x48", images=False)
    heaps, cartons = dict[str, ProgramTask](), dict[str, ProgramTask]()

    def task(vessel: ObjectConfig, filling: Filling) -> ProgramTask:
        return base.config.task.model_copy(update={"things": {vessel.name: Role(of=(vessel,), filled=filling)}})

    def amount(piece: ObjectConfig, sliding: float) -> Filling:
        sliding = sliding if friction is None else friction
        contact = piece.contact.model_copy(update={"friction": (sliding, *piece.contact.friction[1:])})
        piece, part = piece.model_copy(update={"contact": contact}), cast("Any", piece.collision[0])
        length = float(np.linalg.norm(np.subtract(part.end, part.start)))
        count = min(_MOST, round(_VOLUME / heap_shape.capsule_volume(length, part.radius)))
        return Filling(of=piece, grams=count * piece.inertia.mass_g, max_pieces=count)

    for scene_name, kind in _SCENES.items():
        scene = scenes_of(kind)[scene_name]
        blueprint = build_blueprint(scene, derive_seed(0, scene.init_seed, 0))
        ((filled, filling),) = fillings_of(blueprint, base.locations).items()
        vessel = pasta_config_of(next(i for i in blueprint.objects if i.name == filled), blueprint, base.locations)
        heaps[scene_name] = task(vessel, amount(filling.of, filling.of.contact.friction[0]))
        if kind == "pour_pasta":
            cartons[scene_name] = task(vessel, filling)
    # The last scene's vessel and friction serve the pieces of nominal size.
    last_vessel, sliding = vessel, filling.of.contact.friction[0]
    for name in _NOMINAL:
        heaps[name] = task(last_vessel, amount(load_config(ObjectConfig, "objects", name, base.locations), sliding))
    (carton,), (coarse,) = cartons["full-box"].objects, cartons["full-box"].things.values()
    nominal = heaps[_NOMINAL[0]].things[last_vessel.name].filled
    assert coarse.filled is not None and nominal is not None
    cartons[f"full-box, {_NOMINAL[0]}"] = task(carton, nominal.model_copy(update={"grams": coarse.filled.grams}))
    return heaps, cartons


if __name__ == "__main__":
    main()
