"""Simulate `pick` with one arm and a single object on a table."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass

import numpy as np

from yamsim_cli.core.attempt_data import AttemptJob, FailureCause
from yamsim_cli.core.config.goals.role_assignment import RoleAssignment
from yamsim_cli.core.config.goals.world import TABLE
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.objects.object_config import GraspPoint, ObjectConfig
from yamsim_cli.core.config.program_task import PROGRAM_KIND, ProgramTask
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.rendering import RenderConfig
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.config.scene import SceneConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.commands import path_actions
from yamsim_cli.core.episode.episode import Episode
from yamsim_cli.core.episode.episode_rules import EpisodeRules
from yamsim_cli.core.episode.sampling import describe_missing_start, sample_attempt
from yamsim_cli.core.episode.simulator import Simulator, open_episode
from yamsim_cli.core.expert.planning.arm_solvers import start_postures
from yamsim_cli.core.expert.skills.grasp_candidates import friction_candidates
from yamsim_cli.core.expert.skills.pick import Pick, ReachableGrasp
from yamsim_cli.core.expert.skills.planning_context import PlanningContext, SkillFailedError
from yamsim_cli.core.expert.skills.program import RecoveryLog, build_program, run_program
from yamsim_cli.core.expert.skills.skill import Skill
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.scene.compiled import CompiledScene
from yamsim_cli.core.scene.random_streams import Stream, random_generator

PICK_RIG = "single_linear"

_ROLE = "thing"
_POSITION = (0.33, 0.15)  # m, in `world`: within reach, beside the hand's start
_HEADINGS = (0.0, 90.0)  # degrees; the second if `pick` fails at the first
_FIXED_JOB = AttemptJob(0, 0)  # every run gives the same result


@dataclass(frozen=True)
class PickedGrasp:
    """The grasp by which `pick` has lifted an object.

    Attributes:
        T_thing_in_pinch: object pose (4, 4) in the pinch frame.
        opening: commanded, of each finger, m.
        force: of each finger, N.
    """

    T_thing_in_pinch: Array
    opening: float
    force: float


def simulate_pick(item: ObjectConfig, locations: Locations) -> PickedGrasp:
    """Run `pick` on an object in physics. `locations` include mesh folders for collision meshes.

    Raises:
        SkillFailedError: `pick` failed at each heading; the last error.
        SimulationError: the scene cannot be compiled.
    """
    *first, last = _HEADINGS
    for heading in first:
        with suppress(SkillFailedError):
            return _pick_at_heading(item, locations, heading)
    return _pick_at_heading(item, locations, last)


def reachable_grasp_points(item: ObjectConfig, locations: Locations) -> tuple[GraspPoint, ...]:
    """Return the grasp points that `pick` can use, least tilt of the hand first.

    The arm must reach a point without contacts at one of the headings; physics does not run. Fixed or articulated
    objects, and objects without a friction grasp, have none. `locations` include mesh folders for collision meshes.

    Raises:
        SkillFailedError: the table has no room for the object.
        SimulationError: the scene cannot be compiled.
    """
    if item.grasp is None or item.grasp.friction is None or item.links or item.base == "fixed":
        return ()
    points = item.grasp.friction.points
    leans = np.full(len(points), np.inf)
    for heading in _HEADINGS:
        with _pick_setup(item, locations, heading) as setup:
            leans = np.minimum(leans, [_min_tilt(setup.context, item.with_grasp_points((point,))) for point in points])
    return tuple(points[k] for k in np.argsort(leans, kind="stable") if np.isfinite(leans[k]))


def _min_tilt(context: PlanningContext, item: ObjectConfig) -> float:
    pick, hand = Pick(thing=_ROLE), context.hands[0]
    for candidate in friction_candidates(item):
        if isinstance(pick.find_reachable_grasp(context, hand, _ROLE, candidate), ReachableGrasp):
            return round(math.degrees(math.acos(np.clip(-candidate.T_pinch_in_thing[2, 2], -1, 1))))
    return math.inf


@dataclass(frozen=True)
class _PickSetup:
    scene: CompiledScene
    episode: Episode
    context: PlanningContext
    program: Sequence[Skill]
    roles: RoleAssignment


@contextmanager
def _pick_setup(item: ObjectConfig, locations: Locations, heading: float) -> Iterator[_PickSetup]:
    session = Session(_pick_config(item, locations, heading), locations)
    task = session.config.task
    with Simulator(session) as simulator:
        roles = simulator.roles
        attempt = sample_attempt(simulator, _FIXED_JOB)
        if attempt.start is None:
            raise SkillFailedError(FailureCause.NO_LAYOUT, describe_missing_start(simulator, attempt))
        episode = open_episode(simulator, attempt, EpisodeRules())
        postures, rng = list(start_postures(session.config)), random_generator(_FIXED_JOB, Stream.PLANNING)
        context = simulator.expert_planner.planning_context(episode.world, postures, rng)
        yield _PickSetup(simulator.scene, episode, context, build_program(task, roles), roles)


def _pick_at_heading(item: ObjectConfig, locations: Locations, heading: float) -> PickedGrasp:
    with _pick_setup(item, locations, heading) as setup:
        for segment in run_program(setup.program, setup.context, setup.roles, RecoveryLog()):
            setup.episode.run_commands(path_actions(setup.scene, segment.paths))
        hand = setup.context.hands[0]
        return PickedGrasp(setup.context.measure_held_object(hand).T_thing_in_pinch, hand.opening, hand.grip_force)


def _pick_config(item: ObjectConfig, locations: Locations, heading: float) -> RecordConfig:
    x, y = _POSITION
    task = ProgramTask.model_validate(
        {
            "name": "take",
            "kind": PROGRAM_KIND,
            "rig": PICK_RIG,
            "things": {_ROLE: {"of": (item,)}},
            "starts": {_ROLE: {"x": (x, x), "y": (y, y), "yaw_deg": (heading, heading)}},
            "phrasings": {"training": ("take it",)},
            "goal": {"all": [{"above": {"thing": _ROLE, "other": TABLE, "by": 0.03}}]},
            "expert": [{"pick": {"thing": _ROLE}}],
        }
    )
    return RecordConfig.model_validate(
        {
            "rig": load_config(RigConfig, "rigs", PICK_RIG, locations),
            "scene": load_config(SceneConfig, "scenes", "tabletop", locations),
            "task": task,
            "grasp": "contact",
            "seed": _FIXED_JOB.seed,
            "wrist": False,
            "image": {"size_px": (64, 48), "jpeg_quality": 85},
            "render": load_config(RenderConfig, "quality", "fast", locations),
        }
    )
