"""`yamsim draw`: render a dataset's stored states again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from yamsim_cli.core.errors import ConfigError, UsageError, count_noun
from yamsim_cli.flags import session_options as flags
from yamsim_cli.flags.output_files import ContinueDataset, RenameExisting, open_mode
from yamsim_cli.flags.session_options import session_opener
from yamsim_cli.session_opener import parse_camera_effects, parse_size
from yamsim_cli.terminal.console import note_moved, print_json, print_line, print_note, progress_bar
from yamsim_cli.terminal.signals import stop_on_signal

if TYPE_CHECKING:
    from yamsim_cli.core.config.recording import RecordConfig
    from yamsim_cli.core.config.rig import RigCamera
    from yamsim_cli.core.config.session import Session
    from yamsim_cli.core.files.resources import Locations
    from yamsim_cli.recording.draw_config import DrawChanges
    from yamsim_cli.recording.recorder import RecordReport

_STOPPING_NOTE = "Stopping once the current episodes are drawn. Another signal stops immediately; --resume continues."
_MAX_LOOKS = 99  # datasets of one command; more would be a mistake in the number


def draw(
    dataset: Annotated[Path, typer.Argument(help="The directory that `yamsim record` wrote.", show_default=False)],
    out: Annotated[Path, typer.Option(help="Directory of the drawn dataset.", show_default=False)],
    looks: Annotated[
        int,
        typer.Option(
            min=1,
            max=_MAX_LOOKS,
            help="With 2 or more: datasets look_1, look_2, ..., each with its own samples.",
        ),
    ] = 1,
    quality: flags.Quality = None,
    size: flags.Size = None,
    jpeg_quality: Annotated[int | None, typer.Option(min=1, max=100, help="JPEG quality.")] = None,
    camera: flags.Cameras = None,
    views: Annotated[
        int, typer.Option(min=0, max=100, help="Number of random cameras to add: view_00, view_01, ....")
    ] = 0,
    cameras: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Add the fixed cameras of a YAML file, in its list `cameras`.")
    ] = None,
    camera_effects: flags.CameraEffects = None,
    scene: Annotated[
        str | None,
        typer.Option(metavar="NAME|FILE", help="Surroundings: a name from configs/scenes/ or a YAML file, same table."),
    ] = None,
    rig: flags.Rig = None,
    revision: flags.Revision = None,
    randomize: flags.Randomize = None,
    randomization: flags.Randomization = None,
    boards: flags.Boards = None,
    truth: Annotated[
        bool | None, typer.Option("--truth/--no-truth", help="Also depth, segmentation, keypoints and boxes.")
    ] = None,
    workers: flags.Workers = None,
    resume: ContinueDataset = False,
    overwrite: RenameExisting = False,
    stage: flags.Stage = None,
    attempt_timeout: flags.AttemptTimeout = 600.0,
    offline: flags.Offline = False,
    json: flags.Json = False,
) -> None:
    """Render the stored states of a dataset again, with other images and the same physics.

    Example: yamsim draw dataset/ --out varied --looks 3 --randomize
    """
    mode = open_mode(resume=resume, overwrite=overwrite)
    if out.resolve() == dataset.resolve():
        raise UsageError(f"--out {out} is the dataset to draw, which draw does not change; give another directory")
    where = session_opener.find_locations()

    from yamsim_cli.core.dataset.dataset_paths import CONFIG_FILE
    from yamsim_cli.core.dataset.reader import read_recording_config
    from yamsim_cli.core.files.writing import sha256_bytes
    from yamsim_cli.recording.collect import RecordCallbacks
    from yamsim_cli.recording.draw import DrawSource, read_attempts
    from yamsim_cli.recording.draw import draw as run
    from yamsim_cli.recording.draw_config import draw_config, varies_in_looks
    from yamsim_cli.recording.recording_output import RecordingOutput

    source = read_recording_config(dataset, where)
    attempts = read_attempts(dataset)
    where = session_opener.choose_gl_backend(where, workers=True)
    changes = _read_changes(source, where, locals())
    digest = sha256_bytes((dataset / CONFIG_FILE).read_bytes())
    reports: list[RecordReport] = []
    for look in range(1, looks + 1):
        config = draw_config(source, digest, replace(changes, look=look) if looks > 1 else changes)
        if looks > 1 and not varies_in_looks(config, views):
            raise UsageError(f"--looks {looks}: all looks would be equal; add --randomize or --views")
        place = out / f"look_{look}" if looks > 1 else out
        keeps = config.randomization == source.randomization and config.look == source.look
        session = _open_session(config, where, place if resume else None)
        with progress_bar(f"drawing {place.name}", "episodes") as advance, stop_on_signal(_STOPPING_NOTE) as stop:
            callbacks = RecordCallbacks(lambda done, wanted, _: advance(done, wanted, ""), print_note)
            report = run(
                session,
                DrawSource(dataset, attempts, keeps),
                RecordingOutput(place, mode, stage),
                callbacks,
                stop,
                attempt_timeout,
            )
        note_moved(report.path, report.moved_aside)
        reports.append(report)
        if not json:
            print_line(f"{count_noun(report.episodes, 'episode')} drawn in {report.path} ({report.seconds:.1f} s)")
    if json:
        print_json({"datasets": [_report_data(report) for report in reports]})


def _report_data(report: RecordReport) -> dict[str, Any]:
    return {
        "path": str(report.path),
        "episodes": report.episodes,
        "seconds": round(report.seconds, 3),
        "moved_aside": str(report.moved_aside) if report.moved_aside else None,
    }


def _read_changes(source: RecordConfig, where: Locations, given: dict[str, Any]) -> DrawChanges:
    from yamsim_cli.camera_effects.config import CameraEffects
    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.randomization import RandomizationConfig
    from yamsim_cli.core.config.recording import CameraEffectsEntry
    from yamsim_cli.core.config.rendering import RenderConfig
    from yamsim_cli.core.config.scene import SceneConfig
    from yamsim_cli.recording.draw_config import DrawChanges

    values: dict[str, Any] = {key: given[key] for key in ("boards", "truth", "workers") if given.get(key) is not None}
    image = {"size_px": parse_size(given["size"]) if given["size"] else None, "jpeg_quality": given["jpeg_quality"]}
    values["image"] = source.image.model_copy(update={key: value for key, value in image.items() if value is not None})
    if given["quality"] is not None:
        values["render"] = load_config(RenderConfig, "quality", given["quality"], where)
    if given["scene"] is not None:
        values["scene"] = load_config(SceneConfig, "scenes", given["scene"], where)
    if given["rig"] is not None or given["revision"] is not None:
        values["rig"] = session_opener.load_rig(given["rig"] or source.rig.name, where, revision=given["revision"])
    if given["randomize"] is False and given["randomization"] is not None:
        raise UsageError("--randomization and --no-randomize contradict each other; leave one out")
    if given["randomize"] is False:
        values["randomization"] = RandomizationConfig()
    elif given["randomize"] or given["randomization"] is not None:
        name = given["randomization"] or "default"
        values["randomization"] = load_config(RandomizationConfig, "randomization", name, where)
    if given["camera_effects"]:
        values["camera_effects"] = tuple(
            CameraEffectsEntry(
                camera=entry["camera"],
                effects=load_config(CameraEffects, "camera_effects", str(entry["effects"]), where),
            )
            for entry in parse_camera_effects(given["camera_effects"])
        )
    return DrawChanges(
        values, given["camera"] or None, given["views"], _read_cameras(given["cameras"]) if given["cameras"] else ()
    )


def _read_cameras(file: Path) -> tuple[RigCamera, ...]:
    from pydantic import ValidationError

    from yamsim_cli.core.config.rig import RigCamera
    from yamsim_cli.core.files.documents.yaml_document import load_yaml

    listed = load_yaml(file).data.get("cameras")
    if not isinstance(listed, list) or not listed:
        raise ConfigError(f"{file}: cameras: missing; give a list of name, position, quat and fovy_deg")
    try:
        return tuple(RigCamera.model_validate(item) for item in listed)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        raise ConfigError(f"{file}: cameras: {'.'.join(map(str, first['loc']))}: {first['msg']}") from None


def _open_session(config: RecordConfig, where: Locations, resumed: Path | None) -> Session:
    from yamsim_cli.core.config.session import Session
    from yamsim_cli.core.dataset.writing.directory_claim import recorded_meshes

    meshes = recorded_meshes(resumed) if resumed else None
    return session_opener.with_scene_meshes(Session(config, where).with_values(meshes=meshes))
