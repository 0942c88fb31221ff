"""Sample an attempt: everything random in it, from its two numbers, before anything is planned or moves."""

from __future__ import annotations

from dataclasses import replace

from ..config.recording import RecordConfig
from ..planning.demonstration import start_stands
from ..tasks.kinds import sample_layout
from ..tasks.sampled_variation import sample_variation
from ..types import Attempt, EpisodeJob, Stand
from ..variation import Variation
from .programs import sample_program
from .simulator import Simulator


def sample(simulator: Simulator, job: EpisodeJob) -> Attempt:
    """The attempt of a seed and a number; its distractors come later, see `distractors`."""
    config, scene = simulator.config, simulator.scene
    variation = _variation(config, job)
    if config.program:
        return sample_program(simulator, job, variation)
    layout = sample_layout(config, job)
    if layout is None:
        return Attempt(job, None, variation)
    return Attempt(job, layout, variation, scene.start_qpos(layout, _start_stands(simulator)))


def _variation(config: RecordConfig, job: EpisodeJob) -> Variation:
    if not config.randomization.parts:
        return Variation()
    dofs = [config.rig.arms[number].robot.dof for number in config.rig.recorded]
    return sample_variation(config.randomization, job, len(config.scene.lights), config.task.objects, dofs)


def _start_stands(simulator: Simulator) -> list[Stand]:
    """Where the scene's arms stand at the start.

    The fingers of the arms that act are as wide open as a plan has them, if it takes the object where that is best
    held.
    """
    config, scene = simulator.config, simulator.scene
    stands, opening = list(start_stands(config)), simulator.kind.start_opening(config)
    for number in config.acting_scene_arms:
        fingers = scene.arms[number].fingers
        assert fingers is not None  # checked when the config was loaded
        stands[number] = replace(stands[number], opening=min(opening, fingers.stops[1]))
    return stands
