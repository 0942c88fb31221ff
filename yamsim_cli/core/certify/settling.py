"""Checks on the ground: whether a thing rests still on every face, and survives being dropped."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from ..geometry.attitudes import Attitude, attitudes
from ..geometry.se3 import Array, pose, quat_from_rotation, rotation_from_vector
from ..scene.compiling import breakdown
from .outcome import Outcome, View, short, unchecked
from .subject import Subject, compiled, grounded_spec, with_camera

_SETTLE, _LOOK = 6.0, 0.2  # s, most time to settle, and interval between tests for rest
_REST, _FALL = 2.0, 1.5  # s, time for which the thing must rest still, and time of a drop
_TILT, _DRIFT, _SINK = np.radians(3.0), 0.003, 0.0015  # rad, m, m, most motion at rest, and most penetration
_HEIGHT, _DROPS = 0.10, 8  # m, height and number of drops
_THROUGH = 0.05  # m, most penetration at impact, half the slab: deeper, the thing would come out below
_GAIN, _LEAST_ENERGY = 0.02, 1e-4  # most gain of energy as a share of the fall's energy, which is at least so many J
_STILL = 0.0002  # m/s, speed at rest; ten times as many rad/s
_FIXED = "its base is fixed: it lies nowhere else"


@dataclass
class _World:
    """A thing over a slab."""

    subject: Subject
    model: mujoco.MjModel
    data: mujoco.MjData

    @classmethod
    def of(cls, subject: Subject) -> _World:
        spec = with_camera(grounded_spec(subject), (0, 0, subject.size * 0.15), subject.size)
        spec.option.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
        model = compiled(spec)
        return cls(subject, model, mujoco.MjData(model))

    def put(self, turn: Array, gap: float) -> None:
        """Put the thing at rest, rotated by (3, 3), with its lowest point a gap (m) over the slab."""
        mujoco.mj_resetData(self.model, self.data)
        low = float((self.subject.collision_points @ turn.T)[:, 2].min())
        at = self.model.joint(self.subject.item.name).qposadr[0]
        middle = turn @ np.array(self.subject.item.inertia.centre)
        self.data.qpos[at : at + 3] = (-middle[0], -middle[1], gap - low)
        self.data.qpos[at + 3 : at + 7] = quat_from_rotation(turn)
        mujoco.mj_forward(self.model, self.data)

    def run(self, seconds: float) -> tuple[float, float]:
        """Step for a time: the deepest contact (m) and the greatest energy (J). Raises `ArithmeticError`."""
        deep, energy = 0.0, -np.inf
        for _ in range(round(seconds / self.model.opt.timestep)):
            mujoco.mj_step(self.model, self.data)
            if self.data.ncon:
                deep = max(deep, -float(self.data.contact.dist.min()))
            energy = max(energy, float(self.data.energy.sum()))
        if (fault := breakdown(self.data)) is not None or not np.isfinite(self.data.qpos).all():
            raise ArithmeticError(fault or "a pose is no number")
        return deep, energy

    @property
    def T(self) -> Array:
        body = self.data.body(self.subject.item.name)
        return pose(body.xpos, body.xmat.reshape(3, 3))

    def settle(self) -> None:
        """Step until the thing rests, or for the most time. Raises `ArithmeticError`."""
        for _ in range(round(_SETTLE / _LOOK)):
            self.run(_LOOK)
            if np.abs(self.data.qvel[:3]).max() < _STILL and np.abs(self.data.qvel[3:6]).max() < 10 * _STILL:
                break

    def view(self, caption: str) -> View:
        return View(self.model, self.data.qpos.copy(), caption)


def rest(subject: Subject) -> Outcome:
    """Whether the thing rests still as it stands, and on each face on which it can rest."""
    if subject.item.base == "fixed":
        return unchecked(_FIXED)
    world = _World.of(subject)
    upright = Attitude(np.array([0.0, 0.0, -1.0]), 0.0, 1.0)
    others = attitudes(subject.collision_points, np.array(subject.item.inertia.centre))
    faces = [upright, *(face for face in others if face.down[2] > -0.999)]
    worst = {"tilt_deg": 0.0, "drift_mm": 0.0, "sinks_mm": 0.0}
    views, faults = list[View](), list[str]()
    for number, face in enumerate(faces):
        try:
            found = _lies(world, face, stands=number == 0)
        except ArithmeticError as error:
            return Outcome(False, {"faces": len(faces)}, f"physics broke down on face {number}: {error}", tuple(views))
        views.append(world.view("as it stands" if number == 0 else f"face {number}"))
        worst = {key: max(worst[key], value) for key, value in found.items()}
        if found["tilt_deg"] > np.degrees(_TILT) or found["drift_mm"] > _DRIFT * 1e3 or found["sinks_mm"] > _SINK * 1e3:
            shown = ", ".join(f"{key} {value:.3g}" for key, value in found.items())
            faults.append(f"face {number}: {shown}")
    figures = {"faces": len(faces)} | {key: short(value, 3) for key, value in worst.items()}
    return Outcome(not faults, figures, "; ".join(faults), tuple(views))


def _lies(world: _World, face: Attitude, *, stands: bool) -> dict[str, float]:
    """The tilt, drift and penetration of the thing on a face.

    Args:
        stands: whether the thing has to stay as it is put; else it settles first.
    """
    world.put(face.turn, 0.0)
    before = world.T
    if not stands:
        world.settle()
        before = world.T
    middle = np.array([*world.subject.item.inertia.centre, 1.0])
    deep, _ = world.run(_REST)
    after = world.T
    up = before[:3, :3].T @ [0, 0, 1.0]
    tilt = float(np.arccos(np.clip((after[:3, :3] @ up)[2], -1, 1)))
    drift = float(np.linalg.norm(((after - before) @ middle)[:2]))
    return {"tilt_deg": float(np.degrees(tilt)), "drift_mm": drift * 1000, "sinks_mm": deep * 1000}


def drop(subject: Subject) -> Outcome:
    """Whether the thing stays over the ground and gains no energy when it falls from 10 cm in random orientations."""
    if subject.item.base == "fixed":
        return unchecked(_FIXED)
    world = _World.of(subject)
    rng = np.random.default_rng(0)
    deepest, gained, speed = 0.0, 0.0, 0.0
    views = list[View]()
    for number in range(_DROPS):
        quat = rng.normal(size=4)
        turn = _rotation(quat / np.linalg.norm(quat))
        world.put(turn, _HEIGHT)
        start = float(world.data.energy.sum())
        fall = max(subject.item.inertia.mass * 9.81 * _HEIGHT, _LEAST_ENERGY)
        try:
            deep, energy = world.run(_FALL)
        except ArithmeticError as error:
            return Outcome(False, {"drops": _DROPS}, f"drop {number}: physics broke down: {error}", tuple(views))
        deepest, gained = max(deepest, deep), max(gained, (energy - start) / fall)
        speed = max(speed, float(np.abs(world.data.qvel[:3]).max()))
        if number < 3:
            views.append(world.view(f"drop {number}"))
        lowest = float((subject.collision_points @ world.T[:3, :3].T + world.T[:3, 3])[:, 2].min())
        if lowest < -_SINK and abs(world.T[:2, 3]).max() < 0.9:
            note = f"drop {number}: it ends {-lowest * 1000:.3g} mm under the ground"
            return Outcome(False, {"drops": _DROPS}, note, tuple(views))
    figures = {
        "drops": _DROPS,
        "sinks_mm": short(deepest * 1000, 3),
        "gains": short(max(gained, 0.0), 3),
        "last_speed_m_s": short(speed, 3),
    }
    if deepest > _THROUGH:
        return Outcome(False, figures, f"it sinks into the ground by {deepest * 1000:.3g} mm", tuple(views))
    if gained > _GAIN:
        return Outcome(False, figures, f"it gains {gained * 100:.3g} % of the energy of its fall", tuple(views))
    return Outcome(True, figures, views=tuple(views))


def _rotation(quat: Array) -> Array:
    angle = 2 * np.arccos(np.clip(quat[0], -1, 1))
    axis = quat[1:] / max(float(np.linalg.norm(quat[1:])), 1e-12)
    return rotation_from_vector(axis * angle)
