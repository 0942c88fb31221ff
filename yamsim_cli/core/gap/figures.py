"""How far what was measured lies from what a scene's arms do with the same commands: figures of one motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import DatasetError
from ..geometry.se3 import Array
from ..motion import ArmMotion, Motion
from ..scene.compiled import CompiledScene, SceneArm
from ..sim.follow import follow, hand_poses, held
from .delays import delay
from .phases import PHASES, at_rest, overshoot, phases, stops
from .smoothing import STEP, Smooth, smooth

# Fewer measured samples than these say nothing.
_LEAST_SAMPLES = 10


@dataclass(frozen=True)
class Size:
    """How large errors are, of how many samples: root mean square, the 95th percentile and the largest."""

    rms: float
    p95: float
    max: float
    samples: int

    @classmethod
    def of(cls, errors: Array) -> Size:
        """Of errors (n,) with n above 0, whatever their signs."""
        sizes = np.abs(errors)
        return cls(
            float(np.sqrt(np.mean(sizes**2))), float(np.percentile(sizes, 95)), float(np.max(sizes)), len(errors)
        )


@dataclass(frozen=True)
class Following:
    """How one curve of a joint comes after another; None where a motion does not tell.

    Attributes:
        delay: how much later it is, s.
        sag: how much farther it stands on average where both are at rest, rad.
        overshoot: how much farther it goes beyond where it comes to rest, on average over the stops, rad.
    """

    delay: float | None
    sag: float | None
    overshoot: float | None


@dataclass(frozen=True)
class JointGap:
    """What a joint did beyond its simulation; errors are measured less simulated.

    Attributes:
        arm, name: `left`, `right` or nothing, and the joint's name in the model.
        error: rad.
        beyond: of what was measured after what was simulated.
        measured, simulated: of each of them after the command; their overshoots are whole.
        phases: phase -> errors of the samples in which the joint was in it; those without any are left out.
    """

    arm: str
    name: str
    error: Size
    beyond: Following
    measured: Following
    simulated: Following
    phases: Mapping[str, Size]


@dataclass(frozen=True)
class HandGap:
    """How far a hand is from its simulation, by the joints of both; and its fingers, where they were measured.

    Attributes:
        arm: `left`, `right` or nothing.
        position: m.
        turn: rad.
        delay: how much later it is than its simulation, s; None where it is not told.
        opening: of one finger, m; None where nobody measured it.
    """

    arm: str
    position: Size
    turn: Size
    delay: float | None
    opening: Size | None


@dataclass(frozen=True)
class Worst:
    """The largest error of any joint.

    Attributes:
        frame: number of the measured sample, from 0: an episode's frame, or a file's row of figures.
        time: of it, s after the recording's first sample.
        error: measured less simulated, rad.
    """

    frame: int
    time: float
    arm: str
    joint: str
    error: float


@dataclass(frozen=True)
class Gap:
    """The gap of one motion.

    Attributes:
        name: of the motion.
        seconds: that were compared.
        error: of all joints, rad.
        phases: phase -> errors of all joints in it, rad.
        motion, simulated: what was measured, and what the scene's arms did, at the same samples.
        counted: which samples were compared (n,).
    """

    name: str
    seconds: float
    error: Size
    joints: tuple[JointGap, ...]
    hands: tuple[HandGap, ...]
    phases: Mapping[str, Size]
    worst: Worst
    motion: Motion
    simulated: Motion
    counted: NDArray[np.bool_]


def gap_of(scene: CompiledScene, motion: Motion, begin: float = 0.0, end: float = np.inf) -> Gap:
    """How far a motion lies from what a scene's arms do with its commands.

    All of it is simulated, from where it was measured first; the samples from `begin` to `end` are compared.

    Args:
        scene: of the rig alone, as `scene.build.build_rig_scene` makes it.
        begin, end: s after the motion's first sample.

    Raises:
        DatasetError: the motion has other arms or no commands, or too few measured samples.
        SimulationError: physics broke down.
    """
    simulated = follow(scene, motion)
    counted = (motion.times >= begin) & (motion.times <= end)
    for arm in motion.arms:
        counted = counted & np.isfinite(arm.joints).all(axis=1)
    if (found := int(counted.sum())) < _LEAST_SAMPLES:
        raise DatasetError(
            f"{motion.name}: {found} measured samples from {max(begin, 0):g} s to {min(end, motion.duration):g} s; "
            f"a gap needs {_LEAST_SAMPLES}: give a longer recording, or another --from and --to"
        )
    both = list(zip(scene.arms, motion.arms, simulated.arms, strict=True))
    curves = [_curves(motion.times, counted, real, made) for _, real, made in both]
    errors = [(real.joints - made.joints)[counted] for _, real, made in both]
    labels = [phases(seen.measured, motion.times[counted]) for seen in curves]
    joints = tuple(
        _joint_gap(scene, arm, real.side, k, off[:, k], seen, label[:, k])
        for (arm, real, _), seen, off, label in zip(both, curves, errors, labels, strict=True)
        for k in range(arm.dof)
    )
    hands = tuple(_hand_gap(scene, k, real, made, motion.times, counted) for k, (_, real, made) in enumerate(both))
    times = motion.times[counted]
    return Gap(
        name=motion.name,
        seconds=float(times[-1] - times[0]),
        error=Size.of(np.concatenate([off.ravel() for off in errors])),
        joints=joints,
        hands=hands,
        phases=_by_phase(np.concatenate([off.ravel() for off in errors]), np.concatenate([x.ravel() for x in labels])),
        worst=_worst(scene, motion, errors, counted),
        motion=motion,
        simulated=simulated,
        counted=counted,
    )


@dataclass(frozen=True)
class _Curves:
    """An arm's joints as measured, as simulated and as commanded, over what is compared, on one even grid."""

    measured: Smooth
    simulated: Smooth
    commanded: Smooth


def _curves(times: Array, counted: NDArray[np.bool_], real: ArmMotion, made: ArmMotion) -> _Curves:
    assert real.commands is not None, "it was followed"
    at = times[counted]
    inside = (times >= at[0]) & (times <= at[-1])
    # Commands may be told between what is measured, and none of them is to be missed.
    commands = held(real.commands, real.joints)[inside]
    return _Curves(
        smooth(at, real.joints[counted]),
        smooth(at, made.joints[counted]),
        smooth(times[inside], commands, steps=True, like=at),
    )


def _joint_gap(
    scene: CompiledScene,
    arm: SceneArm,
    side: str,
    k: int,
    errors: Array,
    curves: _Curves,
    labels: NDArray[np.int8],
) -> JointGap:
    resting = at_rest(curves.measured, curves.commanded, curves.measured.times)[:, k]
    stopped = list(stops(curves.commanded, k))

    def following(first: Smooth, second: Smooth) -> Following:
        apart = (second.values - first.values)[resting, k]
        beyond = [overshoot(second.values[:, k], stop, STEP) for stop in stopped]
        # A command does not go beyond itself, and a simulation may.
        already = [0.0 if first is curves.commanded else overshoot(first.values[:, k], stop, STEP) for stop in stopped]
        return Following(
            delay(first, second, k),
            float(np.mean(apart)) if len(apart) else None,
            float(np.mean(np.subtract(beyond, already))) if stopped else None,
        )

    return JointGap(
        arm=side,
        name=joint_name(scene, arm, k),
        error=Size.of(errors),
        beyond=following(curves.simulated, curves.measured),
        measured=following(curves.commanded, curves.measured),
        simulated=following(curves.commanded, curves.simulated),
        phases=_by_phase(errors, labels),
    )


def joint_name(scene: CompiledScene, arm: SceneArm, k: int) -> str:
    """The name of an arm's k-th joint in its model."""
    number = int(scene.model.dof_jntid[arm.joint_dof[k]])
    return str(scene.model.joint(number).name.removeprefix(arm.prefix))


def _by_phase(errors: Array, labels: NDArray[np.int8]) -> dict[str, Size]:
    """Phase -> size of the errors (n,) that are labelled so (n,)."""
    masks = {str(phase): labels == number for number, phase in enumerate(PHASES)}
    return {name: Size.of(errors[mask]) for name, mask in masks.items() if mask.any()}


def _hand_gap(
    scene: CompiledScene, number: int, real: ArmMotion, made: ArmMotion, times: Array, counted: NDArray[np.bool_]
) -> HandGap:
    at = times[counted]
    T_real, T_made = (hand_poses(scene, number, arm.joints[counted]) for arm in (real, made))
    apart = np.linalg.norm(T_real[:, :3, 3] - T_made[:, :3, 3], axis=1)
    opening = None
    if real.openings is not None and made.openings is not None:
        off = (real.openings - made.openings)[counted]
        opening = Size.of(off[np.isfinite(off)]) if np.isfinite(off).any() else None
    return HandGap(
        arm=real.side,
        position=Size.of(apart),
        turn=Size.of(_turns(T_real[:, :3, :3], T_made[:, :3, :3])),
        delay=delay(smooth(at, T_made[:, :3, 3]), smooth(at, T_real[:, :3, 3]), slice(None)),
        opening=opening,
    )


def _turns(ones: Array, others: Array) -> Array:
    """The angles (n,) between rotations (n, 3, 3), rad: exact for small ones too, which a cosine is not."""
    # The distance of two rotations as matrices is 2 sqrt(2) sin(angle / 2).
    apart = np.linalg.norm(ones - others, axis=(1, 2)) / (2 * np.sqrt(2))
    angles: Array = 2 * np.arcsin(np.clip(apart, 0, 1))
    return angles


def _worst(scene: CompiledScene, motion: Motion, errors: list[Array], counted: NDArray[np.bool_]) -> Worst:
    sizes = [np.abs(off) for off in errors]
    side = int(np.argmax([size.max() for size in sizes]))
    row, joint = np.unravel_index(np.argmax(sizes[side]), sizes[side].shape)
    sample = int(np.flatnonzero(counted)[row])
    known = np.logical_and.reduce([np.isfinite(arm.joints).all(axis=1) for arm in motion.arms])
    return Worst(
        frame=int(known[:sample].sum()),
        time=float(motion.times[sample]),
        arm=motion.arms[side].side,
        joint=joint_name(scene, scene.arms[side], int(joint)),
        error=float(errors[side][row, joint]),
    )
