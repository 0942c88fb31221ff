"""A vessel with loose pieces and a closed lid, shaken: pieces that leave through its walls, and depths of contacts."""

from __future__ import annotations

import time
from dataclasses import dataclass

import mujoco
import numpy as np

from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.objects.object_config import ObjectConfig
from yamsim_cli.core.config.program_task import ProgramTask
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.scene.compose import set_friction_cones
from yamsim_cli.core.scene.objects.scene_object import add_object
from yamsim_cli.core.sim.geom_shapes import body_surface
from yamsim_cli.core.sim.interior import Interior
from yamsim_cli.loose_pieces import loose_pieces, stacked_poses

VESSEL = "vessel"
_TIMESTEP = 1 / 480  # s, of the physics of KitchenBench's scenes
_SETTLE_S = 1.0  # s, before the lid is put on
_AMPLITUDE, _TILT = 0.02, 0.26  # m and rad, of the shaking along and about each axis
_FREQUENCIES = (1.2, 2.0)  # Hz; the frequency of each axis is sampled from this range: up to 3.2 m/s2
_EASE_S = 0.5  # s, in which the shaking grows to its full amplitude
_LID_GAP = 0.0015  # m, from the rim, or the highest piece, to the lid
_CHECK_STEPS = 4  # between checks of the contacts


@dataclass(frozen=True)
class ShakenVessel:
    """Results: pieces, those outside after settling and after shaking, depths (m), and seconds of a core for a step."""

    pieces: int
    fell_out: int
    leaked: int
    piece_depth: float
    wall_depth: float
    step_seconds: float


def filled_task(vessel: str, piece: str, grams: float, locations: Locations, **filled: int) -> ProgramTask:
    """Return a task with one object, `VESSEL`, which is filled."""
    outer, inner = (load_config(ObjectConfig, "objects", name, locations) for name in (vessel, piece))
    return ProgramTask.model_validate(
        {
            "name": "shake",
            "kind": "program",
            "rig": "single_linear",
            "things": {VESSEL: {"of": (outer.with_name(VESSEL),), "filled": {"of": inner, "grams": grams, **filled}}},
            "starts": {VESSEL: {"x": (0, 0), "y": (0, 0)}},
            "phrasings": {"training": ("lift it",)},
            "goal": {"all": [{"upright": {"thing": VESSEL}}]},
            "expert": ({"pick": {"thing": VESSEL}},),
        }
    )


def shake(task: ProgramTask, seed: int, seconds: float) -> ShakenVessel:
    """Let a task's pieces settle in its vessel, close it, and shake it for `seconds`."""
    pieces = loose_pieces(task)[VESSEL]
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.integrator = _TIMESTEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    set_friction_cones(spec)
    for item in (*task.objects, *pieces):
        add_object(spec, item, {})
    spec.worldbody.add_body(name="hand", mocap=True)
    weld = spec.add_equality(type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY, name1="hand", name2=VESSEL)
    weld.solref = [2 * _TIMESTEP, 1]
    model = spec.compile()
    data, body = mujoco.MjData(model), model.body(VESSEL).id
    bodies = [model.body(piece.name).id for piece in pieces]
    address = model.jnt_qposadr[model.body_jntadr[bodies]]
    model.qpos0[address[:, None] + np.arange(7)] = stacked_poses(task, VESSEL)
    mujoco.mj_resetData(model, data)
    of_vessel = (model.geom_bodyid == body) & (model.geom_contype != 0)
    surface = body_surface(model, [int(k) for k in np.flatnonzero(of_vessel)])
    inside, rim = Interior(surface), float(surface[0][:, 2].max())

    def places() -> Array:
        found: Array = (data.xipos[bodies] - data.xpos[body]) @ data.xmat[body].reshape(3, 3)
        return found

    mujoco.mj_step(model, data, round(_SETTLE_S / _TIMESTEP))
    fell_out = int((~inside.contains(places())).sum())
    top = max(_capsule_top(model, data, int(k)) for k in np.flatnonzero(np.isin(model.geom_bodyid, bodies)))
    over = max(rim, top - float(data.xpos[body, 2])) + _LID_GAP + 0.01
    spec.body(VESSEL).add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.2, 0.2, 0.01], pos=[0, 0, over], mass=0)
    # The lid changes the model, not the positions.
    settled, model = data.qpos.copy(), spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = settled
    of_piece = np.isin(model.geom_bodyid, bodies)
    rng = np.random.default_rng(seed)
    phase, frequency = rng.uniform(0, 2 * np.pi, 6), rng.uniform(*_FREQUENCIES, 6)
    depth, steps, begin = [0.0, 0.0], round(seconds / _TIMESTEP), time.process_time()
    for k in range(steps):
        share = min(k * _TIMESTEP / _EASE_S, 1.0)
        wave = share * np.sin(2 * np.pi * frequency * k * _TIMESTEP + phase)
        data.mocap_pos[0] = _AMPLITUDE * wave[:3]
        mujoco.mju_axisAngle2Quat(data.mocap_quat[0], *_axis_and_angle(_TILT * wave[3:]))
        mujoco.mj_step(model, data)
        if k % _CHECK_STEPS == 0 and data.ncon:
            sides = of_piece[data.contact.geom]
            for number, which in enumerate((sides.all(axis=1), sides.any(axis=1) & ~sides.all(axis=1))):
                depth[number] = max(depth[number], -float(data.contact.dist[which].min(initial=0.0)))
    spent = (time.process_time() - begin) / max(steps, 1)
    ended = places()
    leaked = int((~inside.contains(ended) & (ended[:, 2] < rim)).sum())
    return ShakenVessel(len(pieces), fell_out, leaked, depth[0], depth[1], spent)


def _capsule_top(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    radius, half = model.geom_size[geom, :2]
    return float(data.geom_xpos[geom, 2] + abs(data.geom_xmat[geom, 8]) * half + radius)


def _axis_and_angle(vector: Array) -> tuple[Array, float]:
    angle = float(np.linalg.norm(vector))
    return (vector / angle, angle) if angle else (np.array([0.0, 0.0, 1.0]), 0.0)
