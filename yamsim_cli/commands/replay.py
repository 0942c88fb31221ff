from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from yamsim_cli.core.errors import DatasetError, UsageError
from yamsim_cli.flags.output_files import RenameExisting
from yamsim_cli.flags.selection_file import SelectionFile
from yamsim_cli.flags.session_options import Json, Offline, session_opener
from yamsim_cli.flags.viewer_options import Host, Port, WebOrNative, choose_viewer, prepare_viewer
from yamsim_cli.session_opener import parse_size
from yamsim_cli.terminal.console import note_moved, print_json, print_line, print_note, print_result_now
from yamsim_cli.terminal.signals import defer_signals

if TYPE_CHECKING:
    from yamsim_cli.core.config.session import Session
    from yamsim_cli.core.dataset.reader import RecordedEpisode, StoredEpisode
    from yamsim_cli.core.files.resources import Locations
    from yamsim_cli.viewers.page_address import PageAddress

# For an episode whose actions cannot be simulated again.
_UNREPRODUCIBLE_RESULT: dict[str, Any] = {"max_error": None, "first_divergence": None}


def replay(
    episode: Annotated[Path, typer.Argument(help="An episode, such as dataset/ep_000003.", show_default=False)],
    number: Annotated[
        int | None, typer.Option("--episode", min=0, help="The episode's number, if a dataset is given.")
    ] = None,
    video: Annotated[Path | None, typer.Option(metavar="FILE.mp4", help="Write an H.264 video instead.")] = None,
    camera: Annotated[
        list[str] | None,
        typer.Option(help="Camera of the video; may be repeated: images are side by side.  [default: the first]"),
    ] = None,
    selection: SelectionFile = None,
    render: Annotated[bool, typer.Option("--render", help="Render the video anew from recorded states.")] = False,
    size: Annotated[str | None, typer.Option(metavar="WxH", help="With --render: size of each image.")] = None,
    speed: Annotated[float, typer.Option(help="Playback speed; 0.5 is slow motion.")] = 1.0,
    overwrite: RenameExisting = False,
    web: WebOrNative = None,
    port: Port = None,
    host: Host = None,
    offline: Offline = False,
    json: Json = False,
) -> None:
    """Play a recorded episode in a viewer, or write a video. Also repeat its actions in physics, and compare states.

    --selection refuses a dropped episode, and shows only the kept frames. Physics repeats the whole episode.

    Example: yamsim replay dataset/ep_000003 --video ep3.mp4
    """
    for_video = {"--camera": camera, "--render": render, "--size": size, "--overwrite": overwrite}
    for_viewer = {"--web or --native": web is not None, "--port": port is not None, "--host": host is not None}
    for flag, given in (for_video if video is None else for_viewer).items():
        if given:
            raise UsageError(f"{flag} is for {'a video: give' if video is None else 'the viewer: leave out'} --video")
    if size and not render:
        raise UsageError(f"--size {size}: recorded images have their own size; give --render to render them again")
    if not 0.01 <= speed <= 1000:
        raise UsageError(f"--speed {speed:g} is not valid: it must lie in 0.01..1000")

    from yamsim_cli.core.dataset.reader import StoredEpisode, find_episode

    stored, where = find_episode(episode, number), session_opener.find_locations()
    if render and not isinstance(stored, StoredEpisode):
        raise UsageError("--render: a real recording was not simulated; leave --render out to show its pictures")
    shown = _trim(stored, selection) if selection else stored
    if video is None:
        play_episode(shown, where, speed, choose_viewer(web, port, host), json)
        return
    pixels = parse_size(size) if size else None
    report = _film_episode(shown, where, video, camera or [], render, pixels, speed, overwrite)
    report |= _repeat_in_physics(stored, where) if isinstance(stored, StoredEpisode) else _UNREPRODUCIBLE_RESULT
    if json:
        print_json(report)
        return
    frames = f"{report['frames']} frames, {report['seconds']:.2f} s, {'x'.join(map(str, report['size']))}"
    print_line(f"{report['video']}: {frames}, {', '.join(report['cameras'])}")
    _print_physics(report)


def _trim(stored: RecordedEpisode, file: Path) -> RecordedEpisode:
    """Return an episode with its kept frames. Raise UsageError if the selection leaves it out."""
    from yamsim_cli.selection import apply_selection

    applied = apply_selection(stored.dataset_directory, file)
    if stored.record.episode not in applied.kept:
        raise UsageError(f"{stored.directory} is left out by --selection {file}; leave --selection out to see it")
    return applied.trim(stored)


def _film_episode(
    stored: RecordedEpisode,
    locations: Locations,
    video: Path,
    cameras: list[str],
    render: bool,
    size: tuple[int, int] | None,
    speed: float,
    overwrite: bool,
) -> dict[str, Any]:
    if render:
        session_opener.choose_gl_backend(locations)
    else:
        session_opener.disable_gl()
    period = stored.record.frame_period_s / speed

    from yamsim_cli.core.dataset.reader import StoredEpisode
    from yamsim_cli.viewers.show.replay import film_recorded, film_rendered, session_with_wrist_camera

    if render and isinstance(stored, StoredEpisode):
        session = session_opener.with_scene_meshes(session_with_wrist_camera(_dataset_session(stored, locations), size))
        film = film_rendered(stored, session, cameras, video, period, overwrite=overwrite)
    else:
        film = film_recorded(stored, cameras, video, period, overwrite=overwrite)
    note_moved(video, film.moved_aside)
    return {
        "episode": str(stored.directory),
        "video": str(film.path),
        "frames": film.frames,
        "seconds": round(film.seconds, 6),
        "size": list(film.size),
        "cameras": list(film.cameras),
        "rendered": render,
        "moved_aside": str(film.moved_aside) if film.moved_aside else None,
    }


def play_episode(
    stored: RecordedEpisode, locations: Locations, speed: float, page: PageAddress | None, json: bool
) -> None:
    """Play an episode on a page, or in MuJoCo's window if `page` is None. A real recording shows only its arms."""
    prepare_viewer(page)
    from yamsim_cli.core.dataset.reader import StoredEpisode, open_episode
    from yamsim_cli.viewers.show.replay import play_real, play_simulated

    physics = _UNREPRODUCIBLE_RESULT

    def announce_ready(url: str | None) -> None:
        line = f"{url}  (Ctrl-C ends)" if url else "MuJoCo's window: space pauses"
        print_result_now({"episode": str(stored.directory), "url": url} | physics, line, json)
        if not json:
            _print_physics(physics)
            sys.stdout.flush()

    if isinstance(stored, StoredEpisode):
        session = session_opener.with_scene_meshes(_dataset_session(stored, locations))
        # A server or window that Ctrl-C interrupts during its start cannot be closed.
        with defer_signals() as stopped:
            physics = _repeat_in_physics(open_episode(stored.directory), locations)
            play_simulated(stored, session, speed, page, announce_ready, stopped)
        return
    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.scene import SceneConfig
    from yamsim_cli.core.dataset.imported_records import read_imported_config
    from yamsim_cli.core.scene.blueprint import Blueprint
    from yamsim_cli.core.scene.compose import visual_mesh_sets
    from yamsim_cli.real.recordings.motion_reading import read_episode

    blueprint = Blueprint(
        read_imported_config(stored.dataset_directory, locations).rig,
        load_config(SceneConfig, "scenes", "studio", locations),
    )
    motion = read_episode(stored, blueprint.rig)
    locations = session_opener.with_mesh_folders(locations, visual_mesh_sets(blueprint))
    with defer_signals() as stopped:
        play_real(stored, motion, blueprint, locations, speed, page, announce_ready, stopped)


def _dataset_session(stored: StoredEpisode, locations: Locations) -> Session:
    from yamsim_cli.core.config.session import Session
    from yamsim_cli.core.dataset.reader import read_recording_config

    return Session(read_recording_config(stored.dataset_directory, locations), locations)


def _repeat_in_physics(stored: StoredEpisode, locations: Locations) -> dict[str, Any]:
    """Return largest error and first difference, or None for both if the actions cannot be simulated."""
    from yamsim_cli.datasets.verify import reproduce_episode

    try:
        found = reproduce_episode(stored, _dataset_session(stored, locations))
    except DatasetError as error:
        print_note(f"Its actions were not simulated again: {error}.")
        found = None
    if found is None:
        return dict(_UNREPRODUCIBLE_RESULT)
    return {"max_error": found.max_error, "first_divergence": found.first_difference and asdict(found.first_difference)}


def _print_physics(report: dict[str, Any]) -> None:
    if (first := report["first_divergence"]) is not None:
        since = "" if first["frame"] is None else f", first {first['quantity']} of frame {first['frame']}"
        print_note(
            f"Simulating its actions again gives states up to {report['max_error']:.3g} away from the recorded "
            f"ones{since}."
        )
    elif report["max_error"] is not None:
        print_line("simulating its actions again gives the same states, bit for bit")
