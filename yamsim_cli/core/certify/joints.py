"""Whether each joint of a thing reaches both ends of its range, and comes to rest."""

from __future__ import annotations

import mujoco
import numpy as np

from ..config.things.articulation import Link
from .outcome import Outcome, View, short, unchecked
from .subject import Subject, bare_spec, compiled, step, with_camera

_PUSH_TIME, _REST_TIME = 4.0, 3.0  # s, from end to end, and to come to rest
_AT_END = 0.03  # most distance from an end, as a share of the range
_STILL = 0.02  # 1/s, most speed at rest, in ranges a second
_TIMES = 3.0  # effort of a push, as a multiple of friction, ridges and weight
_LEAST = {True: 0.02, False: 1.0}  # least effort on a hinge, N m, and on a slide, N
_FREQUENCY = 6.0  # Hz, natural frequency of the push's controller


def articulation(subject: Subject) -> Outcome:
    """Whether every joint can be moved from stop to stop, and then stays or falls shut."""
    links = subject.item.links
    if not links:
        return unchecked("nothing moves on it")
    spec = bare_spec(subject.item, subject.meshes, fixed=True)
    model = compiled(with_camera(spec, (0, 0, subject.size * 0.2), subject.size))
    data = mujoco.MjData(model)
    reached: dict[str, float] = {}
    views, faults, fastest = list[View](), list[str](), 0.0
    for link in links:
        name = f"{subject.item.name}_{link.name}"
        for end in (1, 0):
            missing = _push(model, data, link, name, end)
            which = "upper" if end else "lower"
            reached[f"{link.name}_{which}_missing"] = short(missing, 3)
            if end:
                views.append(View(model, data.qpos.copy(), f"{link.name} at its upper end"))
            if missing > _AT_END:
                faults.append(f"{link.name} stops {missing * 100:.3g} % of its way before its {which} end")
        data.qfrc_applied[:] = 0
        step(model, data, _REST_TIME)
        speed = abs(float(data.joint(name).qvel[0])) / float(np.ptp(model.joint(name).range))
        fastest = max(fastest, speed)
        if speed > _STILL:
            faults.append(f"{link.name} does not come to rest: {speed:.3g} of its way a second")
    figures = {"joints": len(links), "last_speed_1_s": short(fastest, 3), **reached}
    return Outcome(not faults, figures, "; ".join(faults), tuple(views))


def _push(model: mujoco.MjModel, data: mujoco.MjData, link: Link, name: str, end: int) -> float:
    """The share of the range that is missing to an end after a push towards that end."""
    mujoco.mj_resetData(model, data)
    mujoco.mj_forward(model, data)
    joint = model.joint(name)
    address, dof = joint.qposadr[0], joint.dofadr[0]
    goal, travel = float(joint.range[end]), float(np.ptp(joint.range))
    effort = _effort(model, data, link, name)
    moved = 1.0 / max(float(model.dof_invweight0[dof]), 1e-6)
    stiff = max(moved * (2 * np.pi * _FREQUENCY) ** 2, effort / (0.02 * travel))
    damp = 2 * np.sqrt(stiff * moved)
    for _ in range(round(_PUSH_TIME / model.opt.timestep)):
        wanted = stiff * (goal - data.qpos[address]) - damp * data.qvel[dof]
        data.qfrc_applied[dof] = np.clip(wanted, -effort, effort)
        mujoco.mj_step(model, data)
    return abs(goal - float(data.qpos[address])) / travel


def _effort(model: mujoco.MjModel, data: mujoco.MjData, link: Link, name: str) -> float:
    """The effort of a push, N or N m: a multiple of the friction, the ridges and the weight of the moving part."""
    joint = link.joint
    body = model.body(name).id
    weight = float(model.body_subtreemass[body]) * 9.81
    if joint.turns:
        reach = float(np.linalg.norm(model.geom_pos[model.geom_bodyid == body], axis=1).max(initial=0.02)) + 0.02
        weight *= reach
    ridge = max((detent.effort for detent in joint.detents), default=0.0)
    return max(_TIMES * (joint.friction + ridge + weight), _LEAST[joint.turns])
