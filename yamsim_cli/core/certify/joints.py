"""Whether what moves on a thing does: each joint reaches both ends, and comes to rest."""

from __future__ import annotations

import mujoco
import numpy as np

from ..config.things.articulation import Link
from .outcome import Outcome, View, short, unchecked
from .subject import Subject, bare_spec, compiled, with_camera

# So long may a way take, and coming to rest, s.
_WAY, _REST = 4.0, 3.0
# A joint is at its end within this share of its way, and at rest below this speed, of its way a second.
_THERE, _STILL = 0.03, 0.02
# A person pushes with so many times what it takes to move it at all.
_TIMES = 3.0
_LEAST = {True: 0.02, False: 1.0}
_FREQUENCY = 6.0


def articulation(looked: Subject) -> Outcome:
    """Whether every joint can be moved from stop to stop, and stays where it is left or falls shut."""
    links = looked.item.links
    if not links:
        return unchecked("nothing moves on it")
    size = float(np.linalg.norm(np.ptp(looked.touching, axis=0)))
    model = compiled(with_camera(bare_spec(looked.item, looked.meshes, fixed=True), (0, 0, size * 0.2), size))
    data = mujoco.MjData(model)
    reached: dict[str, float] = {}
    views, faults, fastest = list[View](), list[str](), 0.0
    for link in links:
        name = f"{looked.item.name}_{link.name}"
        for end in (1, 0):
            missing = _push(model, data, link, name, end)
            reached[f"{link.name}_{'upper' if end else 'lower'}_missing"] = short(missing, 3)
            if end:
                views.append(View(model, data.qpos.copy(), f"{link.name} at its upper end"))
            if missing > _THERE:
                which = "upper" if end else "lower"
                faults.append(f"{link.name} stops {missing * 100:.3g} % of its way before its {which} end")
        data.qfrc_applied[:] = 0
        _run(model, data, _REST)
        way = float(np.ptp(model.joint(name).range))
        speed = abs(float(data.joint(name).qvel[0])) / way
        fastest = max(fastest, speed)
        if speed > _STILL:
            faults.append(f"{link.name} does not come to rest: {speed:.3g} of its way a second")
    figures = {"joints": len(links), "last_speed_1_s": short(fastest, 3), **reached}
    return Outcome(not faults, figures, "; ".join(faults), tuple(views))


def _push(model: mujoco.MjModel, data: mujoco.MjData, link: Link, name: str, end: int) -> float:
    """Which share of the way is left to its end after it was pushed there."""
    mujoco.mj_resetData(model, data)
    mujoco.mj_forward(model, data)
    joint = model.joint(name)
    address, dof = joint.qposadr[0], joint.dofadr[0]
    goal, way = float(joint.range[end]), float(np.ptp(joint.range))
    effort = _effort(model, data, link, name)
    moved = 1.0 / max(float(model.dof_invweight0[dof]), 1e-6)
    stiff = max(moved * (2 * np.pi * _FREQUENCY) ** 2, effort / (0.02 * way))
    damp = 2 * np.sqrt(stiff * moved)
    for _ in range(round(_WAY / model.opt.timestep)):
        wanted = stiff * (goal - data.qpos[address]) - damp * data.qvel[dof]
        data.qfrc_applied[dof] = np.clip(wanted, -effort, effort)
        mujoco.mj_step(model, data)
    return abs(goal - float(data.qpos[address])) / way


def _effort(model: mujoco.MjModel, data: mujoco.MjData, link: Link, name: str) -> float:
    """What a hand pushes with: some times the friction, the ridges and the weight of what moves, N or N m."""
    joint = link.joint
    body = model.body(name).id
    weight = float(model.body_subtreemass[body]) * 9.81
    if joint.turns:
        reach = float(np.linalg.norm(model.geom_pos[model.geom_bodyid == body], axis=1).max(initial=0.02)) + 0.02
        weight *= reach
    ridge = max((detent.effort for detent in joint.detents), default=0.0)
    return max(_TIMES * (joint.friction + ridge + weight), _LEAST[joint.turns])


def _run(model: mujoco.MjModel, data: mujoco.MjData, seconds: float) -> None:
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
