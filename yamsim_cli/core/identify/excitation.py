"""A motion by which a log tells all that can be identified of an arm."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from ..config.rig import RigConfig
from ..config.scene import SceneConfig
from ..errors import SimulationError
from ..geometry.se3 import Array
from ..resources import Locations
from .plant import ArmPlant
from .room import Box, Room

# How often a command is sent, 1/s.
RATE = 100
# Shares of what the motors can do that commands ask for at most.
_SPEED, _TORQUE = 0.5, 0.5
# Of the sines that are added up for each joint: how many, and from which to which frequency, Hz. The quicker a joint's
# motor (turns a second), the quicker they are.
_SINES, _SLOWEST, _FASTEST = 8, 0.1, (2.0, 5.0)
_PER_TURN = 2.0
# How much less a sine moves, the quicker it is: as its frequency to the power of this, of the slowest joints and of the
# quickest, whose inertia is small and shows only where they are.
_LESS = (0.8, 0.4)
# The motion is cycles of about so many seconds. Sines take this part of each, slow turns and rests what is left, so
# that every third of the motion has all of it.
_CYCLE, _QUICK_SHARE = 20.0, 0.6
# How fast slow turns are, rad/s, and how long an arm rests after each, s.
_SLOW, _REST = (0.05, 0.5), 0.4
# How long the arm takes to swing in and to come to rest, s.
_RAMP = 2.0
_TRIES = 20


@dataclass(frozen=True)
class Excitation:
    """What to tell an arm.

    Attributes:
        times: of the commands (n,), s.
        commands: of the joints (n, dof), rad. The arm has to be at the first when they begin, and ends there.
        box: in which they lie.
        speed, torque: the most that any joint needs of what its motor can do, of 1.
    """

    times: Array
    commands: Array
    box: Box
    speed: float
    torque: float


def excite(
    rig: RigConfig, number: int, scene: SceneConfig, locations: Locations, seconds: float, seed: int
) -> Excitation:
    """A motion of one arm of a rig that swings every joint, quickly and slowly, around one pose; the others rest.

    Raises:
        SimulationError: there is no room for it, or it would need more than the motors give.
    """
    rng = np.random.default_rng([seed, number])
    room, plant = Room(rig, number, scene, locations), ArmPlant(rig.arms[number])
    box = room.widest(rng)
    motors = np.array([joint.motor_rad_s for joint in rig.arms[number].robot.joints])
    times = np.arange(round(seconds * RATE) + 1) / RATE
    for _ in range(_TRIES):
        shares = [_share(times, float(half), float(motor), rng) for half, motor in zip(box.half, motors, strict=True)]
        commands = box.middle + box.half * np.column_stack(shares)
        speed = float((np.abs(np.gradient(commands, times, axis=0)) / motors).max())
        torque = float((np.abs(_torques(plant, times, commands)) / plant.most_torque).max())
        if speed <= _SPEED and torque <= _TORQUE and not any(room.touches(row) for row in commands[::5]):
            return Excitation(times, commands, box, speed, torque)
        box = Box(box.middle, box.half * 0.9)
    raise SimulationError(
        f"{room.name}: no motion of {seconds:g} s was found that keeps to what its motors can do; try another --seed"
    )


def _share(times: Array, half: float, motor: float, rng: np.random.Generator) -> Array:
    """Where a joint is in its box over time (n,), -1..1; 0 at both ends.

    Args:
        half: of the box, rad.
        motor: how fast the motor turns, rad/s.
    """
    fastest = float(np.clip(_PER_TURN * motor / (2 * np.pi), *_FASTEST))
    cycles = max(1, round(times[-1] / _CYCLE))
    length = times[-1] / cycles
    quick = length * _QUICK_SHARE
    number = np.clip((times // length).astype(int), 0, cycles - 1)
    found = np.empty(len(times))
    for cycle in range(cycles):
        here = number == cycle
        now = times[here] - cycle * length
        ramp = np.minimum(_smooth(now / _RAMP), _smooth((quick - now) / _RAMP))
        found[here] = np.where(now < quick, ramp * _sines(now, fastest, rng), _turns(quick, length, half, rng)(now))
    return found


def _sines(times: Array, fastest: float, rng: np.random.Generator) -> Array:
    """Sines of random frequencies and phases, added up (n,), -1..1."""
    edges = np.geomspace(_SLOWEST, fastest, _SINES + 1)
    frequencies = rng.uniform(edges[:-1], edges[1:])
    sizes = frequencies ** -np.interp(fastest, _FASTEST, _LESS)
    total = (sizes * np.sin(2 * np.pi * frequencies * times[:, None] + rng.uniform(0, 2 * np.pi, _SINES))).sum(axis=1)
    found: Array = total / np.abs(total).max()
    return found


def _turns(start: float, end: float, half: float, rng: np.random.Generator) -> Callable[[Array], Array]:
    """Slow turns to and fro with a rest after each, from 0 back to 0."""
    knots, places, now, side = [start], [0.0], start, float(rng.choice([-1, 1]))
    while True:
        place, speed = side * rng.uniform(0.3, 1.0), np.exp(rng.uniform(*np.log(_SLOW)))
        turn = abs(place - places[-1]) * half / speed
        back = abs(place) * half / _SLOW[1] * 2
        if now + turn + _REST + back + _RAMP > end:
            break
        knots += [now + turn, now + turn + _REST]
        places += [place, place]
        now, side = knots[-1], -side
    rest = max(abs(places[-1]) * half / _SLOW[1] * 2, 1e-3)
    knots += [now + rest, end + 1]
    places += [0.0, 0.0]

    def at(times: Array) -> Array:
        k = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(knots) - 2)
        begins, ends = np.array(knots)[k], np.array(knots)[k + 1]
        share = (times - begins) / (ends - begins)
        found: Array = np.array(places)[k] + (np.array(places)[k + 1] - np.array(places)[k]) * _smooth(share)
        return found

    return at


def _smooth(share: Array) -> Array:
    inside = np.clip(share, 0, 1)
    found: Array = inside**3 * (10 - 15 * inside + 6 * inside**2)
    return found


def _torques(plant: ArmPlant, times: Array, joints: Array) -> Array:
    """What the drives would have to give (n, dof), N m."""
    data, found = mujoco.MjData(plant.model), np.empty(joints.shape)
    speeds = np.gradient(joints, times, axis=0)
    accelerations = np.gradient(speeds, times, axis=0)
    for k, row in enumerate(joints):
        data.qpos[plant.qpos], data.qvel[plant.dof], data.qacc[plant.dof] = row, speeds[k], accelerations[k]
        mujoco.mj_inverse(plant.model, data)
        found[k] = data.qfrc_inverse[plant.dof]
    return found
