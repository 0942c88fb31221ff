"""A thing alone on a table before one arm, and how the skill `pick` takes it from there."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass

import numpy as np

from ..config.loader import load_config
from ..config.pictures import RenderConfig
from ..config.program_task import PROGRAM, ProgramTask
from ..config.recording import RecordConfig
from ..config.rig import RigConfig
from ..config.scene import SceneConfig
from ..config.things.thing import GraspPoint, ObjectConfig
from ..episode.commands import path_actions
from ..episode.episode import Episode
from ..episode.rules import EpisodeRules
from ..geometry.se3 import Array
from ..goals.cast import Cast
from ..goals.world import TABLE
from ..planning.arm_tools import start_stands
from ..resources import Locations
from ..scene.compiled import CompiledScene
from ..session import Session
from ..skills.base import Skill
from ..skills.bench import Bench, SkillFailedError
from ..skills.grips import friction_grips
from ..skills.pick import Pick, Reach
from ..skills.program import RecoveryLog, program_of, run_program
from ..tasks.randomness import Stream, generator
from ..types import Cause, EpisodeJob
from .sampling import no_start, sample
from .simulator import Simulator, open_episode

#: The rig whose hand takes things.
RIG = "single_linear"

_THING = "thing"
_PLACE = (0.33, 0.15)  # m, in `world`: where the middle of the thing lies, well in reach, beside the hand at its start
_HEADINGS = (0.0, 90.0)  # degrees, of the thing; the second is tried where `pick` fails in the first
_JOB = EpisodeJob(0, 0)


@dataclass(frozen=True)
class PickedGrasp:
    """How `pick` holds a thing that it has lifted.

    Attributes:
        T_thing_in_pinch: the thing's pose (4, 4) in the hand's pinch frame.
        opening: of each finger around the thing, as the skill commands it, m.
        force: with which each finger presses, N.
    """

    T_thing_in_pinch: Array
    opening: float
    force: float


def take(item: ObjectConfig, locations: Locations) -> PickedGrasp:
    """Let `pick` lift a thing from the table in physics, and return how the hand holds it then.

    Args:
        locations: with the folders of the thing's meshes, if it collides by meshes.

    Raises:
        SkillFailedError: `pick` failed in each heading of the thing; the error is that of the last one.
        SimulationError: the scene cannot be compiled.
    """
    *first, last = _HEADINGS
    for heading in first:
        with suppress(SkillFailedError):
            return _pick_at_heading(item, locations, heading)
    return _pick_at_heading(item, locations, last)


def reachable_places(item: ObjectConfig, locations: Locations) -> tuple[GraspPoint, ...]:
    """The places of a thing's friction grasp that `pick` can take, those with the least lean of the hand first.

    Nothing moves: a place counts if in one of the headings the arm reaches it, and touches nothing on its way. A thing
    that is not for one hand to lift has none.

    Args:
        locations: as of `take`.

    Raises:
        SkillFailedError: the thing has no room on the table.
        SimulationError: the scene cannot be compiled.
    """
    if item.grasp is None or item.grasp.friction is None or item.links or item.base == "fixed":
        return ()
    points = item.grasp.friction.points
    leans = np.full(len(points), np.inf)
    for heading in _HEADINGS:
        with _set_up(item, locations, heading) as setup:
            leans = np.minimum(leans, [_least_lean(setup.bench, item.with_places((point,))) for point in points])
    return tuple(points[k] for k in np.argsort(leans, kind="stable") if np.isfinite(leans[k]))


def _least_lean(bench: Bench, item: ObjectConfig) -> float:
    """How far the hand leans from straight down where it takes a thing by its config's places, in whole degrees.

    Returns:
        Infinity where it cannot take the thing by any of them.
    """
    pick, hand = Pick(thing=_THING), bench.hands[0]
    for grip in friction_grips(item):
        if isinstance(pick.reach(bench, hand, _THING, grip), Reach):
            return round(math.degrees(math.acos(np.clip(-grip.T_pinch_in_thing[2, 2], -1, 1))))
    return math.inf


@dataclass(frozen=True)
class _Setup:
    """A thing at rest on the table: what acts, what skills plan with, and who is who."""

    scene: CompiledScene
    episode: Episode
    bench: Bench
    program: Sequence[Skill]
    cast: Cast


@contextmanager
def _set_up(item: ObjectConfig, locations: Locations, heading: float) -> Iterator[_Setup]:
    session = Session(_config(item, locations, heading), locations)
    task = session.config.task
    with Simulator(session) as simulator:
        cast = simulator.cast
        attempt = sample(simulator, _JOB)
        if attempt.start is None:
            raise SkillFailedError(Cause.NO_LAYOUT, no_start(simulator, attempt))
        episode = open_episode(simulator, attempt, EpisodeRules())
        stands, rng = list(start_stands(session.config)), generator(_JOB, Stream.SEARCH)
        bench = simulator.expert_tools.bench(episode.world, stands, rng)
        yield _Setup(simulator.scene, episode, bench, program_of(task, cast), cast)


def _pick_at_heading(item: ObjectConfig, locations: Locations, heading: float) -> PickedGrasp:
    with _set_up(item, locations, heading) as setup:
        for segment in run_program(setup.program, setup.bench, setup.cast, RecoveryLog()):
            setup.episode.act(path_actions(setup.scene, segment.paths))
        hand = setup.bench.hands[0]
        return PickedGrasp(setup.bench.update_held(hand).T_thing_in_pinch, hand.opening, hand.grip)


def _config(item: ObjectConfig, locations: Locations, heading: float) -> RecordConfig:
    """A recording of nothing but `pick`."""
    x, y = _PLACE
    task = ProgramTask.model_validate(
        {
            "name": "take",
            "kind": PROGRAM,
            "rig": RIG,
            "things": {_THING: {"of": (item,)}},
            "starts": {_THING: {"x": (x, x), "y": (y, y), "yaw_deg": (heading, heading)}},
            "phrasings": {"training": ("take it",)},
            "goal": {"all": [{"above": {"thing": _THING, "other": TABLE, "by": 0.03}}]},
            "expert": [{"pick": {"thing": _THING}}],
        }
    )
    return RecordConfig.model_validate(
        {
            "rig": load_config(RigConfig, "rigs", RIG, locations),
            "scene": load_config(SceneConfig, "scenes", "tabletop", locations),
            "task": task,
            "grasp": "contact",
            "seed": _JOB.seed,
            "wrist": False,
            "image": {"size_px": (64, 48), "jpeg_quality": 85},
            "render": load_config(RenderConfig, "quality", "fast", locations),
        }
    )
