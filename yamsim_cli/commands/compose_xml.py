from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from yamsim_cli.core.errors import UsageError
from yamsim_cli.flags.output_files import RenameExisting
from yamsim_cli.flags.session_options import Grasp, Json, Margin, Offline, Revision, Rig, Robot, session_opener
from yamsim_cli.terminal.console import note_moved, print_json, print_line


def compose_xml(
    rig: Rig = None,
    revision: Revision = None,
    robot: Robot = None,
    out: Annotated[Path, typer.Option(help="Folder to create, or file with --zip.")] = Path("scene"),
    margin: Margin = None,
    boards: Annotated[bool, typer.Option("--boards/--no-boards", help="Base boards and their mounts.")] = True,
    background: Annotated[
        bool, typer.Option("--background/--no-background", help="Sky, floor and lights; a task's table stays.")
    ] = True,
    task: Annotated[str | None, typer.Option(help="Task whose table and objects are added, such as pickplace.")] = None,
    seed: Annotated[int, typer.Option(help="Seed for the poses of the task's objects.")] = 0,
    grasp: Grasp = None,
    mujoco: Annotated[
        Literal["3.3", "4"],
        typer.Option(
            help="Oldest MuJoCo that can read the scene. dm_control reads 3.3, which lacks the shadow settings of 4."
        ),
    ] = "3.3",
    as_zip: Annotated[bool, typer.Option("--zip", help="One zip file instead of a folder.")] = False,
    overwrite: RenameExisting = False,
    offline: Offline = False,
    json: Json = False,
) -> None:
    """Write scene.xml with all its meshes and textures, for plain MuJoCo 3.3 or newer on any machine.

    Example: yamsim compose-xml --rig russet --out russet_scene
    """
    if grasp is not None and task is None:
        raise UsageError("--grasp needs --task; give --task, or leave --grasp out")
    where = session_opener.find_locations()
    session_opener.disable_gl()

    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.scene import SceneConfig
    from yamsim_cli.core.config.session import Session
    from yamsim_cli.core.scene.blueprint import Blueprint, task_blueprint
    from yamsim_cli.core.scene.compose import visual_mesh_sets
    from yamsim_cli.viewers.show.compose import compose_at_home, first_attempt_start, write_scene

    if task is None:
        scene, home = load_config(SceneConfig, "scenes", "studio", where), None
        blueprint = Blueprint(
            session_opener.load_rig(rig or "single", where, margin, revision, robot),
            scene,
            boards=boards,
            background=background,
        )
    else:
        config = session_opener.load_record_config(
            "default", where, rig=rig, revision=revision, robot=robot, margin=margin, task=task, seed=seed, grasp=grasp
        )
        config, home = first_attempt_start(Session(config, where))
        blueprint = task_blueprint(config, boards=boards, background=background)
    where = session_opener.with_mesh_folders(where, visual_mesh_sets(blueprint))
    spec, model = compose_at_home(blueprint, where, home)
    target = out.with_name(f"{out.name}.zip") if as_zip and out.suffix != ".zip" else out
    report = write_scene(spec, model, target, as_zip=as_zip, overwrite=overwrite, reader=mujoco)
    note_moved(target, report.moved_aside)
    if json:
        print_json(
            {
                "path": str(report.path),
                "files": list(report.files),
                "nq": report.nq,
                "nu": report.nu,
                "bodies": list(report.bodies),
            }
        )
    else:
        print_line(f"{report.path}: {len(report.files)} files, nq {report.nq}, nu {report.nu}")
