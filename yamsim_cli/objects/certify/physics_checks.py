"""Check an object in physics: rest, drops, a ball in a hollow, joint motion."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from yamsim_cli.core.config.objects.articulation import Link
from yamsim_cli.core.geometry.height_map import compute_height_map, water_level
from yamsim_cli.core.geometry.se3 import Array, pose, quat_from_rotation, rotation_from_vector
from yamsim_cli.core.geometry.stable_poses import StablePose, stable_poses
from yamsim_cli.core.scene.compilation import physics_failure

from .check_outcome import CheckOutcome, CheckView, round_significant, skipped_outcome
from .static_checks import NO_MESHES_NOTE
from .tested_object import (
    TestedObject,
    add_view_camera,
    compile_or_raise,
    object_on_ground_spec,
    object_spec,
    step_seconds,
)

# Checks of rest and of drops.
_MAX_SETTLE_TIME, _SETTLE_INTERVAL = 6.0, 0.2  # s, longest time to come to rest, and interval between tests
_STILL_TIME, _DROP_TIME = 2.0, 1.5  # s, time for which the object must then stay at rest; duration of a drop
_MAX_TILT, _MAX_DRIFT, _MAX_SINK = np.radians(3.0), 0.003, 0.0015  # rad, m, m: tilt, drift, penetration allowed at rest
_DROP_HEIGHT, _DROP_COUNT = 0.10, 8  # m, height from which the object falls; number of falls
_MAX_PENETRATION = 0.05  # m, limit at impact: half the slab's thickness; deeper objects come out on its underside
_MAX_ENERGY_GAIN, _MIN_FALL_ENERGY = 0.02, 1e-4  # limit, as a share of the fall's energy; J, least value of that energy
_REST_SPEED = 0.0002  # m/s; slower objects are at rest, if they also turn at less than ten times this number in rad/s
_FIXED_BASE_NOTE = "its base is fixed, so it has no other pose"

_HEIGHT_MAP_CELLS = 56  # columns of the height map along the longer side
_MIN_DEPTH, _MIN_ROOM = 0.010, 0.0045  # m, of a hollow: depth, and distance to its walls
_MIN_HOLLOW_SHARE = 0.02  # volume over the bounding box's; smaller hollows are dents
_BALL_SOLREF = (0.004, 1.0)  # MuJoCo's; stiff, so that the ball does not sink through a thin floor
_MAX_BALL_RADIUS = 0.015  # m; smaller in a narrow hollow
_BALL_CLEARANCE = 0.03  # m, height over the object's top at the start
_BALL_TIME = 2.0  # s
_MAX_BALL_HEIGHT = 0.5  # gap between resting ball and floor, as a share of the hollow's depth
_BALL_DENSITY = 1000.0  # kg/m3

_PUSH_TIME, _REST_TIME = 4.0, 3.0  # s, of a push to a limit, and to come to rest
_RANGE_END_TOLERANCE = 0.03  # share of the range that a push may miss
_JOINT_REST_SPEED = 0.02  # joint ranges per s
_PUSH_EFFORT_FACTOR = 3.0  # effort of a push over the sum of friction, detent and weight
_MIN_EFFORT = {True: 0.02, False: 1.0}  # N m on a rotary joint (True), N on a slide
_PUSH_FREQUENCY = 6.0  # Hz, of the controller that pushes a joint


@dataclass
class _TestScene:
    subject: TestedObject
    model: mujoco.MjModel
    data: mujoco.MjData

    @classmethod
    def for_object(cls, tested_object: TestedObject) -> _TestScene:
        spec = add_view_camera(
            object_on_ground_spec(tested_object),
            (0, 0, tested_object.bounding_diagonal * 0.15),
            tested_object.bounding_diagonal,
        )
        spec.option.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
        model = compile_or_raise(spec)
        return cls(tested_object, model, mujoco.MjData(model))

    def place_object(self, turn: Array, gap: float) -> None:
        """Put the object at rest, rotated (3, 3), its lowest point `gap` (m) over the slab."""
        mujoco.mj_resetData(self.model, self.data)
        low = float((self.subject.collision_points @ turn.T)[:, 2].min())
        at = self.model.joint(self.subject.item.name).qposadr[0]
        middle = turn @ np.array(self.subject.item.inertia.centre)
        self.data.qpos[at : at + 3] = (-middle[0], -middle[1], gap - low)
        self.data.qpos[at + 3 : at + 7] = quat_from_rotation(turn)
        mujoco.mj_forward(self.model, self.data)

    def run_and_measure(self, seconds: float) -> tuple[float, float]:
        """Return deepest contact (m) and greatest energy (J); `ArithmeticError` if unstable."""
        deep, energy = 0.0, -np.inf
        for _ in range(round(seconds / self.model.opt.timestep)):
            mujoco.mj_step(self.model, self.data)
            if self.data.ncon:
                deep = max(deep, -float(self.data.contact.dist.min()))
            energy = max(energy, float(self.data.energy.sum()))
        if (fault := physics_failure(self.data)) is not None or not np.isfinite(self.data.qpos).all():
            raise ArithmeticError(fault or "a pose is not finite")
        return deep, energy

    @property
    def T_object_in_world(self) -> Array:
        body = self.data.body(self.subject.item.name)
        return pose(body.xpos, body.xmat.reshape(3, 3))

    def settle_object(self) -> None:
        for _ in range(round(_MAX_SETTLE_TIME / _SETTLE_INTERVAL)):
            self.run_and_measure(_SETTLE_INTERVAL)
            if np.abs(self.data.qvel[:3]).max() < _REST_SPEED and np.abs(self.data.qvel[3:6]).max() < 10 * _REST_SPEED:
                break

    def current_view(self, caption: str) -> CheckView:
        return CheckView(self.model, self.data.qpos.copy(), caption)


def check_rest(tested_object: TestedObject) -> CheckOutcome:
    """Check rest in the initial pose and on each stable face."""
    if tested_object.item.base == "fixed":
        return skipped_outcome(_FIXED_BASE_NOTE)
    world = _TestScene.for_object(tested_object)
    upright = StablePose(np.array([0.0, 0.0, -1.0]), 0.0, 1.0)
    others = stable_poses(tested_object.collision_points, np.array(tested_object.item.inertia.centre))
    faces = [upright, *(face for face in others if face.down[2] > -0.999)]
    worst = {"tilt_deg": 0.0, "drift_mm": 0.0, "sinks_mm": 0.0}
    views, faults = list[CheckView](), list[str]()
    for number, face in enumerate(faces):
        try:
            found = _measure_rest(world, face, must_stay=number == 0)
        except ArithmeticError as error:
            return CheckOutcome(
                False, {"faces": len(faces)}, f"physics broke down on face {number}: {error}", tuple(views)
            )
        views.append(world.current_view("as it stands" if number == 0 else f"face {number}"))
        worst = {key: max(worst[key], value) for key, value in found.items()}
        if (
            found["tilt_deg"] > np.degrees(_MAX_TILT)
            or found["drift_mm"] > _MAX_DRIFT * 1e3
            or found["sinks_mm"] > _MAX_SINK * 1e3
        ):
            shown = ", ".join(f"{key} {value:.3g}" for key, value in found.items())
            faults.append(f"face {number}: {shown}")
    figures = {"faces": len(faces)} | {key: round_significant(value, 3) for key, value in worst.items()}
    return CheckOutcome(not faults, figures, "; ".join(faults), tuple(views))


def _measure_rest(world: _TestScene, face: StablePose, *, must_stay: bool) -> dict[str, float]:
    """Put the object on a face; return tilt, deg, drift and penetration, mm.

    Unless it `must_stay` from the first step, the object comes to rest first.
    """
    world.place_object(face.rotation, 0.0)
    before = world.T_object_in_world
    if not must_stay:
        world.settle_object()
        before = world.T_object_in_world
    middle = np.array([*world.subject.item.inertia.centre, 1.0])
    deep, _ = world.run_and_measure(_STILL_TIME)
    after = world.T_object_in_world
    up = before[:3, :3].T @ [0, 0, 1.0]
    tilt = float(np.arccos(np.clip((after[:3, :3] @ up)[2], -1, 1)))
    drift = float(np.linalg.norm(((after - before) @ middle)[:2]))
    return {"tilt_deg": float(np.degrees(tilt)), "drift_mm": drift * 1000, "sinks_mm": deep * 1000}


def check_drop(tested_object: TestedObject) -> CheckOutcome:
    """Check that 10 cm falls in random orientations end over the ground, without energy gain."""
    if tested_object.item.base == "fixed":
        return skipped_outcome(_FIXED_BASE_NOTE)
    world = _TestScene.for_object(tested_object)
    rng = np.random.default_rng(0)
    deepest, gained, speed = 0.0, 0.0, 0.0
    views = list[CheckView]()
    for number in range(_DROP_COUNT):
        quat = rng.normal(size=4)
        turn = _rotation_from_quat(quat / np.linalg.norm(quat))
        world.place_object(turn, _DROP_HEIGHT)
        start = float(world.data.energy.sum())
        fall = max(tested_object.item.inertia.mass * 9.81 * _DROP_HEIGHT, _MIN_FALL_ENERGY)
        try:
            deep, energy = world.run_and_measure(_DROP_TIME)
        except ArithmeticError as error:
            return CheckOutcome(
                False, {"drops": _DROP_COUNT}, f"drop {number}: physics broke down: {error}", tuple(views)
            )
        deepest, gained = max(deepest, deep), max(gained, (energy - start) / fall)
        speed = max(speed, float(np.abs(world.data.qvel[:3]).max()))
        if number < 3:
            views.append(world.current_view(f"drop {number}"))
        lowest = float(
            (tested_object.collision_points @ world.T_object_in_world[:3, :3].T + world.T_object_in_world[:3, 3])[
                :, 2
            ].min()
        )
        if lowest < -_MAX_SINK and abs(world.T_object_in_world[:2, 3]).max() < 0.9:
            note = f"drop {number}: it ends {-lowest * 1000:.3g} mm below the ground"
            return CheckOutcome(False, {"drops": _DROP_COUNT}, note, tuple(views))
    figures = {
        "drops": _DROP_COUNT,
        "sinks_mm": round_significant(deepest * 1000, 3),
        "gains": round_significant(max(gained, 0.0), 3),
        "last_speed_m_s": round_significant(speed, 3),
    }
    if deepest > _MAX_PENETRATION:
        return CheckOutcome(False, figures, f"it sinks into the ground by {deepest * 1000:.3g} mm", tuple(views))
    if gained > _MAX_ENERGY_GAIN:
        return CheckOutcome(False, figures, f"it gains {gained * 100:.3g} % of the energy of its fall", tuple(views))
    return CheckOutcome(True, figures, views=tuple(views))


def _rotation_from_quat(quat: Array) -> Array:
    angle = 2 * np.arccos(np.clip(quat[0], -1, 1))
    axis = quat[1:] / max(float(np.linalg.norm(quat[1:])), 1e-12)
    return rotation_from_vector(axis * angle)


@dataclass(frozen=True)
class Hollow:
    """The deepest hollow in which water would stay, in the object's frame.

    Attributes:
        place: (2,) where a ball is dropped, m.
        floor_height, water_height: of the surface at `place`, and of the water, m.
        wall_distance: from `place`, m.
        water_columns: positions and floor heights (n, 3) under water, m.
    """

    place: Array
    floor_height: float
    water_height: float
    wall_distance: float
    water_columns: Array


def find_deepest_hollow(tested_object: TestedObject) -> Hollow | None:
    """Return the deepest hollow in the initial pose; None if too shallow, small or narrow."""
    grid = compute_height_map(tested_object.merged_visual_surface, _HEIGHT_MAP_CELLS)
    level = water_level(grid.top)
    covered = np.isfinite(grid.top)
    depth = np.where(covered, level - np.where(covered, grid.top, 0.0), 0.0)
    if depth.max(initial=0.0) < _MIN_DEPTH:
        return None
    block = float(np.prod(np.ptp(tested_object.merged_visual_surface[0], axis=0)))
    if depth.sum() * grid.cell_size**2 < _MIN_HOLLOW_SHARE * block:
        return None
    i, j = np.unravel_index(int(depth.argmax()), depth.shape)
    water = level[i, j]
    deep = (depth > 0.6 * depth.max()) & (np.abs(level - water) < 1e-6)
    x, y = np.meshgrid(grid.x, grid.y, indexing="ij")
    dry = np.column_stack([x[~deep], y[~deep]])
    wet = np.column_stack([x[deep], y[deep]])
    room = np.sqrt(((wet[:, None] - dry[None]) ** 2).sum(axis=2).min(axis=1)) - grid.cell_size / 2
    best = int(room.argmax())
    if room[best] < _MIN_ROOM:
        return None
    pond = (depth > 1e-4) & (np.abs(level - water) < 1e-6)
    floors = np.column_stack([x[pond], y[pond], grid.top[pond]])
    return Hollow(wet[best], float(grid.top[deep][best]), float(water), float(room[best]), floors)


def check_hollow(tested_object: TestedObject) -> CheckOutcome:
    """Check that a ball dropped into the hollow rests inside."""
    if not tested_object.visual_surfaces:
        return skipped_outcome(NO_MESHES_NOTE)
    found = find_deepest_hollow(tested_object)
    if found is None:
        return skipped_outcome("it has no interior that can hold a ball")
    radius = min(0.7 * found.wall_distance, _MAX_BALL_RADIUS)
    spec = add_view_camera(
        object_on_ground_spec(tested_object),
        (0, 0, tested_object.bounding_diagonal * 0.2),
        tested_object.bounding_diagonal,
        steep=1.2,
    )
    high = max(found.water_height, float(tested_object.collision_points[:, 2].max())) + _BALL_CLEARANCE
    body = spec.worldbody.add_body(name="certificate_ball", pos=[*found.place, high + tested_object.item.rest_height])
    body.add_freejoint(name="certificate_ball")
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], density=_BALL_DENSITY, rgba=[0.9, 0.2, 0.1, 1],
        friction=[0.8, 0.005, 0.0005], condim=4, solref=_BALL_SOLREF, priority=1,
    )  # fmt: skip
    model = compile_or_raise(spec)
    data = mujoco.MjData(model)
    at = model.joint(tested_object.item.name).qposadr[0]
    data.qpos[at + 2] = tested_object.item.rest_height
    step_seconds(model, data, _BALL_TIME)
    views = (CheckView(model, data.qpos.copy(), "a ball dropped in"),)
    figures = {
        "depth_mm": round_significant((found.water_height - found.floor_height) * 1000, 3),
        "ball_mm": round_significant(2000 * radius, 3),
    }
    if (fault := physics_failure(data)) is not None:
        return CheckOutcome(False, figures, f"physics broke down: {fault}", views)
    thing = data.body(tested_object.item.name)
    inside = thing.xmat.reshape(3, 3).T @ (data.body("certificate_ball").xpos - thing.xpos)
    nearest = found.water_columns[np.linalg.norm(found.water_columns[:, :2] - inside[:2], axis=1).argmin()]
    offset = float(np.linalg.norm(nearest[:2] - inside[:2]))
    # On a sloping floor, the ball rests beside the lowest point.
    over = float(inside[2] - radius - max(nearest[2], found.floor_height))
    limit = _MAX_BALL_HEIGHT * (found.water_height - found.floor_height)
    figures |= {"over_floor_mm": round_significant(over * 1000, 3), "aside_mm": round_significant(offset * 1000, 3)}
    if offset > 2 * radius + 0.002:
        return CheckOutcome(False, figures, "the ball lies beside the interior", views)
    if over > limit:
        note = f"the ball stays {over * 1000:.3g} mm above its floor: collision parts fill the visible interior"
        return CheckOutcome(False, figures, note, views)
    if over < -0.25 * radius - 0.004:
        return CheckOutcome(False, figures, f"the ball went through its floor by {-over * 1000:.3g} mm", views)
    return CheckOutcome(True, figures, views=views)


def check_articulation(tested_object: TestedObject) -> CheckOutcome:
    """Check that joints move from limit to limit, and come to rest."""
    links = tested_object.item.links
    if not links:
        return skipped_outcome("it has no joint")
    spec = object_spec(tested_object.item, tested_object.meshes, fixed=True)
    model = compile_or_raise(
        add_view_camera(spec, (0, 0, tested_object.bounding_diagonal * 0.2), tested_object.bounding_diagonal)
    )
    data = mujoco.MjData(model)
    reached: dict[str, float] = {}
    views, faults, fastest = list[CheckView](), list[str](), 0.0
    for link in links:
        name = f"{tested_object.item.name}_{link.name}"
        for end in (1, 0):
            missing = _unreached_range_share(model, data, link, name, end)
            which = "upper" if end else "lower"
            reached[f"{link.name}_{which}_missing"] = round_significant(missing, 3)
            if end:
                views.append(CheckView(model, data.qpos.copy(), f"{link.name} at its upper limit"))
            if missing > _RANGE_END_TOLERANCE:
                faults.append(f"{link.name} stops {missing * 100:.3g} % of its range before its {which} limit")
        data.qfrc_applied[:] = 0
        step_seconds(model, data, _REST_TIME)
        speed = abs(float(data.joint(name).qvel[0])) / float(np.ptp(model.joint(name).range))
        fastest = max(fastest, speed)
        if speed > _JOINT_REST_SPEED:
            faults.append(f"{link.name} does not come to rest: {speed:.3g} of its range per second")
    figures = {"joints": len(links), "last_speed_1_s": round_significant(fastest, 3), **reached}
    return CheckOutcome(not faults, figures, "; ".join(faults), tuple(views))


def _unreached_range_share(model: mujoco.MjModel, data: mujoco.MjData, link: Link, name: str, end: int) -> float:
    """Push a joint to its lower (`end` 0) or upper limit (1); return the missed share of its range."""
    mujoco.mj_resetData(model, data)
    mujoco.mj_forward(model, data)
    joint = model.joint(name)
    address, dof = joint.qposadr[0], joint.dofadr[0]
    goal, travel = float(joint.range[end]), float(np.ptp(joint.range))
    effort = _push_effort(model, data, link, name)
    inertia = 1.0 / max(float(model.dof_invweight0[dof]), 1e-6)
    stiff = max(inertia * (2 * np.pi * _PUSH_FREQUENCY) ** 2, effort / (0.02 * travel))
    damp = 2 * np.sqrt(stiff * inertia)
    for _ in range(round(_PUSH_TIME / model.opt.timestep)):
        wanted = stiff * (goal - data.qpos[address]) - damp * data.qvel[dof]
        data.qfrc_applied[dof] = np.clip(wanted, -effort, effort)
        mujoco.mj_step(model, data)
    return abs(goal - float(data.qpos[address])) / travel


def _push_effort(model: mujoco.MjModel, data: mujoco.MjData, link: Link, name: str) -> float:
    """Return the effort, N or N m."""
    joint = link.joint
    body = model.body(name).id
    weight = float(model.body_subtreemass[body]) * 9.81
    if joint.is_revolute:
        reach = float(np.linalg.norm(model.geom_pos[model.geom_bodyid == body], axis=1).max(initial=0.02)) + 0.02
        weight *= reach
    detent_effort = max((detent.effort for detent in joint.detents), default=0.0)
    return max(_PUSH_EFFORT_FACTOR * (joint.friction + detent_effort + weight), _MIN_EFFORT[joint.is_revolute])
