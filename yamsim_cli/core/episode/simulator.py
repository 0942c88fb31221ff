from __future__ import annotations

import copy
import functools
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace

from ...camera_rendering import EffectsCamera, EffectsRenderer, with_lens
from ..attempt_data import Attempt, AttemptJob
from ..closable import Closable
from ..config.goals.role_assignment import RoleAssignment
from ..config.session import Session
from ..errors import SimulationError
from ..expert.planning.arm_solvers import ArmIkAndDynamics, make_arm_ik_and_dynamics
from ..geometry.camera import Intrinsics
from ..rendering.renderer import SceneRenderer
from ..rendering.scene_labels import SceneLabels, make_scene_labels
from ..scene.build import build_scene
from ..scene.compiled import CompiledScene
from ..scene.start_sampling import sample_roles
from ..sim.placement import DistractorPlacer
from ..sim.state_replay import StateReplay
from .episode import Episode, EpisodeGoal, PhysicsStepCallback
from .episode_rules import EpisodeRules
from .expert import ExpertPlanner, arm_sides
from .randomized_scene import RandomizedScene


class Simulator(Closable):
    """A session's compiled scene, with a state replay, the expert's planner and a renderer that are made on demand.

    These are expensive, so a process makes them once. A simulator keeps no state of attempts, except that `scene.model`
    has the variation last given to `apply_randomization`.

    Args:
        session: its task has only the objects of `roles`.
        roles: by default the task's typical roles, and the session is reduced to their objects.
        tools: makes the solvers of the arms; by default `make_arm_solvers`.
    """

    def __init__(
        self,
        session: Session,
        roles: RoleAssignment | None = None,
        tools: Callable[[], tuple[ArmIkAndDynamics, ...]] | None = None,
    ) -> None:
        if roles is None:
            roles = session.config.task.typical_roles
            session = session_for_roles(session, roles)
        self.session = session
        self.config = config = session.config
        self.roles = roles
        self._tools = tools or functools.partial(make_arm_ik_and_dynamics, config.rig)
        self.scene = build_scene(session)
        # These parts need the scene before its first variation.
        self.labels: SceneLabels | None = _make_scene_labels(session, self.scene) if config.truth else None
        self.distractor_placer = DistractorPlacer(config, self.scene) if config.randomization.distractors else None
        self.randomized_scene = RandomizedScene(config, self.scene)
        self._renderer: SceneRenderer | None = None

    def apply_randomization(self, attempt: Attempt) -> CompiledScene:
        """Return the scene with an attempt's variation; valid until the next call."""
        return self.randomized_scene.apply_randomization(attempt)

    @functools.cached_property
    def state_replay(self) -> StateReplay:
        """A second state of the scene, which can be set to any recorded state."""
        return StateReplay(self.scene)

    @functools.cached_property
    def expert_planner(self) -> ExpertPlanner:
        """The expert's planner; its first use reads files."""
        return ExpertPlanner(self.config, self.scene, self._tools())

    def prepare(self) -> None:
        """Make the expert's planner now: its files may be gone at the first attempt."""
        _ = self.expert_planner

    @property
    def renderer(self) -> SceneRenderer:
        """The renderer; raises ResourceError if no OpenGL context can be made."""
        if self._renderer is None:
            size = self.config.image.size_px
            effects = {name: each for name in self.scene.cameras if (each := self.config.effects_of(name))}
            self._renderer = EffectsRenderer(self.scene.model, size, self.config.render, effects)
        return self._renderer

    def intrinsics(self, camera: str) -> Intrinsics:
        """Return the intrinsics of a recorded camera, with its lens, for images of the config's size."""
        ideal = self.state_replay.intrinsics(camera, self.config.image.size_px)
        return with_lens(ideal, self.config.effects_of(camera))

    @functools.cached_property
    def effects_cameras(self) -> dict[str, EffectsCamera]:
        """Name -> camera, for the recorded cameras with effects."""
        timing = self.config.task.timing
        period = timing.tick_seconds * timing.ticks_per_frame
        return {
            name: EffectsCamera(name, number, effects, period)
            for number, name in enumerate(self.scene.cameras)
            if (effects := self.config.effects_of(name)) is not None
        }

    def close(self) -> None:
        """Free the renderer."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


def session_for_roles(session: Session, roles: RoleAssignment) -> Session:
    """Return the session with only the objects of a role assignment, and with start regions in `world`."""
    task = session.config.task
    try:
        task_of_roles = task.with_objects_of(roles)
    except ValueError as error:
        # Only tasks of datasets fail here: their objects could be made in these sizes when they were recorded.
        raise SimulationError(f"task {task.name!r}: {error}") from error
    return session.with_values(task=task_of_roles.model_copy(update={"starts": session.config.start_regions_in_world}))


def _make_scene_labels(session: Session, scene: CompiledScene) -> SceneLabels:
    config = session.config
    things = (*config.task.objects, *config.randomization.distractor_configs)
    names = [item.name for item in things]
    return make_scene_labels(scene.model, config.rig, names, boards=config.boards, cloths=scene.cloths)


MAX_SIMULATORS = 4  # each holds a compiled scene and, once used, a renderer

_RoleAssignmentKey = tuple[tuple[str, str, float], ...]


def sample_roles_for(session: Session, job: AttemptJob) -> RoleAssignment:
    """Return which objects play which roles in an attempt."""
    return sample_roles(session.config.task, job)


def make_simulator(session: Session, job: AttemptJob) -> Simulator:
    """Return a new simulator for the objects of an attempt."""
    roles = sample_roles_for(session, job)
    return Simulator(session_for_roles(session, roles), roles)


class SimulatorCache(Closable):
    """Makes simulators for the objects of attempts, and keeps the last `limit`."""

    def __init__(self, session: Session, limit: int = MAX_SIMULATORS) -> None:
        self.session, self._limit = session, limit
        self._simulators: OrderedDict[_RoleAssignmentKey, Simulator] = OrderedDict()
        self._tools = functools.cache(functools.partial(make_arm_ik_and_dynamics, session.config.rig))

    def get(self, job: AttemptJob) -> Simulator:
        """Return the simulator of an attempt; valid until the next call."""
        roles = sample_roles_for(self.session, job)
        key = tuple((name, roles.config_names[name], roles.scale_factors.get(name, 1.0)) for name in roles.config_names)
        if key in self._simulators:
            self._simulators.move_to_end(key)
            return self._simulators[key]
        while len(self._simulators) >= self._limit:
            self._simulators.popitem(last=False)[1].close()
        made = self._simulators[key] = Simulator(session_for_roles(self.session, roles), roles, self._tools)
        return made

    def close(self) -> None:
        """Free all renderers."""
        while self._simulators:
            self._simulators.popitem()[1].close()


def open_episode(
    simulator: Simulator,
    attempt: Attempt,
    rules: EpisodeRules,
    on_step: PhysicsStepCallback | None = None,
    *,
    own_model: bool = False,
) -> Episode:
    """Return the episode of an attempt at its start.

    With `own_model`, the episode has a copy of the model, so that other episodes of the simulator can run meanwhile.
    """
    assert attempt.start is not None, "an attempt without a layout has no episode"
    task = simulator.config.task
    goal = EpisodeGoal(task.goal, simulator.roles, task.hold_ticks)
    scene = simulator.apply_randomization(attempt)
    if own_model:
        scene = replace(scene, model=copy.copy(scene.model))
    return Episode(scene, attempt.start, task.timing, arm_sides(simulator.config), goal, rules, on_step=on_step)
