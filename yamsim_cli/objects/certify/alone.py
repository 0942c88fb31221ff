"""A single thing on a table in front of one arm, and how the skill `pick` picks it up."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass

import numpy as np

from yamsim_cli.core.config.goals.cast import Cast
from yamsim_cli.core.config.goals.world import TABLE
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.pictures import RenderConfig
from yamsim_cli.core.config.program_task import PROGRAM, ProgramTask
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.config.things.thing import GraspPoint, ObjectConfig
from yamsim_cli.core.episode.commands import path_actions
from yamsim_cli.core.episode.episode import Episode
from yamsim_cli.core.episode.rules import EpisodeRules
from yamsim_cli.core.episode.sampling import no_start, sample
from yamsim_cli.core.episode.simulator import Simulator, open_episode
from yamsim_cli.core.expert.planning.arm_tools import start_stands
from yamsim_cli.core.expert.skills.base import Skill
from yamsim_cli.core.expert.skills.bench import Bench, SkillFailedError
from yamsim_cli.core.expert.skills.grips import friction_grips
from yamsim_cli.core.expert.skills.pick import Pick, Reach
from yamsim_cli.core.expert.skills.program import RecoveryLog, program_of, run_program
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.scene.compiled import CompiledScene
from yamsim_cli.core.scene.randomness import Stream, generator
from yamsim_cli.core.types import Cause, EpisodeJob

#: The rig whose hand picks things up.
RIG = "single_linear"

_THING = "thing"
_PLACE = (0.33, 0.15)  # m, in `world`: middle of the thing; well within reach, beside the hand's start
_HEADINGS = (0.0, 90.0)  # degrees, of the thing; the second is tried if `pick` fails with the first
_JOB = EpisodeJob(0, 0)  # the seed and number from which everything random follows


@dataclass(frozen=True)
class PickedGrasp:
    """The grasp of a thing that `pick` has lifted.

    Attributes:
        T_thing_in_pinch: the thing's pose (4, 4) in the hand's pinch frame.
        opening: commanded opening of each finger around the thing, m.
        force: of each finger, N.
    """

    T_thing_in_pinch: Array
    opening: float
    force: float


def simulate_pick(item: ObjectConfig, locations: Locations) -> PickedGrasp:
    """Run `pick` on a thing in physics, and return the resulting grasp.

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
    """Return the grasp points of a thing that `pick` can use, those with the least lean of the hand first.

    Nothing is simulated: a grasp point counts if in one of the headings the arm reaches it without contacts. A thing
    that one hand cannot lift has none.

    Args:
        locations: as of `simulate_pick`.

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
    """Return the least lean of a hand from straight down at an object's grasp points, in whole degrees.

    Returns:
        Infinity if the hand cannot use any of them.
    """
    pick, hand = Pick(thing=_THING), bench.hands[0]
    for grip in friction_grips(item):
        if isinstance(pick.reach(bench, hand, _THING, grip), Reach):
            return round(math.degrees(math.acos(np.clip(-grip.T_pinch_in_thing[2, 2], -1, 1))))
    return math.inf


@dataclass(frozen=True)
class _Setup:
    """A thing at rest on the table, with the engine, the bench and the program."""

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
    """Return the config of a recording whose program is `pick` alone."""
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
