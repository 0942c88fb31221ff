"""Evaluate a policy and the policies to compare: shared code of the command `eval` and the function `evaluate`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from yamsim_cli.camera_rendering import require_fixed_plates
from yamsim_cli.core.config.recording import SCENE_CAMERA, RecordConfig
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.progress import Progress
from yamsim_cli.core.scene.build import with_mesh_descriptions
from yamsim_cli.core.statistics import THRESHOLDS
from yamsim_cli.session_opener import SessionOpener
from yamsim_cli.trials import trial_settings

from ..policy_loading import may_read_images
from .compare import compare_reports, compare_with_others, read_compared_reports, read_report
from .evaluation import Evaluation, evaluate, evaluation_report
from .policy_choice import PolicyChoice
from .training_settings import TrainingSettings, find_training_settings


@dataclass(frozen=True)
class ComparedEvaluation:
    """An evaluation with its report, which has `compared`, and the reports of the policies it was compared with."""

    evaluation: Evaluation
    report: dict[str, Any]
    others: list[dict[str, Any]]


def open_evaluation_session(
    opener: SessionOpener,
    config: str,
    choice: PolicyChoice,
    others: Sequence[str],
    trained_on: Path | None,
    *,
    renders: bool = False,
    **given: Any,
) -> tuple[Session, TrainingSettings | None]:
    """Open the session of trials, with image size and quality of the training dataset unless they are given.

    Args:
        others: policies to compare with, and reports `FILE.json`.
        trained_on: training dataset; None to look for it in the policy's config or checkpoint.
        renders: whether images are needed even if no policy reads any.
        given: settings of `SessionOpener.load_record_config`.
    """
    training = find_training_settings(choice.name, trained_on, choice.mapping, opener.find_locations(), choice.folder)
    if training is not None:
        given |= training.defaults(given.get("size"), given.get("quality"))
    renders = renders or any(may_read_images(name) for name in (choice.name, *others))
    session = opener.open(config, renders=renders, wrist=True, **given)
    require_fixed_plates(session.config)
    if training is not None and training.meshes and renders:
        session = with_mesh_descriptions(session)
    if training is not None and (warning := training.warning(session.config)):
        opener.notify(warning)
    return session, training


def evaluate_and_compare(
    session: Session,
    choice: PolicyChoice,
    others: Sequence[str],
    trial_seconds: float,
    training: TrainingSettings | None,
    watch: Callable[[], AbstractContextManager[Progress]],
    notify: Callable[[str], None],
) -> ComparedEvaluation:
    """Evaluate a policy, and compare it with `others`: policies, or reports `FILE.json` of the same trials.

    Args:
        trial_seconds: real time after which a trial's worker counts as hung, s.
        watch: returns a progress display for the trials of one policy.
        notify: shows the warning of `scene_camera_warning`.

    Raises:
        UsageError: a report is unreadable, or has other trials. It is raised before any trial runs.
    """
    known = read_compared_reports(others, trial_settings(session.config))

    def run(one: PolicyChoice) -> tuple[Evaluation, dict[str, Any]]:
        with watch() as progress:
            found = evaluate(session, one, progress, trial_seconds)
        if warning := scene_camera_warning(found, session.config, training if one is choice else None):
            notify(warning)
        return found, evaluation_report(found, session.config, THRESHOLDS)

    evaluation, report = run(choice)
    report["settings"]["trained_on"] = training and {
        "dataset": training.source,
        "differences": {key: list(pair) for key, pair in training.differences(session.config).items()},
    }
    found = compare_with_others(report, others, known, lambda name: run(choice.compared_with(name))[1])
    return ComparedEvaluation(evaluation, report, found)


def scene_camera_warning(evaluation: Evaluation, config: RecordConfig, training: TrainingSettings | None) -> str | None:
    """Return a sentence if a policy has read the scene's camera, which recordings of the rig lack; else None.

    There is none if the training dataset has the scene's camera, or does not name its cameras.
    """
    own = config.recorded_cameras
    if not config.rig.cameras or SCENE_CAMERA in own:
        return None
    if training is not None and (training.cameras is None or SCENE_CAMERA in training.cameras):
        return None
    if not any(SCENE_CAMERA in result.read_cameras for result in evaluation.results):
        return None
    return (
        f"{evaluation.choice.name} reads the image 'scene', which recordings of rig {config.rig.name!r} do not have; "
        f"their cameras: {', '.join(own)}. Request these images if the policy was trained on such recordings."
    )


def compare_report_files(names: Sequence[str]) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return the first report `FILE.json` with `compared`, and the other reports."""
    first, *others = (read_report(Path(name)) for name in names)
    pairs = zip(others, names[1:], strict=True)
    return first | {"compared": [compare_reports(first, other, name) for other, name in pairs]}, others
