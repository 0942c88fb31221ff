"""Flags for rigs, tasks and sessions, and the object that opens sessions."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from yamsim_cli.kitchen_scenes import resolve_scene_task
from yamsim_cli.objects.importing.name_resolution import import_if_file
from yamsim_cli.session_opener import SessionOpener
from yamsim_cli.terminal.console import note_at_end, print_note
from yamsim_cli.terminal.fetch_bar import fetch_bar

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else.")]
_RIG = typer.Option(
    "--rig", help="Rig: a name from configs/rigs/, ROBOT+GRIPPER such as yam_pro+linear_4310, or a YAML file."
)
Rig = Annotated[str | None, _RIG]
RigName = Annotated[str, _RIG]
Revision = Annotated[
    str | None, typer.Option(help="Revision of the robots, in place of the rig's; see `yamsim robots list`.")
]
Robot = Annotated[
    list[str] | None,
    typer.Option(
        metavar="FILE",
        help="Measured dynamics of your arm, as `yamsim identify` writes them: for all arms of that model. May be "
        "repeated.",
    ),
]
Margin = Annotated[float | None, typer.Option(help="Distance between the arms, m, in place of the rig's.")]
StationCalibration = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR|FILE|FILE:CAMERA",
        help="A calibration of `yamsim calibrate`: its camera, bases, joint offsets and delay replace boards and "
        "recorded poses.",
    ),
]
ConfigOption = Annotated[
    str,
    typer.Option("--config", metavar="NAME|FILE", help="Record config: a name from configs/record/ or a YAML file."),
]
Cameras = Annotated[
    list[str] | None,
    typer.Option("--camera", metavar="NAME", help="A camera to record; may be repeated."),
]
CameraEffects = Annotated[
    list[str] | None,
    typer.Option(
        "--camera-effects",
        metavar="[CAMERA=]NAME|FILE",
        help="Lens, noise and shutter of a camera, or of all: a name from configs/camera_effects/ or a YAML file. May "
        "be repeated.",
    ),
]
Task = Annotated[str | None, typer.Option(help="Task: a name from configs/tasks/ or a YAML file.")]
Object = Annotated[
    str | None,
    typer.Option(
        "--object", metavar="NAME|FILE", help="Object to pick up: a name from configs/objects/ or a YAML file."
    ),
]
Target = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|FILE", help="Target onto or into which the object is put: a name or file, as for --object."
    ),
]
Scene = Annotated[
    str | None,
    typer.Option(metavar="NAME|FILE", help="Surroundings: a name from configs/scenes/ or a YAML file."),
]
Grasp = Annotated[
    str | None,
    typer.Option(
        metavar="weld|contact",
        help="What holds the object: a weld that is switched on, or friction alone, which needs a gripper with pads "
        "(--rig single_linear).  [default: weld]",
    ),
]
Arm = Annotated[
    str | None,
    typer.Option(metavar="left|right", help="The acting arm of a rig with two arms.  [default: right]"),
]
Seed = Annotated[int | None, typer.Option(help="Seed of all random samples.")]
Workers = Annotated[int | None, typer.Option(help="Number of worker processes. The data do not depend on it.")]
Threshold = Annotated[
    float | None,
    typer.Option(
        help="Largest distance from the target's centre that counts as a success, m.  [default: the task's, 0.05]"
    ),
]
Wrist = Annotated[bool | None, typer.Option("--wrist/--no-wrist", help="Also record the wrist camera.")]
Randomize = Annotated[
    bool | None,
    typer.Option("--randomize/--no-randomize", help="Vary lights, camera, appearance, masses, and more."),
]
Randomization = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Ranges of variation: name from configs/randomization/ or a YAML file; `arms` has delays, noise, encoder "
        "steps and errors of the gravity compensation.  [default: with --randomize, `default`]",
    ),
]
Disturb = Annotated[
    bool,
    typer.Option(
        "--disturb",
        help="Disturb the expert by noise on its commands, pushed objects and late grasps, from which it recovers. The "
        "key `disturb` of the config has the ranges.",
    ),
]
Size = Annotated[str | None, typer.Option(metavar="WxH", help="Image size in pixels.")]
JpegQuality = Annotated[int | None, typer.Option(help="JPEG quality, 1 to 100.")]
Boards = Annotated[bool | None, typer.Option("--boards/--no-boards", help="Also show the base boards.")]
Stage = Annotated[
    Path | None,
    typer.Option(help="A local directory where episodes are written before they are moved to a slow --out."),
]
AttemptTimeout = Annotated[
    float, typer.Option(min=1, help="Seconds after which a worker counts as hung and is replaced.")
]
Quality = Annotated[
    str | None, typer.Option(help="fast, balanced, high, photo, auto (GPU or not), or a YAML file.  [default: auto]")
]
MinSuccess = Annotated[
    float | None,
    typer.Option(
        "--min-success", min=0, max=1, metavar="SHARE", help="Exit code 5 if a smaller share of the trials succeeds."
    ),
]


def _flag_name(setting: str) -> str:
    return f"--{setting.replace('_', '-')}"


# Opens the sessions of all commands. Its error messages name flags, and its notes go to stderr.
session_opener = SessionOpener(
    os.environ, print_note, _flag_name, import_if_file, resolve_scene_task, fetch_bar, note_at_end
)


# Session settings that a command may have as parameters; `SessionOpener.load_record_config` explains them.
_SESSION_SETTING_NAMES = (
    "scene", "rig", "revision", "robot", "task", "target", "n", "workers", "seed", "grasp", "arm", "wrist", "camera",
    "boards", "truth", "size", "jpeg_quality", "action", "fps", "quality", "threshold", "randomize", "randomization",
    "camera_effects", "disturb",
)  # fmt: skip


def session_settings(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return the session settings among a command's parameters; `item` becomes `object`."""
    return {"object": parameters["item"]} | {
        name: parameters[name] for name in _SESSION_SETTING_NAMES if name in parameters
    }


def _set_offline(wanted: bool) -> bool:
    if wanted:
        session_opener.stay_offline()
    return wanted


# The callback takes effect when typer parses the flag, so commands only declare a parameter.
Offline = Annotated[
    bool,
    typer.Option(
        "--offline",
        callback=_set_offline,
        help="Do not fetch missing meshes; show primitives in their place, as with YAMSIM_OFFLINE=1.",
    ),
]
