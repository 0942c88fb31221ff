"""`YamsimExpert`: a policy for KitchenBench's and yamsim's tasks that plans in a second simulation."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from itertools import chain

import numpy as np
from inspect_robots import (
    Action,
    ActionChunk,
    EmbodimentInfo,
    Observation,
    ObservationSpace,
    PolicyConfig,
    PolicyInfo,
    Scene,
)
from kitchenbench.sim import build_blueprint

from ..core.attempt_data import AttemptJob
from ..core.config.goals.role_assignment import RoleAssignment
from ..core.expert.planning.arm_solvers import start_postures
from ..core.expert.skills.common_motions import park_free_hands
from ..core.expert.skills.planning_context import MotionSegment, PlanningContext, SkillFailedError
from ..core.expert.skills.program import RecoveryLog, run_program
from ..core.expert.skills.skill import Skill
from ..core.geometry.se3 import Array
from ..core.scene.random_streams import Stream, random_generator
from .benchmark_scene import TICK_HZ, BenchmarkScene, build_benchmark_scene, open_station_session
from .embodiment import CONTROL_HZ, JOINTS, SEED, action_space, ticks_per_action
from .scene_stepper import SceneStepper, commanded_share, scene_fingers
from .skill_programs import build_scene_program
from .success_judges import Judge
from .yamsim_scene import BENCHMARK, YamsimTaskScene, build_task_scene

_STATE_TOLERANCE = 1e-6  # rad and gripper shares, between observed and simulated state: rounding
_MAX_PATH_ERROR = 0.01  # rad, of a joint from its path between two actions: 5 mm at an arm's length
_MAX_REST_ACTIONS = 2  # actions after a motion, until everything is at rest

_LOGGER = logging.getLogger("yamsim")


class YamsimExpert:
    """Plans skills in a second simulation of the scene, built from the observed seed.

    The seed is privileged: no other policy may use it. A skill that fails is tried again from the resulting state.
    After three failures the arms stay where they are.
    """

    def __init__(self) -> None:
        self.config = PolicyConfig()
        self._base_session = open_station_session("64x48", images=False)
        self._scene: Scene | None = None
        self._planning_scene: PlanningScene | None = None
        self._set_control_rate(CONTROL_HZ)

    def bind(self, embodiment_info: EmbodimentInfo) -> None:
        """Take the duration of an action from the embodiment."""
        self._set_control_rate(embodiment_info.control_hz or CONTROL_HZ)

    def reset(self, scene: Scene) -> None:
        """Begin a scene; its first observation has the seed."""
        self.close()
        self._scene = scene

    def act(self, observation: Observation) -> ActionChunk:
        """Return the actions of the next motion; after the last motion, one that holds the joints.

        Raise RuntimeError if observed and simulated joints differ: something changed the actions.
        """
        assert self._scene is not None, "call reset first"
        if self._planning_scene is None:
            seed = int(observation.state[SEED][0])
            self._planning_scene = PlanningScene(self._realize_scene(self._scene, seed), seed, self._ticks)
        planning = self._planning_scene
        off = float(np.abs(np.asarray(observation.state[JOINTS]) - planning.motion.measured_state()).max())
        if off > _STATE_TOLERANCE:
            raise RuntimeError(
                f"the arms are {off:.4f} away from where the expert's actions lead: something changes the actions"
            )
        return ActionChunk([Action(action) for action in planning.next_actions()], control_hz=self.info.control_hz)

    def close(self) -> None:
        """Free the expert's simulation."""
        if self._planning_scene is not None:
            self._planning_scene.close()
            self._planning_scene = None

    def _realize_scene(self, scene: Scene, seed: int) -> BenchmarkScene | YamsimTaskScene:
        if scene.metadata.get("benchmark") == BENCHMARK:
            return build_task_scene(open_station_session("64x48", images=False, task=str(scene.metadata["task"])), seed)
        return build_benchmark_scene(build_blueprint(scene, seed), self._base_session)

    def _set_control_rate(self, control_hz: float) -> None:
        self._ticks = ticks_per_action(control_hz)
        self.info = PolicyInfo(
            name="yamsim_expert",
            action_space=action_space(self._base_session.config, self._ticks / TICK_HZ),
            observation_space=ObservationSpace(state_keys=frozenset({JOINTS, SEED})),
            control_hz=control_hz,
        )


class PlanningScene:
    """A second simulation of a scene, moved by the same actions as the first; skills plan from its state.

    Attributes:
        simulator: the simulator of the scene.
        motion: executes the actions in this simulation.
        context: the planning context of the skills.

    Args:
        seed: the scene's seed, from which the random path searches are seeded.
        ticks: control ticks in an action.
    """

    def __init__(self, realized: BenchmarkScene | YamsimTaskScene, seed: int, ticks: int) -> None:
        self._ticks = ticks
        self.simulator = simulator = realized.simulator
        self.motion = SceneStepper(realized, ticks)
        if isinstance(realized, YamsimTaskScene):
            self._scene_id, program = realized.scene_id, realized.expert_skills()
        else:
            self._scene_id = realized.blueprint.scene_id
            program = build_scene_program(realized.blueprint, realized.object_configs, realized.base_positions)
        world = self.motion.episode.world
        rng = random_generator(AttemptJob(seed, 0), Stream.PLANNING)
        self.context: PlanningContext = simulator.expert_planner.planning_context(
            world, list(start_postures(simulator.config)), rng
        )
        self.start_program(program, simulator.roles)

    def start_program(self, program: Sequence[Skill], roles: RoleAssignment) -> None:
        """Begin a list of skills, whose motions `next_actions` returns as actions."""
        self._segments = chain(run_program(program, self.context, roles, RecoveryLog()), park_free_hands(self.context))

    def next_actions(self) -> list[Array]:
        """Return the actions of the next motion, after executing them."""
        segment = self._next_segment()
        while segment is not None and is_still(segment) and self.motion.is_at_rest():
            segment = self._next_segment()
        actions = (
            [self.motion.last_reference]
            if segment is None
            else list(segment_actions(self.context, segment, self._ticks))
        )
        for action in actions:
            self.motion.execute_action(action)
        # Arms lag behind the references, and the next skill plans from a state at rest.
        limit = len(actions) + (_MAX_REST_ACTIONS if segment is None or segment.wait_for_arrival else 0)
        while not self.motion.is_at_rest() and len(actions) < limit:
            actions.append(self.motion.last_reference)
            self.motion.execute_action(actions[-1])
        return actions

    def _next_segment(self) -> MotionSegment | None:
        try:
            return next(self._segments, None)
        except SkillFailedError as error:
            _LOGGER.warning("%s: the expert gives up: %s", self._scene_id, error)
            return None

    def close(self) -> None:
        """Free the simulation and the planning context's cache."""
        self.context.clear_cache()
        self.simulator.close()


def run_expert(
    planning: PlanningScene, judge: Judge, max_actions: int, after_motion: Callable[[], None] | None = None
) -> int:
    """Let the expert act until the judge reports success, and return the number of actions.

    No motion begins after `max_actions`, but the last one may exceed them. `after_motion` is called after each motion.
    """
    actions = 0
    while actions < max_actions and not judge.evaluate()[0]:
        actions += len(planning.next_actions())
        if after_motion is not None:
            after_motion()
    return actions


def is_still(segment: MotionSegment) -> bool:
    """Whether a segment only waits: no joint, finger opening or finger force changes."""
    return all(
        not np.ptp(row, axis=0).any() for path in segment.paths for row in (path.joints, path.gripper, path.grip_force)
    )


def _last_tick_on_line(joints: Array, first: int, last: int) -> int:
    """Return the last tick, up to `last`, to which a straight line from tick `first` follows a path (n + 1, dof)."""
    while last > first + 1:
        chord = joints[last] - joints[first]
        between = joints[first + 1 : last] - joints[first]
        share = np.clip(between @ chord / max(float(chord @ chord), 1e-12), 0.0, 1.0)
        if np.abs(between - share[:, None] * chord).max() <= _MAX_PATH_ERROR:
            break
        last -= 1
    return last


def segment_actions(context: PlanningContext, segment: MotionSegment, ticks: int) -> Iterator[Array]:
    """Yield the actions (14,) that make the arms follow a segment.

    References move on straight lines between actions. Where a path bends, actions are closer together and the arm is
    slower.
    """
    fingers_of_both = scene_fingers([hand.arm for hand in context.hands])
    joints_of_both = np.concatenate([path.joints for path in segment.paths], axis=1)
    tick = 0
    while tick < segment.tick_count:
        tick = _last_tick_on_line(joints_of_both, tick, min(tick + ticks, segment.tick_count))
        parts = []
        for hand, fingers, path in zip(context.hands, fingers_of_both, segment.paths, strict=True):
            # A drive is a spring towards its command. The command includes the deflection by the weight of arm and
            # load, but not by accelerations: their deflection would remain after the motion.
            arm = hand.arm
            joints = (
                path.joints[tick]
                + context.holding_torques(hand, path.joints[tick], float(path.gripper[tick - 1])) / arm.position_gain
            )
            opening = path.gripper[tick - 1] - 2 * path.grip_force[tick - 1] / fingers.gain
            share = commanded_share(fingers, float(np.clip(opening, *fingers.ctrl_range)))
            parts += [np.clip(joints, arm.joint_range[:, 0], arm.joint_range[:, 1]), [share]]
        yield np.concatenate(parts)
