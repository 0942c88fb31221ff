"""`yamsim identify`: how an arm really moves, from what was logged of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from yamsim_cli.core.errors import SimulationError, UsageError
from yamsim_cli.flags.outputs import Overwrite, require_free
from yamsim_cli.flags.session import Json, Margin, Revision, RigName, Robot, opener
from yamsim_cli.terminal.console import note, print_json, print_line, print_table, progress_bar
from yamsim_cli.terminal.tables import listing

if TYPE_CHECKING:
    from yamsim_cli.core.identify.identify import Identified


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
        Path, typer.Option(help="The revision's file; of two arms, one for each, with `_left` and `_right`.")
    ] = Path("my_arm.yaml"),
    arm: Annotated[
        Literal["left", "right"] | None, typer.Option(help="Only this arm of a rig with two.  [default: both]")
    ] = None,
    held_out: Annotated[
        list[Path] | None,
        typer.Option(help="A recording that the result is judged by.  [default: the last third of each]"),
    ] = None,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Find an arm's delay, friction, damping, armature, offsets and gravity factors, and write them as a revision.

    Example: yamsim identify log.csv --rig single --out my_arm.yaml
    """
    where = opener.locations()
    settings = opener.rig(rig, where, margin, revision, robot)
    if arm is not None and arm not in (sides := [each.side for each in settings.arms]):
        raise UsageError(f"--arm {arm}: rig {settings.name!r} has only a {sides[0]} one; leave --arm out")
    if out.suffix not in (".yaml", ".yml"):
        raise UsageError(f"--out {out}: the file of a revision ends in .yaml")
    sides = [each.side for each in settings.arms if arm in (None, each.side)]
    for file in {out, *(_file(out, side, len(sides)) for side in sides)}:
        require_free("--out", file, overwrite=overwrite)
    name = _revision_name(out)
    opener.skip_gl()

    from yamsim_cli.core.identify.identify import identify as run
    from yamsim_cli.core.recordings.reading import read_motions

    motions = read_motions(recordings, settings, where)
    others = read_motions(held_out, settings, where) if held_out else []
    with progress_bar("identifying", "simulations") as advance:
        found = run(settings, motions, others, name, arm, lambda one, done, total: advance(done, total, one))
    files = _write(found, out)
    if json:
        print_json(_plain(found, settings.name, files))
    else:
        for one, file in zip(found, files, strict=True):
            _show(one, file)
    for one in found:
        if one.gap.fallen <= 0:
            raise SimulationError(
                f"{one.side or one.arm}: on {one.gap.source}, which was held out, the gap did not fall: "
                f"{1000 * one.gap.before:.2f} mrad before, {1000 * one.gap.after:.2f} after; record a log that shows "
                "more, by `yamsim excite`"
            )


def _revision_name(out: Path) -> str:
    name = "".join(letter if letter.isascii() and letter.isalnum() else "_" for letter in out.stem)
    return name if name[:1].isalpha() else f"arm_{name}"


def _write(found: Sequence[Identified], out: Path) -> list[Path]:
    from yamsim_cli.core.documents.document import dump_yaml
    from yamsim_cli.core.files import write_outputs

    files = [_file(out, one.side, len(found)) for one in found]
    revisions = {
        file: dump_yaml(one.dynamics.model_dump(mode="json", exclude_defaults=True)).encode()
        for one, file in zip(found, files, strict=True)
        if one.gap.fallen > 0
    }
    if revisions:
        write_outputs(revisions)
    return files


def _file(out: Path, side: str, arms: int) -> Path:
    """The file of one arm's revision; `arms` are identified together."""
    return out if arms == 1 else out.with_stem(f"{out.stem}_{side}")


def _plain(found: Sequence[Identified], rig: str, files: Sequence[Path]) -> dict[str, Any]:
    """As JSON has it: of two arms each under its side, and their joints also together."""
    arms = [{**_plain_arm(one), "out": str(file)} for one, file in zip(found, files, strict=True)]
    data: dict[str, Any] = {"rig": rig, "out": [str(file) for file in files]}
    if len(arms) == 1:
        return data | {key: value for key, value in arms[0].items() if key != "out"}
    sides = [one.side for one in found]
    data["joints"] = {
        f"{side}_{joint}": told
        for side, each in zip(sides, arms, strict=True)
        for joint, told in each["joints"].items()
    }
    data["params"] = [
        {**param, "arm": side} for side, each in zip(sides, arms, strict=True) for param in each["params"]
    ]
    return data | {"arms": dict(zip(sides, arms, strict=True))}


def _plain_arm(one: Identified) -> dict[str, Any]:
    common = {each.name: each.plain() for each in one.estimates if not each.joint}
    joints: dict[str, dict[str, Any]] = {}
    for each in one.estimates:
        if each.joint:
            joints.setdefault(each.joint, dict(common))[each.name] = each.plain()
    return {
        "arm": one.arm,
        "revision": one.dynamics.revision,
        "base": one.dynamics.base,
        **common,
        "joints": joints,
        "params": [{"joint": each.joint, "name": each.name, **each.plain()} for each in one.estimates],
        "cannot_tell": one.cannot_tell,
        "fitted_rms_rad": one.fitted_rms,
        "held_out": one.gap.plain(),
    }


def _show(one: Identified, file: Path) -> None:
    table = listing(("joint", "parameter", "value", "from", "to", "model"), numbers_from=2, numbers_to=6)
    for each in one.estimates:
        figures = [f"{number:.4g}" for number in (each.value, each.low, each.high, each.before)]
        table.add_row(each.joint or "all", each.name, *figures)
    print_table(table)
    gap = one.gap
    print_line(
        f"Held out ({gap.source}, {gap.seconds:.0f} s): {1000 * gap.before:.2f} mrad with the model, "
        f"{1000 * gap.after:.2f} with {one.dynamics.revision}: {gap.fallen:.0%} less"
    )
    for sentence in one.cannot_tell:
        note(sentence)
    if gap.fallen > 0:
        print_line(f"{file}: give it to other commands as --robot {file}")
