"""`YamsimEmbodiment`: the two-arm YAM station as an embodiment of the framework Inspect Robots."""

from __future__ import annotations

import logging
from functools import partial
from typing import Any, Literal, get_args

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
from ..core.errors import SimulationError, UsageError, suggest_similar
from .benchmark_scene import TICK_HZ, build_benchmark_scene, open_station_session
from .cartesian_control import EEF_STATE, START, CartesianStation
from .goal_kinds import GoalKind
from .scene_stepper import ACTION_DIM, ARM_JOINTS, MIN_CLOSING_S, SceneStepper
from .success_judges import GoalJudge, Judge, KitchenJudge
from .yamsim_scene import BENCHMARK, TASK_GOAL_KIND, build_task_scene

#: Keys of observed states: joint positions, and the seed from which the scene was built, for the expert alone.
JOINTS, SEED = "joint_pos", "realization_seed"
CAMERAS = ("top", "left", "right")  # names of the cameras in observations

CONTROL_HZ = 3.0  # Hz, default rate of actions in simulated time
ControlInterface = Literal["joints", "eef_pos"]

_MAX_START_ACTIONS = 200  # actions until the arms rest in the start posture of `eef_pos`, which takes some 10 at 3 Hz

ACTION_LABELS = tuple(
    f"{side}_{part}" for side in ("left", "right") for part in (*(f"j{k}" for k in range(ARM_JOINTS)), "gripper")
)

_LOGGER = logging.getLogger("yamsim")

_EMBODIMENT_DESCRIPTION = """\
Two arms of six joints, 0.61 m apart, in front of a table. An action is 14 absolute targets: six joints of
the left arm (rad), its gripper (0 closed and pressing .. 1 open), then the same of the right arm. During an action,
the references move linearly from the last targets to the new ones, within the motors' speed limits. With all joints at
zero, an arm is folded."""
_CARTESIAN_DESCRIPTION = """\
Two arms of six joints, 0.61 m apart, in front of a table. An action is 14 absolute targets, seven for the left arm and
then seven for the right one, each in the base frame of its arm (x ahead, y to the left, z up): x, y and z of the point
between the fingertips (m); yaw, pitch and roll of the hand (rad), relative to its orientation at the start of the
trial, in which it points ahead and 30 degrees down; the gripper (0 closed and pressing .. 1 open). Positive yaw turns
the hand counterclockwise seen from above. Positive pitch raises the fingertips, and negative pitch points the hand
further down. Positive roll swings the fingertips to the left of the arm. Values are clipped to the bounds of the space;
where both bounds are equal, the value is fixed. During an action, the joints move evenly towards the targets, within
the motors' speed limits. A target out of reach moves the hand to a pose near it."""


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
        depth: whether `extra` of observations has `<camera>_depth` (height, width), float32, m along the optical axis,
            0 where nothing is, and `<camera>_intrinsics` (3, 3), float32.
        control_interface: "joints", or "eef_pos" for hand poses. The names, bounds and frames of its actions, of the
            state `eef_state`, and the start posture are the same as in `inspect-robots-yam`.
        eef_orientation: whether pitch and roll of hand poses may vary.

    Raises:
        UsageError: an argument is invalid, or needs another one.
    """

    def __init__(
        self,
        *,
        control_hz: float = CONTROL_HZ,
        images: bool = True,
        size: str = "320x240",
        quality: str = "fast",
        depth: bool = False,
        control_interface: ControlInterface = "joints",
        eef_orientation: bool = False,
    ) -> None:
        self._ticks = ticks_per_action(control_hz)
        if control_interface not in get_args(ControlInterface):
            valid = get_args(ControlInterface)
            raise UsageError(f"control_interface={control_interface!r}: {suggest_similar(control_interface, valid)}")
        if eef_orientation and control_interface != "eef_pos":
            raise UsageError("eef_orientation needs control_interface=eef_pos")
        if depth and not images:
            raise UsageError("depth needs images=true")
        self._open_session = partial(open_station_session, size, images=images, quality=quality)
        self._base_session = self._open_session()
        width, height = self._base_session.config.image.size_px
        self._cameras, self._depth = CAMERAS if images else (), depth
        fields = [StateField(JOINTS, (ACTION_DIM,), "rad"), StateField(SEED, (1,))]
        self._cartesian: CartesianStation | None = None
        actions, description = action_space(self._base_session.config, self._ticks / TICK_HZ), _EMBODIMENT_DESCRIPTION
        if control_interface == "eef_pos":
            rig = self._base_session.config.rig
            self._cartesian = CartesianStation([rig.arms[k] for k in rig.recording_order], tilts=eef_orientation)
            actions, description = self._cartesian.action_space(self._ticks / TICK_HZ), _CARTESIAN_DESCRIPTION
            # The framework compares actions with the one declared field of their shape. Joints are observed too.
            fields[0] = StateField(EEF_STATE, (ACTION_DIM,), "m+rad+normalized")
        self.info = EmbodimentInfo(
            name="yamsim",
            action_space=actions,
            observation_space=ObservationSpace(
                cameras=tuple(CameraSpec(name, height, width) for name in self._cameras), state=StateSpec(tuple(fields))
            ),
            control_hz=TICK_HZ / self._ticks,
            is_simulated=True,
            capabilities=frozenset({SEEDABLE, RESETTABLE, PRIVILEGED_SUCCESS, *([RENDERABLE] if images else [])}),
            supported_target_kinds=frozenset({*(kind.value for kind in GoalKind), TASK_GOAL_KIND}),
            docs=description,
            environment_id="yamsim",
            environment_revision=__version__,
        )
        self.simulator: Simulator | None = None

    def reset(self, scene: Scene, *, seed: int | None = None) -> Observation:
        """Put a scene's objects onto the table, at rest, and the arms into their start postures.

        With `control_interface="eef_pos"`, the arms move to their start postures after the objects are at rest.

        Raises:
            LookupError: yamsim cannot build the scene.
            SimulationError: the arms do not reach their start postures.
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
        if self._cartesian is not None:
            self._move_to_start(self._cartesian)
        return self._observe(self.simulator)

    def _move_to_start(self, cartesian: CartesianStation) -> None:
        """Move the arms to the start posture of hand poses, from which their orientations count."""
        target = np.tile(START, 2)
        for _ in range(_MAX_START_ACTIONS):
            self._motion.execute_action(target)
            if np.allclose(self._motion.last_reference, target) and self._motion.is_at_rest():
                cartesian.start_at(self._motion.measured_state())
                return
        raise SimulationError(f"the arms are not at rest in their start posture after {_MAX_START_ACTIONS} actions")

    def step(self, action: Action) -> StepResult:
        """Execute an action (14,), and judge the new state."""
        assert self.simulator is not None, "call reset first"
        targets = np.asarray(action.data, dtype=np.float64)
        if self._cartesian is not None:
            targets = self._cartesian.joint_targets(targets, self._motion.last_reference)
        self._motion.execute_action(targets)
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
        images, extra = {}, dict[str, Any](unrealized=list(self._judge.unrealized))
        if self._cameras:
            qpos = self._motion.data.qpos
            images = render_cameras(simulator, Attempt(AttemptJob(0, 0)), qpos, self._cameras)
        for name in self._cameras if self._depth else ():
            # `render_cameras` has set the state of the replay. This method, unlike `render_depth`, has 0 for the sky.
            model, state_data = simulator.scene.model, simulator.state_replay.data
            unlabelled = np.zeros(model.ngeom, np.uint8), np.zeros(model.nflex, np.uint8)
            extra[f"{name}_depth"] = simulator.renderer.render_labels_and_depth(state_data, name, *unlabelled)[1]
            extra[f"{name}_intrinsics"] = simulator.intrinsics(name).K.astype(np.float32)
        measured = self._motion.measured_state()
        state = {JOINTS: measured, SEED: np.array([self._seed], dtype=np.float64)}
        if self._cartesian is not None:
            state[EEF_STATE] = self._cartesian.observe(measured)
        return Observation(
            images=images,
            state=state,
            instruction=self._judge.instruction,
            state_time=float(self._motion.data.time),
            extra=extra,
        )
