"""`yamsim excite`: a motion by which a log tells how an arm moves."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from yamsim_cli.core.errors import UsageError
from yamsim_cli.flags.outputs import Overwrite, require_free
from yamsim_cli.flags.session import Json, Margin, Revision, RigName, Robot, opener
from yamsim_cli.terminal.console import print_json, print_line


def excite(
    rig: RigName = "single",
    revision: Revision = None,
    robot: Robot = None,
    margin: Margin = None,
    arm: Annotated[
        Literal["left", "right"] | None,
        typer.Option(help="Which arm of a rig with two moves; the other rests.  [default: right]"),
    ] = None,
    out: Annotated[Path, typer.Option(help="The CSV of commands.")] = Path("motion.csv"),
    seconds: Annotated[float, typer.Option(min=20, max=600, help="How long it is.")] = 60.0,
    seed: Annotated[int, typer.Option(min=0, help="Everything random follows from it.")] = 0,
    log: Annotated[
        Path | None, typer.Option(help="Also simulate it, and write what would be logged, as a real arm's log.")
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Write a motion that swings every joint of an arm quickly and slowly, within its stops and clear of everything.

    Example: yamsim excite --rig single --out motion.csv
    """
    where = opener.locations()
    settings = opener.rig(rig, where, margin, revision, robot)
    if arm is not None and arm not in (sides := [each.side for each in settings.arms]):
        raise UsageError(f"--arm {arm}: rig {settings.name!r} has only a {sides[0]} one; leave --arm out")
    for flag, file in (("--out", out), ("--log", log)):
        if file is not None and file.suffix != ".csv":
            raise UsageError(f"{flag} {file}: motions and logs are written as .csv")
        if file is not None:
            require_free(flag, file, overwrite=overwrite)
    opener.skip_gl()

    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.scene import SceneConfig
    from yamsim_cli.core.files import write_output
    from yamsim_cli.core.identify.excitation import commands_csv, log_csv
    from yamsim_cli.core.identify.excitation import excite as run

    number = next((k for k, each in enumerate(settings.arms) if each.side == (arm or "right")), 0)
    scene = load_config(SceneConfig, "scenes", "tabletop", where)
    found = run(settings, number, scene, where, seconds, seed)
    write_output(out, commands_csv(settings, number, found))
    if log is not None:
        write_output(log, log_csv(settings, number, found, scene, where), "--log")
    start = [round(float(angle), 4) for angle in found.commands[0]]
    if json:
        print_json(
            {
                "path": str(out),
                "log": None if log is None else str(log),
                "seconds": float(found.times[-1]),
                "commands": len(found.times),
                "start_rad": start,
                "half_width_rad": found.box.half.tolist(),
                "share_of_speed": found.speed,
                "share_of_torque": found.torque,
            }
        )
        return
    print_line(
        f"{out}: {len(found.times)} commands over {found.times[-1]:g} s, up to {found.speed:.0%} of the motors' speed "
        f"and {found.torque:.0%} of their torque"
    )
    print_line(
        f"Bring the arm slowly to {', '.join(f'{angle:g}' for angle in start)} rad first: there it begins and ends"
    )
    if log is not None:
        print_line(f"{log}: what the simulated arm did")
