from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from yamsim_cli.core.errors import ConfigError, UsageError
from yamsim_cli.flags.output_files import Overwrite, require_unused_paths
from yamsim_cli.flags.session_options import Json, session_opener
from yamsim_cli.terminal.console import print_json, print_line

if TYPE_CHECKING:
    from yamsim_cli.photos.board_sheet import PrintedPage


class PaperSize(StrEnum):
    """Keys of `photos.board_sheet.PAPERS`, repeated here so that --help imports no OpenCV."""

    A4 = "A4"
    LETTER = "Letter"


def boards(
    rig: Annotated[str, typer.Option(help="Rig: a name from configs/rigs/ or a YAML file.")] = "single",
    out: Annotated[Path, typer.Option(help="A .pdf with one page per board, or one .png per board.")] = Path(
        "boards.pdf"
    ),
    paper: Annotated[PaperSize, typer.Option(case_sensitive=False, help="Paper in the printer.")] = PaperSize.A4,
    overwrite: Overwrite = False,
    json: Json = False,
) -> None:
    """Write a rig's fiducial boards as pages that print at true size. Each .png file is named after its arm.

    Example: yamsim boards --rig bimanual --out boards.pdf
    """
    if out.suffix.lower() not in (".pdf", ".png"):
        raise UsageError(f"--out {out} is not valid; it must end in .pdf or .png")

    from yamsim_cli.core.config.loader import load_config
    from yamsim_cli.core.config.rig import RigConfig
    from yamsim_cli.core.files.writing import write_outputs
    from yamsim_cli.photos.board_sheet import PAPERS, board_sheet

    arms = load_config(RigConfig, "rigs", rig, session_opener.find_locations()).arms
    owned = {arm.name: arm.board for arm in arms if arm.board}
    if not owned:
        raise ConfigError(f"rig {rig!r} has no boards to print; give one of its arms a `board`, or choose another rig")

    for path in dict.fromkeys(_board_file(out, name) for name in owned):
        require_unused_paths("--out", path, overwrite=overwrite)
    sheets = {name: board_sheet(config.board_in_metres, name, PAPERS[paper]) for name, config in owned.items()}
    files = _board_files(sheets, out)
    write_outputs(files)
    if json:
        described = [
            {
                "arm": name,
                "name": config.name,
                "ids": list(config.board_in_metres.marker_ids),
                "marker_length_mm": config.marker_length_mm,
                "paper": str(paper),
            }
            for name, config in owned.items()
        ]
        print_json({"files": [str(path) for path in files], "boards": described})
        return
    for path in files:
        print_line(str(path))


def _board_file(out: Path, arm: str) -> Path:
    """Return `out` if it is a PDF, which holds all boards, else one PNG for each arm."""
    return out if out.suffix.lower() == ".pdf" else out.with_name(f"{out.stem}_{arm}{out.suffix}")


def _board_files(sheets: dict[str, PrintedPage], out: Path) -> dict[Path, bytes]:
    from yamsim_cli.photos.board_sheet import pdf_bytes, png_bytes

    if out.suffix.lower() == ".pdf":
        return {out: pdf_bytes(list(sheets.values()))}
    return {_board_file(out, name): png_bytes(sheet) for name, sheet in sheets.items()}
