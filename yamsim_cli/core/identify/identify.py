"""Identify an arm from its logs: what `yamsim identify` does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..config.rig import RigConfig
from ..errors import DatasetError, counted
from ..motion import ArmMotion, Motion
from ..recordings.faults import Fault, find_faults
from ..robots.dynamics import Dynamics, JointDynamics
from .estimates import Estimate, cannot_tell, check_told, estimates, rms
from .fit import compared, fit, parameters
from .plant import ArmPlant, Log, Run, Values
from .usable import check_usable

# What of each log is held out where no other one is given.
_HELD_OUT = 1 / 3
# How often the arm is simulated, about, for each parameter that is varied.
_ABOUT = 5
# Faults by which a log is about another motion than the arm made. A joint that stands still is told with what to record
# instead.
_GRAVE = (Fault.TIME_UNIT, Fault.GAP, Fault.DEGREES, Fault.BEYOND_STOPS, Fault.TOO_FAST, Fault.SWAPPED_ARMS)


@dataclass(frozen=True)
class Gap:
    """How far simulated joints are from measured ones where nothing was fitted.

    Attributes:
        source: which motion was held out.
        seconds: how long it is.
        before, after: root mean square with the model, and with what was identified, rad.
        joints: joint -> the same two.
    """

    source: str
    seconds: float
    before: float
    after: float
    joints: dict[str, tuple[float, float]]

    @property
    def fallen(self) -> float:
        """By what share the gap fell; below 0 where it grew."""
        return 1 - self.after / self.before if self.before else 0.0

    def plain(self) -> dict[str, Any]:
        """As JSON has it."""
        joints = {name: {"before_rad": one, "after_rad": other} for name, (one, other) in self.joints.items()}
        return {
            "source": self.source,
            "seconds": self.seconds,
            "before_rad": self.before,
            "after_rad": self.after,
            "fallen": self.fallen,
            "joints": joints,
        }


@dataclass(frozen=True)
class Identified:
    """One arm as its logs say it moves.

    Attributes:
        arm: its name in the rig.
        side: `left` or `right` of two arms, empty of a lone one.
        dynamics: the revision of its model.
        estimates: with intervals.
        cannot_tell: what the logs do not say, a sentence each.
        fitted_rms: of the errors that the fit left, rad.
        gap: on what was held out.
    """

    arm: str
    side: str
    dynamics: Dynamics
    estimates: list[Estimate]
    cannot_tell: list[str]
    fitted_rms: float
    gap: Gap


def identify(
    rig: RigConfig,
    motions: Sequence[Motion],
    held_out: Sequence[Motion],
    revision: str,
    side: str | None = None,
    step: Callable[[str, int, int], None] = lambda arm, done, total: None,
) -> list[Identified]:
    """What motions say of each arm of a rig, or of the one on a side; the left one's first.

    Args:
        held_out: motions by which it is judged; without any, the last third of each is kept for that.
        revision: what the result is called.
        step: told which arm is fitted, how often it has been simulated, and about how often it will be.

    Raises:
        DatasetError: a motion has no commands or faults that make it another motion, or does not excite a joint.
    """
    for motion in (*motions, *held_out):
        _check(motion, rig)
    found = []
    for place, number in enumerate(rig.recorded):
        arm = rig.arms[number]
        if side is not None and arm.side != side:
            continue
        called = arm.side if len(rig.arms) > 1 else ""
        plant = ArmPlant(arm)
        logs = [Log.of(motion, motion.arms[place]) for motion in motions]
        check_usable(logs, plant.robot.joint_names, called)
        others = [Log.of(motion, motion.arms[place]) for motion in held_out]
        if not others:
            cut = 1 - _HELD_OUT
            others = [log.between(cut * log.seconds, log.seconds) for log in logs]
            logs = [log.between(0.0, cut * log.seconds) for log in logs]
            check_usable(logs, plant.robot.joint_names, called)
        counter = _Counter(called or arm.name, _ABOUT * len(parameters(plant)), step)
        fitted = fit(arm, logs, counter)
        told = estimates(plant, fitted)
        check_told(plant, told, ", ".join(log.name for log in logs))
        source = f"{counted(len(motions), 'recording')}: {', '.join(motion.name for motion in motions)}"
        was = arm.dynamics or Dynamics(revision=revision, base=arm.model.name)
        dynamics = revised(plant, was.model_copy(update={"revision": revision, "source": source}), told)
        gap = _gap(plant, fitted.values, others)
        gripper = not plant.fingers or all(log.openings is not None for log in logs)
        unsaid = cannot_tell(told, gripper)
        found.append(Identified(arm.name, called, dynamics, told, unsaid, rms(fitted.errors), gap))
    return found


@dataclass
class _Counter:
    arm: str
    total: int
    step: Callable[[str, int, int], None]
    done: int = 0

    def __call__(self) -> None:
        self.done += 1
        self.step(self.arm, self.done, max(self.total, self.done))


def _check(motion: Motion, rig: RigConfig) -> None:
    if len(motion.arms) != len(rig.arms):
        raise DatasetError(f"{motion.name} has {counted(len(motion.arms), 'arm')}, and the rig {len(rig.arms)}")
    for arm in motion.arms:
        if arm.commands is None or not np.isfinite(arm.commands).any(axis=0).all():
            raise DatasetError(
                f"{_whose(motion, arm)}: holds no commands for its joints; what an arm does says little of it without "
                "what it was told: record both"
            )
    grave = [problem for problem in find_faults(motion, rig) if problem.fault in _GRAVE]
    if grave:
        raise DatasetError(f"{motion.name}: {grave[0].text}")


def _whose(motion: Motion, arm: ArmMotion) -> str:
    return f"{motion.name}{f', {arm.side} arm' if arm.side else ''}"


def _gap(plant: ArmPlant, values: Values, logs: Sequence[Log]) -> Gap:
    runs = [Run(plant, log) for log in logs]
    before, after = (
        np.concatenate([(run.follow(one, plain=True) - run.log.joints)[compared(run)] for run in runs])
        for one in (plant.values, values)
    )
    names = plant.robot.joint_names
    joints = {name: (rms(before[:, k]), rms(after[:, k])) for k, name in enumerate(names)}
    seconds = sum(log.seconds for log in logs)
    return Gap(", ".join(log.name for log in logs), seconds, rms(before), rms(after), joints)


def revised(plant: ArmPlant, was: Dynamics, told: Sequence[Estimate]) -> Dynamics:
    """The revision that estimates make of what an arm `was`; what the logs do not tell stays so."""
    known = {(each.joint, each.name): each.value if each.told else each.before for each in told}
    joints = {}
    for k, name in enumerate(plant.robot.joint_names):
        damping = known[name, "damping_nms"]
        joints[name] = JointDynamics(
            armature=_round(known[name, "armature"]),
            damping=_round(max(damping, 0.0)),
            frictionloss=_round(known[name, "friction_nm"]),
            kp=was.joint(name).kp,
            kv=_round(float(plant.kv[k]) + damping) if damping < 0 else was.joint(name).kv,
            offset_rad=_round(known[name, "offset_rad"]),
            gravity_factor=_round(known[name, "gravity_factor"]),
        )
    # The log has only the sum of the delays.
    delays = {"command_delay_ms": _round(1000 * known["", "delay_s"]), "sensor_delay_ms": 0.0}
    return was.model_copy(update={"joints": joints, **delays})


def _round(number: float) -> float:
    return float(f"{number:.6g}")
