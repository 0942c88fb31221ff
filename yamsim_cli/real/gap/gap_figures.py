"""The sim-to-real gap of a motion: measured minus simulated joints under the same commands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from yamsim_cli.core.errors import DatasetError
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.recorded_motion import ArmMotion, RecordedMotion
from yamsim_cli.core.scene.compiled import ArmAddresses, CompiledScene
from yamsim_cli.real.gap.command_simulation import forward_fill, hand_poses, simulate_commands

from .joint_curves import (
    PHASES,
    SmoothCurves,
    estimate_delay,
    find_command_stops,
    joints_at_rest,
    motion_phases,
    overshoot_after_stop,
    resample_and_smooth,
)

_MIN_SAMPLES = 10


@dataclass(frozen=True)
class ErrorStats:
    """RMS, 95th percentile and maximum of absolute errors."""

    rms: float
    p95: float
    max: float
    samples: int

    @classmethod
    def from_errors(cls, errors: Array) -> ErrorStats:
        """Return the statistics of one or more errors (n,)."""
        sizes = np.abs(errors)
        return cls(
            float(np.sqrt(np.mean(sizes**2))), float(np.percentile(sizes, 95)), float(np.max(sizes)), len(errors)
        )


@dataclass(frozen=True)
class TrackingFigures:
    """How a joint follows a reference curve; None if undetermined.

    Attributes:
        delay: after the reference, s.
        sag: mean of curve minus reference at rest, rad.
        overshoot: beyond the value at rest, minus the reference's, mean over the command's stops, rad.
    """

    delay: float | None
    sag: float | None
    overshoot: float | None


@dataclass(frozen=True)
class JointGap:
    """The gap of a joint. Errors are measured minus simulated, rad.

    Attributes:
        arm: `left`, `right` or empty.
        measured_vs_simulated: how the measured curve follows the simulated one.
        measured, simulated: how each curve follows the command.
        phases: `MotionPhase` -> errors, only for phases that occur.
    """

    arm: str
    name: str
    error: ErrorStats
    measured_vs_simulated: TrackingFigures
    measured: TrackingFigures
    simulated: TrackingFigures
    phases: Mapping[str, ErrorStats]


@dataclass(frozen=True)
class HandGap:
    """The gap of a hand, by forward kinematics.

    Attributes:
        arm: `left`, `right` or empty.
        position, rotation: distances, m, and angles, rad.
        delay: of the measured after the simulated hand, s; None if undetermined.
        opening: measured minus simulated opening of one finger, m.
    """

    arm: str
    position: ErrorStats
    rotation: ErrorStats
    delay: float | None
    opening: ErrorStats | None


@dataclass(frozen=True)
class WorstError:
    """The largest error of any joint.

    Attributes:
        frame: number of an episode's frame, or of a file's row, from 0.
        time: s after the first sample.
        arm: `left`, `right` or empty.
        error: measured minus simulated, rad.
    """

    frame: int
    time: float
    arm: str
    joint: str
    error: float


@dataclass(frozen=True)
class MotionGap:
    """The sim-to-real gap of one motion.

    Attributes:
        seconds: compared time.
        error, phases: of all joints, rad, in total and by `MotionPhase`.
        joints, hands: the left arm's first.
        motion, simulated: measured and simulated, at the same samples.
        is_compared: mask (n,) of compared samples.
    """

    name: str
    seconds: float
    error: ErrorStats
    joints: tuple[JointGap, ...]
    hands: tuple[HandGap, ...]
    phases: Mapping[str, ErrorStats]
    worst: WorstError
    motion: RecordedMotion
    simulated: RecordedMotion
    is_compared: NDArray[np.bool_]


def measure_gap(scene: CompiledScene, motion: RecordedMotion, begin: float = 0.0, end: float = np.inf) -> MotionGap:
    """Simulate a motion's commands, and compare samples from `begin` to `end`, s after the first.

    Args:
        scene: the rig alone, from `scene.build.build_rig_scene`.

    Raises:
        DatasetError: the arms differ from the scene's, commands are missing, or too few samples were measured.
        SimulationError: physics broke down.
    """
    simulated = simulate_commands(scene, motion)
    counted = (motion.times >= begin) & (motion.times <= end)
    for arm in motion.arms:
        counted = counted & np.isfinite(arm.joints).all(axis=1)
    if (found := int(counted.sum())) < _MIN_SAMPLES:
        raise DatasetError(
            f"{motion.name}: {found} measured samples from {max(begin, 0):g} s to {min(end, motion.duration):g} s; "
            f"a gap needs {_MIN_SAMPLES}: give a longer recording, or another --from and --to"
        )
    pairs = list(zip(scene.arms, motion.arms, simulated.arms, strict=True))
    joints = [_joint_gaps(scene, arm, real, made, motion.times, counted) for arm, real, made in pairs]
    hands = tuple(_hand_gap(scene, k, real, made, motion.times, counted) for k, (_, real, made) in enumerate(pairs))
    errors = [(real.joints - made.joints)[counted] for _, real, made in pairs]
    together = np.concatenate([rows.ravel() for rows in errors])
    times = motion.times[counted]
    return MotionGap(
        name=motion.name,
        seconds=float(times[-1] - times[0]),
        error=ErrorStats.from_errors(together),
        joints=tuple(gap for gaps, _ in joints for gap in gaps),
        hands=hands,
        phases=_error_stats_by_phase(together, np.concatenate([labels.ravel() for _, labels in joints])),
        worst=_find_worst_error(scene, motion, errors, counted),
        motion=motion,
        simulated=simulated,
        is_compared=counted,
    )


def _joint_gaps(
    scene: CompiledScene, arm: ArmAddresses, real: ArmMotion, made: ArmMotion, times: Array, counted: NDArray[np.bool_]
) -> tuple[list[JointGap], NDArray[np.int8]]:
    """Return an arm's gaps, and phases (n, dof) of compared samples, as indices of `PHASES`."""
    assert real.commands is not None, "the simulation followed them"
    at, errors = times[counted], (real.joints - made.joints)[counted]
    # The command curve also uses commands between measured samples.
    inside = (times >= at[0]) & (times <= at[-1])
    commanded = resample_and_smooth(
        times[inside], forward_fill(real.commands, real.joints)[inside], steps=True, like=at
    )
    measured, simulated = resample_and_smooth(at, real.joints[counted]), resample_and_smooth(at, made.joints[counted])
    resting, labels = joints_at_rest(measured, commanded), motion_phases(measured, at)

    def measure_tracking(first: SmoothCurves, second: SmoothCurves, k: int) -> TrackingFigures:
        apart = (second.values - first.values)[resting[:, k], k]
        stopped = list(find_command_stops(commanded, k))
        beyond = [overshoot_after_stop(second.values[:, k], stop) for stop in stopped]
        # A command does not overshoot itself.
        already = [0.0 if first is commanded else overshoot_after_stop(first.values[:, k], stop) for stop in stopped]
        return TrackingFigures(
            estimate_delay(first, second, k),
            float(np.mean(apart)) if len(apart) else None,
            float(np.mean(np.subtract(beyond, already))) if stopped else None,
        )

    gaps = [
        JointGap(
            arm=real.side,
            name=_joint_name(scene, arm, k),
            error=ErrorStats.from_errors(errors[:, k]),
            measured_vs_simulated=measure_tracking(simulated, measured, k),
            measured=measure_tracking(commanded, measured, k),
            simulated=measure_tracking(commanded, simulated, k),
            phases=_error_stats_by_phase(errors[:, k], labels[:, k]),
        )
        for k in range(arm.dof)
    ]
    return gaps, labels


def _joint_name(scene: CompiledScene, arm: ArmAddresses, k: int) -> str:
    number = int(scene.model.dof_jntid[arm.joint_dof[k]])
    return str(scene.model.joint(number).name.removeprefix(arm.prefix))


def _error_stats_by_phase(errors: Array, labels: NDArray[np.int8]) -> dict[str, ErrorStats]:
    masks = {str(phase): labels == number for number, phase in enumerate(PHASES)}
    return {name: ErrorStats.from_errors(errors[mask]) for name, mask in masks.items() if mask.any()}


def _hand_gap(
    scene: CompiledScene, number: int, real: ArmMotion, made: ArmMotion, times: Array, counted: NDArray[np.bool_]
) -> HandGap:
    at = times[counted]
    T_real, T_made = (hand_poses(scene, number, arm.joints[counted]) for arm in (real, made))
    apart = np.linalg.norm(T_real[:, :3, 3] - T_made[:, :3, 3], axis=1)
    opening = None
    if real.openings is not None and made.openings is not None:
        off = (real.openings - made.openings)[counted]
        opening = ErrorStats.from_errors(off[np.isfinite(off)]) if np.isfinite(off).any() else None
    return HandGap(
        arm=real.side,
        position=ErrorStats.from_errors(apart),
        rotation=ErrorStats.from_errors(_angles_between(T_real[:, :3, :3], T_made[:, :3, :3])),
        delay=estimate_delay(
            resample_and_smooth(at, T_made[:, :3, 3]), resample_and_smooth(at, T_real[:, :3, 3]), slice(None)
        ),
        opening=opening,
    )


def _angles_between(ones: Array, others: Array) -> Array:
    """Return angles (n,), rad, between rotations (n, 3, 3)."""
    # The Frobenius distance, 2 sqrt(2) sin(angle / 2), is exact for small angles, unlike a cosine.
    apart = np.linalg.norm(ones - others, axis=(1, 2)) / (2 * np.sqrt(2))
    angles: Array = 2 * np.arcsin(np.clip(apart, 0, 1))
    return angles


def _find_worst_error(
    scene: CompiledScene, motion: RecordedMotion, errors: list[Array], counted: NDArray[np.bool_]
) -> WorstError:
    sizes = [np.abs(off) for off in errors]
    side = int(np.argmax([size.max() for size in sizes]))
    row, joint = np.unravel_index(np.argmax(sizes[side]), sizes[side].shape)
    sample = int(np.flatnonzero(counted)[row])
    known = np.logical_and.reduce([np.isfinite(arm.joints).all(axis=1) for arm in motion.arms])
    return WorstError(
        frame=int(known[:sample].sum()),
        time=float(motion.times[sample]),
        arm=motion.arms[side].side,
        joint=_joint_name(scene, scene.arms[side], int(joint)),
        error=float(errors[side][row, joint]),
    )
