"""Whether a gripper's pads hold cloth by friction alone: at a corner on the table, or at an edge between the pads.

python -m tools.bench.cloth_grip --gripper flexible_4310
"""

from __future__ import annotations

import argparse
import itertools
import os
from dataclasses import dataclass

import mujoco
import numpy as np

from tests.hands import hand
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.objects.object_config import ObjectConfig
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.scene.cloth import add_cloth, flat_points

_CLOTH = "soft_napkin"
_STEP = 0.004
# m, initial opening of each finger, over cloth that lies and beside cloth that is upright
_LYING, _UPRIGHT = 0.012, 0.0035
_CLOSING, _LIFTING, _HOLDING, _LIFT = 0.6, 0.8, 0.4, 0.1  # s, phases of the hand's motion; m, height of the lift
# m, distance of the pads from the corner, along either side
_INWARDS = 0.005
# m, height of an edge between pads over the tips
_EDGE = 0.010
# mm; a smaller slip counts as none
_HELD = 10.0


@dataclass(frozen=True)
class Setting:
    """How a hand grasps cloth. `tips`: height over the table at a corner that lies there, m; None for an edge between
    them.
    """

    tips: float | None
    friction: float
    impratio: float
    grid: int
    force: float

    def __str__(self) -> str:
        where = "an edge between the pads" if self.tips is None else f"tips {self.tips * 1000:+.0f} mm over the table"
        return (
            f"{where}, friction {self.friction:g}, impratio {self.impratio:g}, {self.grid} x {self.grid} points, "
            f"{self.force:g} N"
        )


def settings() -> list[Setting]:
    """Return all settings, most of a coarse grid."""
    where = (-0.001, 0.001, 0.003, 0.005, None)
    coarse = [Setting(*one, 9, 20.0) for one in itertools.product(where, (1.0, 3.0), (10.0, 100.0))]
    return [*coarse, *(Setting(at, 3.0, 10.0, 21, 20.0) for at in (0.001, 0.003, None))]


def slip(gripper: str, setting: Setting) -> float:
    """Return how much less the cloth rose than the hand, mm."""
    found = load_config(ObjectConfig, "objects", _CLOTH, Locations.from_environment(os.environ))
    assert found.cloth is not None
    cloth = found.cloth.model_copy(update={"grid": (setting.grid, setting.grid), "friction": setting.friction})
    model = _model(gripper, found.model_copy(update={"cloth": cloth}), setting)
    data, rest = mujoco.MjData(model), flat_points(cloth)
    fingers = [model.joint(f"{side}_finger").qposadr[0] for side in ("left", "right")]
    points = np.arange(model.nq - 3 * len(rest), model.nq).reshape(-1, 3)
    data.qpos[fingers] = _LYING if setting.tips is not None else _UPRIGHT
    tips, half = _tips(model, data), cloth.size[0] / 2
    if setting.tips is None:
        # Across the closing axis, with its upper edge between the pads; there is no table.
        at = np.column_stack([rest[:, 0], np.zeros(len(rest)), rest[:, 1] - half + tips + _EDGE])
        data.mocap_pos[0, 2] = tips - 1.0
    else:
        table = tips - setting.tips
        at = rest + np.array([half - _INWARDS, half - _INWARDS, cloth.half_thickness + table])
        data.mocap_pos[0, 2] = table
    data.qpos[points] = at - rest
    mujoco.mj_kinematics(model, data)
    # The corner itself, or the middle of the edge.
    taken = int(np.linalg.norm(at - (0, 0, at[:, 2].max()), axis=1).argmin())
    lifted = np.linspace(0, _LIFT, round(_LIFTING / _STEP))
    _pull(model, data, np.zeros(round(_CLOSING / _STEP)), setting.force)
    before = _above(model, data, taken)
    _pull(model, data, np.r_[lifted, np.full(round(_HOLDING / _STEP), _LIFT)], setting.force)
    return 1000 * (_above(model, data, taken) - before)


def _pull(model: mujoco.MjModel, data: mujoco.MjData, heights: Array, force: float) -> None:
    """Step with the hand commanded to heights (n,), m, pressing with `force`, N."""
    grip, opening = model.actuator("gripper").id, model.joint("left_finger").qposadr[0]
    for height in heights:
        # Both fingers share the drive's force.
        data.ctrl[grip] = data.qpos[opening] - 2 * force / model.actuator_gainprm[grip, 0]
        data.ctrl[model.actuator("up").id] = height
        mujoco.mj_step(model, data)


def _above(model: mujoco.MjModel, data: mujoco.MjData, point: int) -> float:
    """Return the hand's height over a point of the cloth, m."""
    mujoco.mj_forward(model, data)
    return float(data.site("pinch_site").xpos[2] - data.flexvert_xpos[point, 2])


def _model(gripper: str, item: ObjectConfig, setting: Setting) -> mujoco.MjModel:
    spec = hand(gripper)
    spec.option.timestep, spec.option.integrator = _STEP, mujoco.mjtIntegrator.mjINT_DISCRETE
    spec.option.impratio, spec.option.gravity = setting.impratio, (0, 0, -9.81)
    for geom in spec.geoms:
        if geom.priority:
            geom.friction = [setting.friction, *geom.friction[1:]]
    # Fingers down, closing along y.
    flange = spec.worldbody.first_body()
    x, y, _ = spec.site("pinch_site").pos
    flange.quat, flange.gravcomp = (0.5**0.5 * np.array([0, 1, 1, 0])), 1
    turned = np.empty(3)
    mujoco.mju_rotVecQuat(turned, np.array([x, y, 0.0]), flange.quat)
    flange.pos = -turned
    flange.add_joint(name="up", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=_in_body(flange.quat), damping=200, armature=1)
    up = spec.add_actuator(name="up", target="up", trntype=mujoco.mjtTrn.mjTRN_JOINT)
    up.set_to_position(kp=20000, kv=400)
    table = spec.worldbody.add_body(name="table", mocap=True)
    table.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[1, 1, 0.05], pos=[0, 0, -0.05], condim=4)
    add_cloth(spec, item)
    return spec.compile()


def _in_body(quat: Array) -> Array:
    """Return the world's z axis (3,) in a body's frame."""
    back, up = np.empty(4), np.empty(3)
    mujoco.mju_negQuat(back, np.asarray(quat, np.float64))
    mujoco.mju_rotVecQuat(up, np.array([0.0, 0.0, 1.0]), back)
    return up


def _tips(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """Return the height of the fingers' lowest point, m."""
    mujoco.mj_kinematics(model, data)
    lowest = np.inf
    for geom in range(model.ngeom):
        if not any(part in model.body(model.geom_bodyid[geom]).name for part in ("finger", "foot")):
            continue
        middle, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        R = data.geom_xmat[geom].reshape(3, 3)
        lowest = min(lowest, float((data.geom_xpos[geom] + R @ middle)[2] - np.abs(R[2]) @ half))
    return lowest


def main() -> None:
    """Try all settings with a gripper."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--gripper", default="linear_4310")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--n", type=int, default=100)
    given = parser.parse_args()
    slips: dict[bool, list[float]] = {False: [], True: []}
    for setting in settings()[given.first : given.first + given.n]:
        slipped = slip(given.gripper, setting)
        slips[setting.tips is None].append(slipped)
        print(f"{given.gripper}: {setting}: {slipped:.0f} mm of {_LIFT * 1000:.0f}", flush=True)
    for between, found in slips.items():
        if found:
            where = "an edge between the pads" if between else "a corner that lies"
            held = sum(one < _HELD for one in found)
            print(f"{given.gripper}, {where}: held {held} of {len(found)}; {min(found):.0f} to {max(found):.0f} mm")


if __name__ == "__main__":
    main()
