from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from yamsim_cli.core.errors import ResourceError, UsageError
from yamsim_cli.flags.session_options import Json, Margin, Offline, Revision, Rig, Robot, Seed, Task, session_opener
from yamsim_cli.flags.viewer_options import Host, Port, WebOrNative, choose_viewer, prepare_viewer
from yamsim_cli.terminal.console import print_result_now
from yamsim_cli.terminal.signals import defer_signals

if TYPE_CHECKING:
    from yamsim_cli.core.config.recording import RecordConfig
    from yamsim_cli.core.config.rendering import RenderConfig
    from yamsim_cli.core.config.rig import RigConfig
    from yamsim_cli.core.files.resources import Locations
    from yamsim_cli.viewers.viewed_scene import LiveRig
    from yamsim_cli.viewers.viewpoint import Viewpoint


def view(
    rig: Rig = None,
    revision: Revision = None,
    robot: Robot = None,
    margin: Margin = None,
    task: Task = None,
    seed: Seed = None,
    episode: Annotated[
        Path | None, typer.Option(help="A recorded episode, such as dataset/ep_000003, in place of a rig.")
    ] = None,
    web: WebOrNative = None,
    port: Port = None,
    host: Host = None,
    boards: Annotated[bool, typer.Option("--boards/--no-boards", help="Base boards and their mounts.")] = True,
    offline: Offline = False,
    json: Json = False,
) -> None:
    """Watch a rig in real time and move its joints, in MuJoCo's window or in a browser page. Ctrl-C ends the viewer.

    With --task, the objects have the layout of the seed's first attempt. --episode plays an episode like `replay`.

    Example: yamsim view --rig russet --web
    """
    given = {"--rig": rig, "--margin": margin, "--task": task, "--seed": seed, "--no-boards": None if boards else True}
    for flag, value in given.items():
        if episode is not None and value is not None:
            raise UsageError(f"{flag} is not for --episode, which shows the rig and the task that were recorded")
    if seed is not None and task is None:
        raise UsageError(f"--seed {seed} determines the layout of a task; give --task with it")
    page = choose_viewer(web, port, host)
    where = session_opener.find_locations()
    if episode is not None:
        from yamsim_cli.core.dataset.reader import find_episode

        from .replay import play_episode

        play_episode(find_episode(episode, None), where, 1.0, page, json)
        return

    settings: RigConfig | RecordConfig
    if task is None:
        settings = session_opener.load_rig(rig or "single", where, margin, revision, robot)
    else:
        settings = session_opener.load_record_config(
            "default", where, rig=rig, revision=revision, robot=robot, margin=margin, task=task, seed=seed
        )
    pictures = page is not None and _can_render(where)
    prepare_viewer(page)

    from yamsim_cli.viewers.show.viewer import view_rig

    def announce_ready(url: str | None) -> None:
        line = f"{url}  (Ctrl-C ends)" if url else "MuJoCo's window: space pauses, backspace goes home"
        print_result_now({"url": url}, line, json)

    # A server or window that Ctrl-C interrupts during its start cannot be closed.
    with defer_signals() as stopped:
        live, viewpoint = _make_live_scene(settings, where, boards=boards or page is not None, pictures=pictures)
        view_rig(live, page, announce_ready, stopped, viewpoint, boards=boards, pictures=pictures)


def _can_render(locations: Locations) -> bool:
    try:
        session_opener.choose_gl_backend(locations)
    except ResourceError:
        return False
    return True


def _make_live_scene(
    settings: RigConfig | RecordConfig, locations: Locations, *, boards: bool, pictures: bool
) -> tuple[LiveRig, Viewpoint | None]:
    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.recording import RecordConfig
    from yamsim_cli.core.config.rendering import RenderConfig
    from yamsim_cli.core.config.rig import RigConfig
    from yamsim_cli.core.config.scene import SceneConfig
    from yamsim_cli.core.config.session import Session
    from yamsim_cli.core.scene.blueprint import Blueprint, task_blueprint
    from yamsim_cli.core.scene.compose import visual_mesh_sets
    from yamsim_cli.viewers.show.viewer import make_live_rig, make_live_task, task_viewpoint

    quality: RenderConfig | None = load_config(RenderConfig, "quality", "fast", locations) if pictures else None
    if isinstance(settings, RecordConfig):
        locations = session_opener.with_mesh_folders(locations, visual_mesh_sets(task_blueprint(settings)))
        return make_live_task(Session(settings, locations), boards=boards, quality=quality), task_viewpoint(settings)
    assert isinstance(settings, RigConfig)
    scene = load_config(SceneConfig, "scenes", "studio", locations)
    blueprint = Blueprint(settings, scene, boards=boards)
    return make_live_rig(
        blueprint, session_opener.with_mesh_folders(locations, visual_mesh_sets(blueprint)), quality
    ), None
