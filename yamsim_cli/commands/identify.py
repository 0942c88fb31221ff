from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from yamsim_cli.core.errors import SimulationError, UsageError
from yamsim_cli.flags.output_files import Overwrite, require_unused_paths
from yamsim_cli.flags.session_options import Json, Margin, Revision, RigName, Robot, session_opener
from yamsim_cli.terminal.console import print_json, print_line, print_note, print_table, progress_bar
from yamsim_cli.terminal.tables import ItemTable

if TYPE_CHECKING:
    from yamsim_cli.core.config.rig import RigConfig
    from yamsim_cli.real.identify.excitation import Excitation
    from yamsim_cli.real.identify.identification import IdentificationResult


def excite(
    rig: RigName = "single",
    revision: Revision = None,
    robot: Robot = None,
    margin: Margin = None,
    arm: Annotated[
        Literal["left", "right"] | None,
        typer.Option(help="The arm that moves, in a rig with two; the other rests.  [default: right]"),
    ] = None,
    out: Annotated[Path, typer.Option(help="The CSV of commands.")] = Path("motion.csv"),
    seconds: Annotated[float, typer.Option(min=20, max=600, help="Duration of the motion.")] = 60.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all random samples.")] = 0,
    log: Annotated[
        Path | None, typer.Option(help="Also simulate the motion, and write the simulated arm's log.")
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Write a motion that moves an arm's joints fast and slowly, within the joint limits and without collisions.

    Example: yamsim excite --rig single --out motion.csv
    """
    where = session_opener.find_locations()
    settings = session_opener.load_rig(rig, where, margin, revision, robot)
    _require_arm(arm, settings)
    for flag, file in (("--out", out), ("--log", log)):
        if file is not None and file.suffix != ".csv":
            raise UsageError(f"{flag} {file}: motions and logs are written as .csv")
        if file is not None:
            require_unused_paths(flag, file, overwrite=overwrite)
    session_opener.disable_gl()

    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.scene import SceneConfig
    from yamsim_cli.core.files.writing import write_output
    from yamsim_cli.real.identify.excitation import commands_csv, log_csv
    from yamsim_cli.real.identify.excitation import generate_excitation as run

    number = next((k for k, each in enumerate(settings.arms) if each.side == (arm or "right")), 0)
    scene = load_config(SceneConfig, "scenes", "tabletop", where)
    found = run(settings, number, scene, where, seconds, seed)
    write_output(out, commands_csv(settings, number, found))
    if log is not None:
        write_output(log, log_csv(settings, number, found, scene, where), "--log")
    if json:
        print_json(_excitation_report(found, out, log))
        return
    print_line(
        f"{out}: {len(found.times)} commands over {found.times[-1]:g} s, up to {found.speed:.0%} of the motors' speed "
        f"and {found.torque:.0%} of their torque"
    )
    start = ", ".join(f"{angle:g}" for angle in _start_joints(found))
    print_line(f"Bring the arm slowly to {start} rad first: the motion begins and ends there")
    if log is not None:
        print_line(f"{log}: log of the simulated arm")


def _excitation_report(found: Excitation, out: Path, log: Path | None) -> dict[str, Any]:
    return {
        "path": str(out),
        "log": None if log is None else str(log),
        "seconds": float(found.times[-1]),
        "commands": len(found.times),
        "start_rad": _start_joints(found),
        "half_width_rad": found.joint_range.half_range.tolist(),
        "share_of_speed": found.speed,
        "share_of_torque": found.torque,
    }


def _start_joints(found: Excitation) -> list[float]:
    return [round(float(angle), 4) for angle in found.commands[0]]


def _require_arm(arm: str | None, rig: RigConfig) -> None:
    sides = [each.side for each in rig.arms]
    if arm is not None and arm not in sides:
        raise UsageError(f"--arm {arm}: rig {rig.name!r} has only a {sides[0]} arm; leave --arm out")


def identify(
    recordings: Annotated[
        list[Path],
        typer.Argument(help="Logs: CSV files, episodes or datasets, with commands and joints.", show_default=False),
    ],
    rig: RigName = "single",
    revision: Revision = None,
    robot: Robot = None,
    margin: Margin = None,
    out: Annotated[
        Path, typer.Option(help="File of the revision; with two arms, one file each, ending in `_left` and `_right`.")
    ] = Path("my_arm.yaml"),
    arm: Annotated[
        Literal["left", "right"] | None, typer.Option(help="Only this arm of a rig with two.  [default: both]")
    ] = None,
    held_out: Annotated[
        list[Path] | None,
        typer.Option(help="A recording to test the result on; may be repeated.  [default: the last third of each log]"),
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Estimate an arm's delay, friction, damping, armature, offsets and gravity factors, and write them as a revision.

    Example: yamsim identify log.csv --rig single --out my_arm.yaml
    """
    where = session_opener.find_locations()
    settings = session_opener.load_rig(rig, where, margin, revision, robot)
    _require_arm(arm, settings)
    if out.suffix not in (".yaml", ".yml"):
        raise UsageError(f"--out {out}: the file of a revision must end in .yaml")
    sides = [each.side for each in settings.arms if arm in (None, each.side)]
    for file in {out, *(_dynamics_file(out, side, len(sides)) for side in sides)}:
        require_unused_paths("--out", file, overwrite=overwrite)
    name = _revision_name(out)
    session_opener.disable_gl()

    from yamsim_cli.real.identify.identification import identify_arms as run
    from yamsim_cli.real.recordings.motion_reading import read_motions

    motions = read_motions(recordings, settings, where)
    others = read_motions(held_out, settings, where) if held_out else []
    with progress_bar("identifying", "simulations") as advance:
        found = run(settings, motions, others, name, arm, lambda one, done, total: advance(done, total, one))
    files = _write_dynamics(found, out)
    if json:
        print_json(_identification_report(found, settings.name, files))
    else:
        for one, file in zip(found, files, strict=True):
            _print_arm(one, file)
    for one in found:
        if one.held_out_error.relative_reduction <= 0:
            raise SimulationError(
                f"{one.side or one.arm}: the gap on the held-out {one.held_out_error.source} did not fall: "
                f"{1000 * one.held_out_error.rms_before:.2f} mrad before, {1000 * one.held_out_error.rms_after:.2f} "
                "after; record a log of a motion of `yamsim excite`"
            )


def _revision_name(out: Path) -> str:
    name = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in out.stem)
    return name if name[:1].isalpha() else f"arm_{name}"


def _write_dynamics(found: Sequence[IdentificationResult], out: Path) -> list[Path]:
    from yamsim_cli.core.files.documents.yaml_document import dump_yaml
    from yamsim_cli.core.files.writing import write_outputs

    files = [_dynamics_file(out, one.side, len(found)) for one in found]
    revisions = {
        file: dump_yaml(one.dynamics.model_dump(mode="json", exclude_defaults=True)).encode()
        for one, file in zip(found, files, strict=True)
        if one.held_out_error.relative_reduction > 0
    }
    if revisions:
        write_outputs(revisions)
    return files


def _dynamics_file(out: Path, side: str, arms: int) -> Path:
    return out if arms == 1 else out.with_stem(f"{out.stem}_{side}")


def _identification_report(found: Sequence[IdentificationResult], rig: str, files: Sequence[Path]) -> dict[str, Any]:
    """Two arms are listed by side, and their joints also in one list."""
    arms = [{**_arm_report(one), "out": str(file)} for one, file in zip(found, files, strict=True)]
    data: dict[str, Any] = {"rig": rig, "out": [str(file) for file in files]}
    if len(arms) == 1:
        return data | {key: value for key, value in arms[0].items() if key != "out"}
    sides = [one.side for one in found]
    data["joints"] = {
        f"{side}_{joint}": values
        for side, each in zip(sides, arms, strict=True)
        for joint, values in each["joints"].items()
    }
    data["params"] = [
        {**param, "arm": side} for side, each in zip(sides, arms, strict=True) for param in each["params"]
    ]
    return data | {"arms": dict(zip(sides, arms, strict=True))}


def _arm_report(one: IdentificationResult) -> dict[str, Any]:
    common = {each.name: each.to_json_data() for each in one.estimates if not each.joint}
    joints: dict[str, dict[str, Any]] = {}
    for each in one.estimates:
        if each.joint:
            joints.setdefault(each.joint, dict(common))[each.name] = each.to_json_data()
    return {
        "arm": one.arm,
        "revision": one.dynamics.revision,
        "base": one.dynamics.base,
        **common,
        "joints": joints,
        "params": [{"joint": each.joint, "name": each.name, **each.to_json_data()} for each in one.estimates],
        "cannot_tell": one.undetermined,
        "fitted_rms_rad": one.fitted_rms,
        "held_out": one.held_out_error.to_json_data(),
    }


def _print_arm(one: IdentificationResult, file: Path) -> None:
    table = ItemTable(("joint", "parameter", "value", "from", "to", "model"), numbers_from=2, numbers_to=6)
    for each in one.estimates:
        figures = [f"{number:.4g}" for number in (each.value, each.low, each.high, each.model_value)]
        table.add_row(each.joint or "all", each.name, *figures)
    print_table(table)
    gap = one.held_out_error
    print_line(
        f"Held out ({gap.source}, {gap.seconds:.0f} s): {1000 * gap.rms_before:.2f} mrad with the model, "
        f"{1000 * gap.rms_after:.2f} with {one.dynamics.revision}: {gap.relative_reduction:.0%} less"
    )
    for sentence in one.undetermined:
        print_note(sentence)
    if gap.relative_reduction > 0:
        print_line(f"{file}: give it to other commands as --robot {file}")
