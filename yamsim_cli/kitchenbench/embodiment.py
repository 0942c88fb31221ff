"""The station with two arms as an embodiment of Inspect Robots."""

from __future__ import annotations

import logging
import os
from typing import Any

import numpy as np
from inspect_robots import (
    Action,
    ActionSemantics,
    Box,
    CameraSpec,
    EmbodimentInfo,
    Observation,
    ObservationSpace,
    Scene,
    StepResult,
)
from inspect_robots.embodiment import PRIVILEGED_SUCCESS, RENDERABLE, RESETTABLE, SEEDABLE
from inspect_robots.spaces import StateField, StateSpec
from kitchenbench.sim import build_blueprint, make_success_checker
from kitchenbench.sim.success import SuccessChecker

from .. import __version__
from ..core.attempt.pictures import render
from ..core.config.recording import RecordConfig
from ..core.errors import UsageError
from ..core.opener import Opener, parse_size
from ..core.session import Session
from ..core.types import Attempt, EpisodeJob
from .motion import ACTION_DIM, ARM_JOINTS, CLOSING, Motion
from .scene import KINDS, TICK_HZ, Realization, realize
from .world import KitchenWorld

STATION = "yam_station_linear_4310_d405"

#: State keys: what a real station tells, and the number from which a realization follows, which only an expert may use.
JOINTS, SEED = "joint_pos", "realization_seed"
CAMERAS = ("top", "left", "right")

#: Actions a second of simulated time, unless asked otherwise.
CONTROL_HZ = 3.0

LABELS = tuple(
    f"{side}_{part}" for side in ("left", "right") for part in (*(f"j{k}" for k in range(ARM_JOINTS)), "gripper")
)

_LOG = logging.getLogger("yamsim")

_OPENER = Opener(os.environ, _LOG.warning, "{}=".format)

_NOTES = """Two arms of six joints, 0.61 m apart, before a table. An action is 14 absolute targets: six joints of the
left arm (rad), its gripper (0 closed and pressing .. 1 open), then the right arm's. Over an action, references go
evenly from the last targets to the new ones, as far as motors' speeds let them. At zero an arm is folded."""


def open_base(size: str, *, images: bool, quality: str = "fast") -> Session:
    """A session of the station, whose task every scene replaces.

    Raises:
        UsageError: the size or the quality is not valid.
        ResourceError: images are wanted, and nothing can render here.
    """
    given: dict[str, Any] = {"rig": STATION, "task": _ANY_TASK, "size": parse_size(size), "quality": quality}
    if images:
        return _OPENER.open("default", parallel=False, **given)
    where = _OPENER.locations()
    return Session(_OPENER.config("default", where, **given), where).without_meshes()


# Whichever of ours: a scene brings a task of its own.
_ANY_TASK = "tower"


def action_space(config: RecordConfig, period: float) -> Box:
    """Joint targets of both arms.

    Args:
        period: how long an action lasts, s; motors go only so far in it.
    """
    low, high, most = list[float](), list[float](), list[float]()
    for number in config.rig.recorded:
        robot = config.rig.arms[number].robot
        low += [*robot.joint_range[:, 0], 0.0]
        high += [*robot.joint_range[:, 1], 1.0]
        most += [*(joint.motor_rad_s * period for joint in robot.joints), min(1.0, period / CLOSING)]
    semantics = ActionSemantics(
        control_mode="joint_pos", gripper="continuous", dim_labels=LABELS, max_step=tuple(map(float, most))
    )
    return Box((ACTION_DIM,), np.array(low, float), np.array(high, float), semantics)


def ticks_of(control_hz: float) -> int:
    """How many control ticks an action lasts.

    Raises:
        UsageError: not a whole number of them.
    """
    ticks = round(TICK_HZ / control_hz) if control_hz > 0 else 0
    if not 1 <= ticks <= TICK_HZ or abs(TICK_HZ / control_hz - ticks) > 1e-9:
        valid = ", ".join(f"{TICK_HZ / k:g}" for k in (1, 2, 3, 5, 6, 10, 12, 15, 30))
        raise UsageError(f"control_hz={control_hz:g} is no whole number of ticks of 1/{TICK_HZ} s; give one of {valid}")
    return ticks


class YamsimEmbodiment:
    """The station `yam_station_linear_4310_d405` before a table with the things of a KitchenBench scene.

    Success is judged by the benchmark's own checker alone, after every action.

    Attributes:
        info: what it is, for whoever checks whether a policy fits.
        world: of the scene that was reset last, what checkers ask.

    Args:
        control_hz: actions a second of simulated time; each lasts a whole number of control ticks of 1/30 s.
        images: whether observations have pictures of the three cameras; they take most of the time.
        size: of pictures, WIDTHxHEIGHT, px.
        quality: of pictures, see `configs/quality`.

    Raises:
        UsageError: a value is not valid.
        ResourceError: images are wanted, and nothing can render here.
    """

    def __init__(
        self, *, control_hz: float = CONTROL_HZ, images: bool = True, size: str = "320x240", quality: str = "fast"
    ) -> None:
        self._ticks = ticks_of(control_hz)
        self._base = open_base(size, images=images, quality=quality)
        width, height = self._base.config.image.size_px
        self._cameras = CAMERAS if images else ()
        fields = (StateField(JOINTS, (ACTION_DIM,), "rad"), StateField(SEED, (1,)))
        self.info = EmbodimentInfo(
            name="yamsim",
            action_space=action_space(self._base.config, self._ticks / TICK_HZ),
            observation_space=ObservationSpace(
                cameras=tuple(CameraSpec(name, height, width) for name in self._cameras), state=StateSpec(fields)
            ),
            control_hz=TICK_HZ / self._ticks,
            is_simulated=True,
            capabilities=frozenset({SEEDABLE, RESETTABLE, PRIVILEGED_SUCCESS, *([RENDERABLE] if images else [])}),
            supported_target_kinds=KINDS,
            docs=_NOTES,
            environment_id="yamsim",
            environment_revision=__version__,
        )
        self._realized: Realization | None = None

    def reset(self, scene: Scene, *, seed: int | None = None) -> Observation:
        """Put a scene's things onto the table, at rest, and the arms where they start.

        Raises:
            LookupError: it is no scene of the benchmark's, or one that is not realized.
            SimulationError: it cannot be compiled.
        """
        if scene.metadata.get("benchmark") != "kitchenbench":
            raise LookupError(f"scene {scene.id!r} is none of KitchenBench's, and yamsim realizes no others")
        self.close()
        self._seed = 0 if seed is None else seed
        self._realized = realized = realize(build_blueprint(scene, self._seed), self._base)
        for line in realized.unrealized:
            _LOG.warning("%s: %s", scene.id, line)
        self._motion = Motion(realized, self._ticks)
        self.world = KitchenWorld(realized, self._motion)
        self._checker: SuccessChecker = make_success_checker(realized.blueprint, self.world)
        return self._observe(realized)

    def step(self, action: Action) -> StepResult:
        """Let an action (14,) act, and have the benchmark's checker look at what came of it."""
        assert self._realized is not None, "reset comes first"
        self._motion.act(np.asarray(action.data, dtype=np.float64))
        verdict = self._checker(self.world)
        reason = "success" if verdict.success else None
        if broken := self._motion.broken():
            reason = f"physics broke down: {broken}"
        return StepResult(
            observation=self._observe(self._realized),
            reward=float(reason == "success"),
            terminated=reason is not None,
            termination_reason=reason,
            info={
                "success": reason == "success",
                "explanation": verdict.explanation,
                "contract_version": self._realized.blueprint.contract_version,
                "unrealized": list(self._realized.unrealized),
            },
        )

    def close(self) -> None:
        """Free the scene and its renderer."""
        if self._realized is not None:
            self._realized.simulator.close()
            self._realized = None

    def _observe(self, realized: Realization) -> Observation:
        images = {}
        if self._cameras:
            qpos = self._motion.data.qpos
            images = render(realized.simulator, Attempt(EpisodeJob(0, 0)), qpos, self._cameras)
        return Observation(
            images=images,
            state={JOINTS: self._motion.state(), SEED: np.array([self._seed], dtype=np.float64)},
            instruction=realized.blueprint.instruction,
            state_time=float(self._motion.data.time),
            extra={"unrealized": list(realized.unrealized)},
        )
