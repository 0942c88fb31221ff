"""The simulator of attempts: everything that is expensive to make, once in a process."""

from __future__ import annotations

import functools
from collections import OrderedDict
from collections.abc import Callable

from ..closing import Closing
from ..config.goals.cast import Cast
from ..config.session import Session
from ..errors import SimulationError
from ..expert.planning.arm_tools import ArmTools, arm_tools
from ..rendering.labels import SceneLabels, scene_labels
from ..rendering.renderer import SceneRenderer
from ..scene.build import build_scene
from ..scene.casting import draw_cast
from ..scene.compiled import CompiledScene
from ..sim.placement import DistractorPlacer
from ..sim.replica import Replica
from ..types import Attempt, EpisodeJob
from .episode import Episode, EpisodeGoal, OnStep
from .expert import ExpertTools, sides
from .rules import EpisodeRules
from .varied_scene import VariedScene


class Simulator(Closing):
    """A session's compiled scene, and what is made from it on demand: replica, the expert's tools and renderer.

    A simulator keeps no state of attempts. Close it or use it as a context manager, since it may own a renderer.

    Args:
        session: its task has only the things of the cast.
        cast: which thing plays which role; by default the task's typical cast, whose things the session then gets.
        tools: gives the tools of the rig's arms, when the expert first needs them; by default they are made then.

    Attributes:
        session: the session.
        config: the session's config.
        cast: which thing plays which role.
        scene: the compiled scene. Its model has the variation of the last attempt given to `varied`.

    Raises:
        SimulationError: the scene cannot be compiled.
    """

    def __init__(
        self, session: Session, cast: Cast | None = None, tools: Callable[[], tuple[ArmTools, ...]] | None = None
    ) -> None:
        if cast is None:
            cast = session.config.task.typical_cast
            session = played_session(session, cast)
        self.session = session
        self.config = config = session.config
        self.cast = cast
        self._tools = tools or functools.partial(arm_tools, config.rig)
        self.scene = build_scene(session)
        # These are made from the scene before its first variation.
        self.labels: SceneLabels | None = _labels(session, self.scene) if config.truth else None
        self.placer = DistractorPlacer(config, self.scene) if config.randomization.distractors else None
        self.variations = VariedScene(config, self.scene)
        self._renderer: SceneRenderer | None = None

    def varied(self, attempt: Attempt) -> CompiledScene:
        """Return the scene with an attempt's variation; valid until the next call."""
        return self.variations.of(attempt)

    @functools.cached_property
    def replica(self) -> Replica:
        """A copy of the scene that takes on recorded states."""
        return Replica(self.scene)

    @functools.cached_property
    def expert_tools(self) -> ExpertTools:
        """The expert's planning tools; making them reads files."""
        return ExpertTools(self.config, self.scene, self._tools())

    def prepare(self) -> None:
        """Make now what reads files, in case the files are gone at the first attempt."""
        _ = self.expert_tools

    @property
    def renderer(self) -> SceneRenderer:
        """The renderer.

        Raises:
            ResourceError: no OpenGL context could be made.
        """
        if self._renderer is None:
            size = self.config.image.size_px
            self._renderer = SceneRenderer(self.scene.model, size, self.config.render.fine_size(size))
        return self._renderer

    def close(self) -> None:
        """Free the renderer."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None


def played_session(session: Session, cast: Cast) -> Session:
    """Return the session with only the things of a cast, and with start regions in `world`.

    Raises:
        SimulationError: a thing cannot be made in its size.
    """
    task = session.config.task
    try:
        played = task.played_by(cast)
    except ValueError as error:
        # A dataset's task: its things could be made in their sizes when it was recorded.
        raise SimulationError(f"task {task.name!r}: {error}") from error
    return session.with_values(task=played.model_copy(update={"starts": session.config.starts}))


def _labels(session: Session, scene: CompiledScene) -> SceneLabels:
    config = session.config
    things = (*config.task.objects, *config.randomization.extras)
    names = [item.name for item in things]
    return scene_labels(scene.model, config.rig, names, boards=config.boards, cloths=scene.cloths)


# count, simulators that are kept: each holds a compiled scene and, once used, a renderer
_MAX_SIMULATORS = 4

_Key = tuple[tuple[str, str, float], ...]


def cast_for(session: Session, job: EpisodeJob) -> Cast:
    """Return which thing plays which role in an attempt."""
    return draw_cast(session.config.task, job)


def simulator_for(session: Session, job: EpisodeJob) -> Simulator:
    """Return a new simulator for the things of an attempt.

    Raises:
        SimulationError: its scene cannot be compiled, or a thing cannot be made in its size.
    """
    cast = cast_for(session, job)
    return Simulator(played_session(session, cast), cast)


class Simulators(Closing):
    """Makes simulators and keeps the most recently used. Close it, or use it as a context manager."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self._simulators: OrderedDict[_Key, Simulator] = OrderedDict()
        self._tools = functools.cache(functools.partial(arm_tools, session.config.rig))

    def of(self, job: EpisodeJob) -> Simulator:
        """Return the simulator of an attempt; valid until the next call.

        Raises:
            SimulationError: its scene cannot be compiled.
        """
        cast = cast_for(self.session, job)
        key = tuple((name, cast.kinds[name], cast.sizes.get(name, 1.0)) for name in cast.kinds)
        if key in self._simulators:
            self._simulators.move_to_end(key)
            return self._simulators[key]
        while len(self._simulators) >= _MAX_SIMULATORS:
            self._simulators.popitem(last=False)[1].close()
        made = self._simulators[key] = Simulator(played_session(self.session, cast), cast, self._tools)
        return made

    def close(self) -> None:
        """Free all renderers."""
        while self._simulators:
            self._simulators.popitem()[1].close()


def open_episode(simulator: Simulator, attempt: Attempt, rules: EpisodeRules, on_step: OnStep | None = None) -> Episode:
    """Return the episode of an attempt at its start, in the attempt's varied scene.

    Args:
        on_step: see `Episode`.
    """
    assert attempt.start is not None, "an attempt without a layout has no episode"
    task = simulator.config.task
    goal = EpisodeGoal(task.goal, simulator.cast, task.hold_ticks)
    scene = simulator.varied(attempt)
    return Episode(scene, attempt.start, task.timing, sides(simulator.config), goal, rules, on_step=on_step)
