"""`YamsimEmbodiment`: the two-arm YAM station as an embodiment of the framework Inspect Robots."""

from __future__ import annotations

import logging
from functools import partial

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
from kitchenbench.sim import build_blueprint

from .. import __version__
from ..core.attempt_data import Attempt, AttemptJob
from ..core.config.recording import RecordConfig
from ..core.episode.attempt_payload import render_cameras
from ..core.episode.simulator import Simulator
from ..core.errors import UsageError
from .benchmark_scene import GOAL_KINDS, TICK_HZ, build_benchmark_scene, open_station_session
from .scene_stepper import ACTION_DIM, ARM_JOINTS, MIN_CLOSING_S, SceneStepper
from .success_judges import GoalJudge, Judge, KitchenJudge
from .yamsim_scene import BENCHMARK, GOAL_KIND, build_task_scene

#: Keys of observed states: joint positions, and the seed from which the scene was built, for the expert alone.
JOINTS, SEED = "joint_pos", "realization_seed"
CAMERAS = ("top", "left", "right")  # names of the cameras in observations

CONTROL_HZ = 3.0  # Hz, default rate of actions in simulated time

ACTION_LABELS = tuple(
    f"{side}_{part}" for side in ("left", "right") for part in (*(f"j{k}" for k in range(ARM_JOINTS)), "gripper")
)

_LOGGER = logging.getLogger("yamsim")

_EMBODIMENT_DESCRIPTION = """\
Two arms of six joints, 0.61 m apart, in front of a table. An action is 14 absolute targets: six joints of
the left arm (rad), its gripper (0 closed and pressing .. 1 open), then the same of the right arm. During an action,
the references move linearly from the last targets to the new ones, within the motors' speed limits. With all joints at
zero, an arm is folded."""


def action_space(config: RecordConfig, period: float) -> Box:
    """Return the action space of both arms: joint targets in rad and gripper openings, 0..1.

    The `period` of an action, s, limits the steps of the joints.
    """
    low, high, limits = list[float](), list[float](), list[float]()
    for number in config.rig.recording_order:
        robot = config.rig.arms[number].robot
        low += [*robot.joint_range[:, 0], 0.0]
        high += [*robot.joint_range[:, 1], 1.0]
        limits += [*(joint.motor_rad_s * period for joint in robot.joints), min(1.0, period / MIN_CLOSING_S)]
    semantics = ActionSemantics(
        control_mode="joint_pos", gripper="continuous", dim_labels=ACTION_LABELS, max_step=tuple(map(float, limits))
    )
    return Box((ACTION_DIM,), np.array(low, float), np.array(high, float), semantics)


def ticks_per_action(control_hz: float) -> int:
    """Return the number of control ticks in an action."""
    ticks = round(TICK_HZ / control_hz) if control_hz > 0 else 0
    if not 1 <= ticks <= TICK_HZ or abs(TICK_HZ / control_hz - ticks) > 1e-9:
        valid = ", ".join(f"{TICK_HZ / k:g}" for k in (1, 2, 3, 5, 6, 10, 12, 15, 30))
        raise UsageError(
            f"control_hz={control_hz:g} is not a whole number of ticks of 1/{TICK_HZ} s; give one of {valid}"
        )
    return ticks


class YamsimEmbodiment:
    """The station `yam_station_linear_4310_d405` with the objects of a KitchenBench scene or yamsim task.

    After each action, KitchenBench's checker judges its scenes, and a yamsim task's goal judges that task.

    Attributes:
        info: the description for compatibility checks.
        simulator: simulates the scene that was reset last; None before the first reset.
        world: answers checkers' queries about the KitchenBench scene that was reset last.

    Args:
        control_hz: actions per second of simulated time; each lasts a whole number of control ticks of 1/30 s.
        images: whether observations have pictures of the three cameras; pictures take most of the time.
        size: of pictures, WIDTHxHEIGHT, px.
        quality: of pictures, see `configs/quality`.
    """

    def __init__(
        self, *, control_hz: float = CONTROL_HZ, images: bool = True, size: str = "320x240", quality: str = "fast"
    ) -> None:
        self._ticks = ticks_per_action(control_hz)
        self._open_session = partial(open_station_session, size, images=images, quality=quality)
        self._base_session = self._open_session()
        width, height = self._base_session.config.image.size_px
        self._cameras = CAMERAS if images else ()
        fields = (StateField(JOINTS, (ACTION_DIM,), "rad"), StateField(SEED, (1,)))
        self.info = EmbodimentInfo(
            name="yamsim",
            action_space=action_space(self._base_session.config, self._ticks / TICK_HZ),
            observation_space=ObservationSpace(
                cameras=tuple(CameraSpec(name, height, width) for name in self._cameras), state=StateSpec(fields)
            ),
            control_hz=TICK_HZ / self._ticks,
            is_simulated=True,
            capabilities=frozenset({SEEDABLE, RESETTABLE, PRIVILEGED_SUCCESS, *([RENDERABLE] if images else [])}),
            supported_target_kinds=GOAL_KINDS | {GOAL_KIND},
            docs=_EMBODIMENT_DESCRIPTION,
            environment_id="yamsim",
            environment_revision=__version__,
        )
        self.simulator: Simulator | None = None

    def reset(self, scene: Scene, *, seed: int | None = None) -> Observation:
        """Put a scene's objects onto the table, at rest, and the arms into their start postures.

        Raise LookupError for a scene that yamsim cannot build.
        """
        self.close()
        self._seed = 0 if seed is None else seed
        match scene.metadata.get("benchmark"):
            case "kitchenbench":
                kitchen = build_benchmark_scene(build_blueprint(scene, self._seed), self._base_session)
                self._motion = SceneStepper(kitchen, self._ticks)
                judge = KitchenJudge(kitchen, self._motion)
                self._judge: Judge = judge
                self.world = judge.world
                self.simulator = kitchen.simulator
            case str(name) if name == BENCHMARK:
                own = build_task_scene(self._open_session(task=str(scene.metadata["task"])), self._seed)
                self._motion = SceneStepper(own, self._ticks)
                self._judge = GoalJudge(own, self._motion)
                self.simulator = own.simulator
            case _:
                raise LookupError(
                    f"scene {scene.id!r} is not a scene of KitchenBench or yamsim; yamsim supports no others"
                )
        for line in self._judge.unrealized:
            _LOGGER.warning("%s: %s", scene.id, line)
        return self._observe(self.simulator)

    def step(self, action: Action) -> StepResult:
        """Execute an action (14,), and judge the new state."""
        assert self.simulator is not None, "call reset first"
        self._motion.execute_action(np.asarray(action.data, dtype=np.float64))
        reached, explanation = self._judge.evaluate()
        reason = "success" if reached else None
        if broken := self._motion.physics_failure():
            reason = f"physics broke down: {broken}"
        return StepResult(
            observation=self._observe(self.simulator),
            reward=float(reason == "success"),
            terminated=reason is not None,
            termination_reason=reason,
            info={
                "success": reason == "success",
                "explanation": explanation,
                "unrealized": list(self._judge.unrealized),
                **self._judge.step_info,
            },
        )

    def close(self) -> None:
        """Free the scene and its renderer."""
        if self.simulator is not None:
            self.simulator.close()
            self.simulator = None

    def _observe(self, simulator: Simulator) -> Observation:
        images = {}
        if self._cameras:
            qpos = self._motion.data.qpos
            images = render_cameras(simulator, Attempt(AttemptJob(0, 0)), qpos, self._cameras)
        return Observation(
            images=images,
            state={JOINTS: self._motion.measured_state(), SEED: np.array([self._seed], dtype=np.float64)},
            instruction=self._judge.instruction,
            state_time=float(self._motion.data.time),
            extra={"unrealized": list(self._judge.unrealized)},
        )
