"""Identify arms' parameters from logs, and refuse logs that do not determine them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.errors import DatasetError, count_noun
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.recorded_motion import RecordedMotion
from yamsim_cli.core.robots.dynamics import JointDynamics, MeasuredArmDynamics

from ..recordings.motion_faults import MotionFault, find_faults
from .estimates import Estimate, describe_undetermined, estimate_parameters, require_determined
from .parameter_fit import all_parameters, fit_parameters, samples_in_fit
from .plant_model import ArmLog, LogSimulation, ParametricArm, PlantParameters

_HELD_OUT_SHARE = 1 / 3  # share of each log that tests the fit if no other motions do
_RUNS_PER_PARAMETER = 5  # approximate, for the progress bar
# Faults of unusable logs. `check_logs_usable` reports joints that stand still, with advice.
_FAULTS_REFUSING_LOGS = (
    MotionFault.TIME_UNIT,
    MotionFault.GAP,
    MotionFault.DEGREES,
    MotionFault.BEYOND_STOPS,
    MotionFault.TOO_FAST,
    MotionFault.SWAPPED_ARMS,
)

# Least motion of each joint that determines the joint's parameters.
_MIN_SECONDS = 10.0  # s, total length of the logs
_MIN_SPAN = 0.1  # rad, range of the joint's motion
_MIN_REVERSALS = 4  # reversals of the joint's motion
_MIN_SPEED = 0.15  # rad/s that a joint must reach in the share _MIN_FAST_TIME_SHARE of the logs
_MIN_FAST_TIME_SHARE = 0.05  # share of the logs' time
_REVERSAL_DISTANCE = 0.02  # rad that a joint moves back before a reversal counts
_SPEED_PERIOD = 0.1  # s, interval over which a speed is computed
_REMEDY = "`yamsim excite` writes a motion that determines all parameters"


@dataclass(frozen=True)
class HeldOutError:
    """RMS error, rad, on motions that the fit did not use.

    Attributes:
        source: names of the motions.
        rms_before, rms_after: with the original model and the identified parameters.
        joints: name -> (rms_before, rms_after).
    """

    source: str
    seconds: float
    rms_before: float
    rms_after: float
    joints: dict[str, tuple[float, float]]

    @property
    def relative_reduction(self) -> float:
        """Relative reduction of the error, 0..1; negative if it grew."""
        return 1 - self.rms_after / self.rms_before if self.rms_before else 0.0

    def to_json_data(self) -> dict[str, Any]:
        """Return JSON data."""
        joints = {name: {"before_rad": one, "after_rad": other} for name, (one, other) in self.joints.items()}
        return {
            "source": self.source,
            "seconds": self.seconds,
            "before_rad": self.rms_before,
            "after_rad": self.rms_after,
            "reduction": self.relative_reduction,
            "joints": joints,
        }


@dataclass(frozen=True)
class IdentificationResult:
    """The identification of one arm.

    Attributes:
        side: `left` or `right`; empty for a single arm.
        dynamics: a named revision of the arm's model that rigs can use.
        undetermined: one sentence per quantity.
        fitted_rms: remaining error of the fit, rad.
        gap: error on motions that the fit did not use.
    """

    arm: str
    side: str
    dynamics: MeasuredArmDynamics
    estimates: list[Estimate]
    undetermined: list[str]
    fitted_rms: float
    held_out_error: HeldOutError


def identify_arms(
    rig: RigConfig,
    motions: Sequence[RecordedMotion],
    held_out: Sequence[RecordedMotion],
    revision: str,
    side: str | None = None,
    step: Callable[[str, int, int], None] = lambda arm, done, total: None,
) -> list[IdentificationResult]:
    """Identify all arms, or the arm on one side, the left arm first.

    Args:
        held_out: motions that test the fit; if empty, the last third of each motion does.
        revision: name of this revision of the arm's model.
        side: `left`, `right`, or None.
        step: called with the arm's name, finished simulations, and their approximate total.

    Raises:
        DatasetError: a motion has no commands, has grave faults, or does not excite a joint.
    """
    for motion in (*motions, *held_out):
        _check_motion(motion, rig)
    source = f"{count_noun(len(motions), 'recording')}: {', '.join(motion.name for motion in motions)}"
    found = []
    for place, number in enumerate(rig.recording_order):
        arm = rig.arms[number]
        if side is not None and arm.side != side:
            continue
        called = arm.side if len(rig.arms) > 1 else ""
        plant = ParametricArm(arm)
        logs = [ArmLog.from_motion(motion, motion.arms[place]) for motion in motions]
        check_logs_usable(logs, plant.robot.joint_names, called)
        others = [ArmLog.from_motion(motion, motion.arms[place]) for motion in held_out]
        if not others:
            cut = 1 - _HELD_OUT_SHARE
            others = [log.slice_time(cut * log.duration, log.duration) for log in logs]
            logs = [log.slice_time(0.0, cut * log.duration) for log in logs]
            check_logs_usable(logs, plant.robot.joint_names, called)
        fitted = fit_parameters(
            arm, logs, _step_counter(called or arm.name, _RUNS_PER_PARAMETER * len(all_parameters(plant)), step)
        )
        estimated = estimate_parameters(plant, fitted)
        require_determined(plant, estimated, ", ".join(log.name for log in logs))
        was = arm.dynamics or MeasuredArmDynamics(revision=revision, base=arm.model.name)
        dynamics = dynamics_with_estimates(
            plant, was.model_copy(update={"revision": revision, "source": source}), estimated
        )
        gap = _held_out_gap(plant, fitted.values, others)
        gripper = not plant.fingers or all(log.openings is not None for log in logs)
        unknown = describe_undetermined(estimated, gripper)
        found.append(IdentificationResult(arm.name, called, dynamics, estimated, unknown, _rms(fitted.errors), gap))
    return found


def _step_counter(arm: str, total: int, step: Callable[[str, int, int], None]) -> Callable[[], None]:
    done = 0

    def report_step() -> None:
        nonlocal done
        done += 1
        step(arm, done, max(total, done))

    return report_step


def _check_motion(motion: RecordedMotion, rig: RigConfig) -> None:
    if len(motion.arms) != len(rig.arms):
        raise DatasetError(f"{motion.name} has {count_noun(len(motion.arms), 'arm')}, and the rig has {len(rig.arms)}")
    for arm in motion.arms:
        if arm.commands is None or not np.isfinite(arm.commands).any(axis=0).all():
            raise DatasetError(
                f"{motion.name}{f', {arm.side} arm' if arm.side else ''}: has no commands for its joints; "
                "measurements alone do not determine the parameters: record both"
            )
    grave = [problem for problem in find_faults(motion, rig) if problem.fault in _FAULTS_REFUSING_LOGS]
    if grave:
        raise DatasetError(f"{motion.name}: {grave[0].text}")


def _held_out_gap(plant: ParametricArm, values: PlantParameters, logs: Sequence[ArmLog]) -> HeldOutError:
    runs = [LogSimulation(plant, log) for log in logs]
    before, after = (
        np.concatenate([(run.simulate(one, plain=True) - run.log.joints)[samples_in_fit(run)] for run in runs])
        for one in (plant.model_values, values)
    )
    names = plant.robot.joint_names
    joints = {name: (_rms(before[:, k]), _rms(after[:, k])) for k, name in enumerate(names)}
    seconds = sum(log.duration for log in logs)
    return HeldOutError(", ".join(log.name for log in logs), seconds, _rms(before), _rms(after), joints)


def dynamics_with_estimates(
    plant: ParametricArm, was: MeasuredArmDynamics, found: Sequence[Estimate]
) -> MeasuredArmDynamics:
    """Return `was` with the determined estimates."""
    known = {(each.joint, each.name): each.value if each.is_determined else each.model_value for each in found}
    joints = {}
    for k, name in enumerate(plant.robot.joint_names):
        damping = known[name, "damping_nms"]
        joints[name] = JointDynamics(
            armature=_round_significant(known[name, "armature"]),
            damping=_round_significant(max(damping, 0.0)),
            frictionloss=_round_significant(known[name, "friction_nm"]),
            kp=was.joint(name).kp,
            kv=_round_significant(float(plant.kv[k]) + damping) if damping < 0 else was.joint(name).kv,
            offset_rad=_round_significant(known[name, "offset_rad"]),
            gravity_factor=_round_significant(known[name, "gravity_factor"]),
        )
    # The logs determine only the sum of both delays.
    delays = {"command_delay_ms": _round_significant(1000 * known["", "delay_s"]), "sensor_delay_ms": 0.0}
    return was.model_copy(update={"joints": joints, **delays})


def _round_significant(number: float) -> float:
    return float(f"{number:.6g}")


def _rms(errors: Array) -> float:
    return float(np.sqrt(np.mean(np.square(errors))))


def check_logs_usable(logs: Sequence[ArmLog], names: Sequence[str], side: str = "") -> None:
    """Refuse logs in which a joint's motion does not determine its parameters.

    Raises:
        DatasetError: the logs are too short, or a joint moves too little, reverses too rarely, or is always slow.
    """
    where = ", ".join(log.name for log in logs)
    seconds = sum(log.duration for log in logs)
    if seconds < _MIN_SECONDS:
        raise DatasetError(
            f"{where}: {seconds:.1f} s are too short; record at least {_MIN_SECONDS:g} s, better 60; {_REMEDY}"
        )
    measured = [(log, rows) for log in logs if (rows := np.isfinite(log.joints).all(axis=1)).sum() > 2]
    for k, name in enumerate(names):
        # Commands are checked too: other joints may shake a joint.
        for paths in (
            [(log.times[rows], log.joints[rows, k]) for log, rows in measured],
            [(log.times, log.commands[:, k]) for log, _ in measured],
        ):
            if fault := _too_little_motion(paths):
                raise DatasetError(f"{where}: {f'{side} ' if side else ''}{name} {fault}; {_REMEDY}")


def _too_little_motion(paths: Sequence[tuple[Array, Array]]) -> str | None:
    """Return why motions (n,), rad, at times (n,), s, do not suffice, with advice."""
    span = max((float(np.ptp(path)) for _, path in paths), default=0.0)
    if span < _MIN_SPAN:
        return (
            f"hardly moves: its range is {span:.3f} rad, and identification needs {_MIN_SPAN} rad; record it swinging "
            "back and forth by 0.5 rad, slowly and quickly"
        )
    turns = sum(_count_reversals(path) for _, path in paths)
    if turns < _MIN_REVERSALS:
        times = "never turns back" if not turns else f"turns back only {'once' if turns == 1 else f'{turns} times'}"
        return (
            f"{times}, so friction cannot be distinguished from an offset or from weight; record it swinging back and "
            f"forth at least {_MIN_REVERSALS} times"
        )
    fast = float(np.quantile(np.concatenate([_average_speeds(*path) for path in paths]), 1 - _MIN_FAST_TIME_SHARE))
    if fast < _MIN_SPEED:
        return (
            f"is always slow: it rarely exceeds {fast:.3f} rad/s, and identification needs {_MIN_SPEED} rad/s; record "
            "faster swings too, of 1 rad/s"
        )
    return None


def _count_reversals(path: Array) -> int:
    turns, direction, furthest = 0, 0, float(path[0])
    for place in path:
        if direction == 0:
            direction = int(np.sign(place - furthest)) if abs(place - furthest) > _REVERSAL_DISTANCE else 0
            furthest = float(place) if direction else furthest
        elif direction * (place - furthest) > 0:
            furthest = float(place)
        elif direction * (furthest - place) > _REVERSAL_DISTANCE:
            turns, direction, furthest = turns + 1, -direction, float(place)
    return turns


def _average_speeds(times: Array, path: Array) -> Array:
    grid = np.arange(0, times[-1] - times[0], _SPEED_PERIOD) + times[0]
    found: Array = np.abs(np.diff(np.interp(grid, times, path))) / _SPEED_PERIOD
    return found
