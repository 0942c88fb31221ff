"""yamsim's commands as Python functions.

Errors are subclasses of `yamsim_cli.core.errors.YamsimError`. Their messages are the same as on the command line, but
name keywords instead of flags.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from .kitchen_scenes import resolve_scene_task
from .objects.importing.name_resolution import import_if_file
from .session_opener import SessionOpener

if TYPE_CHECKING:
    from .core.dataset.reader import StoredEpisodes
    from .correction_record import Actor
    from .recording.recorder import RecordReport


def _keyword_label(setting: str) -> str:
    return f"{setting}="


# For Python programs: error messages name keywords, and warnings go to the logger `yamsim`.
API_SESSION_OPENER = SessionOpener(
    os.environ, logging.getLogger("yamsim").warning, _keyword_label, import_if_file, resolve_scene_task
)


def record(
    out: str | Path,
    episodes: int = 1,
    *,
    seed: int | None = None,
    workers: int | None = None,
    wrist: bool | None = None,
    size: tuple[int, int] | None = None,
    quality: str | None = None,
    rig: str | None = None,
    task: str | None = None,
    object: str | None = None,
    target: str | None = None,
    arm: str | None = None,
    grasp: str | None = None,
    config: str = "default",
    resume: bool = False,
) -> RecordReport:
    """Record successful episodes into a new dataset, byte for byte as `yamsim record` does with the same flags.

    Args:
        workers: number of processes to start; None records in this process. A script that starts processes must guard
            its main part by `if __name__ == "__main__"`.
        size: (width, height) of the images, px.
        resume: continue the dataset at `out`.
    """
    session = API_SESSION_OPENER.open(
        config,
        parallel=workers is not None,
        resumes=Path(out) if resume else None,
        n=episodes,
        seed=seed,
        workers=workers or 1,
        wrist=wrist,
        size=size,
        quality=quality,
        rig=rig,
        task=task,
        object=object,
        target=target,
        arm=arm,
        grasp=grasp,
    )

    from .core.dataset.writing.directory_claim import ExistingDatasetMode
    from .core.workers.stop_request import StopRequest
    from .recording.collect import RecordCallbacks
    from .recording.executor_factories import inline_executor, process_executor
    from .recording.recorder import record as run
    from .recording.recording_output import RecordingOutput

    output = RecordingOutput(Path(out), ExistingDatasetMode.RESUME if resume else ExistingDatasetMode.NEW)
    watch = RecordCallbacks(lambda *_: None, lambda text: None)
    executors = inline_executor if workers is None else process_executor
    return run(session, output, executors, watch, StopRequest())


def open_dataset(path: str | Path, *, selection: str | Path | None = None, who: Actor | None = None) -> StoredEpisodes:
    """Return the episodes of a dataset as a sequence, with `len`, indices, slices and iteration.

    Each episode has `record`, `frames()` and `image(camera, number)`. The list of episodes is read immediately, and the
    files of an episode on access.

    Args:
        selection: a selection file of `yamsim review`. Episodes that it drops are left out. Of a trimmed episode,
            `record.frames`, `frames()` and `image` are those of the kept part; timestamps are as recorded.
        who: keeps, in the same way, only the frames in which the expert acts, or the policy that `yamsim correct` ran.
            Demonstrations are the expert's.

    Raises:
        DatasetError: `path` has no dataset, the selection belongs to other episodes, or no frame is left.
        ConfigError: the selection is invalid.
    """
    from .core.dataset.reader import open_episodes

    episodes = open_episodes(Path(path))
    if selection is None and who is None:
        return episodes
    from .selection import apply_selection, open_selected, select_actor

    applied = None if selection is None else apply_selection(Path(path), Path(selection))
    if who is not None:
        applied = select_actor(Path(path), who, applied)
    assert applied is not None
    return open_selected(episodes, applied)


def evaluate(
    policy: str,
    n: int = 50,
    *,
    seed: int | None = None,
    workers: int | None = None,
    policy_args: Mapping[str, int | float | str] | None = None,
    policy_config: str | None = None,
    trained_on: str | Path | None = None,
    execute: int | None = None,
    ensemble: float | None = None,
    latency: str = "0ms",
    threshold: float | None = None,
    time_limit: float | None = None,
    policy_timeout: float = 30.0,
    trial_timeout: float = 600.0,
    compare: Sequence[str] = (),
    end: Literal["success", "actor"] = "success",
    grasp: str | None = None,
    randomize: bool | None = None,
    randomization: str | None = None,
    size: tuple[int, int] | None = None,
    quality: str | None = None,
    scene: str | None = None,
    task: str | None = None,
    object: str | None = None,
    target: str | None = None,
    rig: str | None = None,
    revision: str | None = None,
    robot: Sequence[str] = (),
    arm: str | None = None,
    config: str = "default",
) -> dict[str, Any]:
    """Evaluate a policy as `yamsim eval --json` does with the flags of the same names, and return the report.

    The function starts processes, so a script must guard its main part by `if __name__ == "__main__"`. Flags that write
    files have no keyword.

    Args:
        policy: such as `my_policy.py:MyPolicy`, see docs/policies.md.
        policy_args: keywords for the policy's class, as of `--policy-arg`.
        latency: simulated time until an answer acts, such as "80ms", or "measured".
        compare: other policies on the same starts, or reports `FILE.json`.
        size: (width, height) of the images, px.

    Returns:
        The data that `--json` prints, such as `stats` and `trials`.
    """
    from contextlib import nullcontext

    from .core.episode.episode_rules import EndRule
    from .policies.action_chunks import ChunkSettings, read_latency
    from .policies.evaluate.policy_choice import PolicyChoice
    from .policies.evaluate.run import evaluate_and_compare, open_evaluation_session

    chunking = ChunkSettings(execute, ensemble, read_latency(latency))
    choice = PolicyChoice(
        policy, Path.cwd(), policy_timeout, time_limit, EndRule(end), dict(policy_args or {}), policy_config, chunking
    )
    session, training = open_evaluation_session(
        API_SESSION_OPENER,
        config,
        choice,
        compare,
        None if trained_on is None else Path(trained_on),
        n=n,
        seed=seed,
        workers=workers,
        threshold=threshold,
        grasp=grasp,
        randomize=randomize,
        randomization=randomization,
        size=size,
        quality=quality,
        scene=scene,
        task=task,
        object=object,
        target=target,
        rig=rig,
        revision=revision,
        robot=list(robot),
        arm=arm,
    )
    found = evaluate_and_compare(
        session,
        choice,
        compare,
        trial_timeout,
        training,
        lambda: nullcontext(lambda done, total: None),
        API_SESSION_OPENER.notify,
    )
    return found.report
