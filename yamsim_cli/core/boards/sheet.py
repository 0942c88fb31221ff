"""The layout of a board's printed page, for PDF and PNG alike.

Lengths are millimetres on the page, x right and y down from its top left corner. A `Board`'s metres are converted once,
in `board_sheet`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import ConfigError
from ..geometry.board import Board
from .board_image import marker_cells


@dataclass(frozen=True)
class Paper:
    """A size of paper in portrait orientation, mm."""

    name: str
    width: float
    height: float


# Source: ISO 216 and ANSI/ASME Y14.1.
PAPERS: Mapping[str, Paper] = {
    paper.name: paper for paper in (Paper("A4", 210.0, 297.0), Paper("Letter", 215.9, 279.4))
}


@dataclass(frozen=True)
class PrintedMarker:
    """A marker of square cells from its top left corner (x, y), each `cell` wide; `black` (k, k) are printed."""

    x: float
    y: float
    cell: float
    black: NDArray[np.bool_]


@dataclass(frozen=True)
class Bar:
    """A filled rectangle from its top left corner (x, y)."""

    x: float
    y: float
    width: float
    height: float


@dataclass(frozen=True)
class Line:
    """A thin line."""

    x0: float
    y0: float
    x1: float
    y1: float


@dataclass(frozen=True)
class Text:
    """A line of ASCII text. (x, y) is the point of its baseline that `align` names."""

    x: float
    y: float
    text: str
    size: float = 3.4
    bold: bool = False
    align: Literal["left", "right", "centre"] = "left"


Mark = PrintedMarker | Bar | Line | Text

LINE_WIDTH = 0.15


@dataclass(frozen=True)
class Sheet:
    """A page and the marks on it."""

    paper: Paper
    title: str
    marks: tuple[Mark, ...]


# The page's margin, where most printers cannot print.
_MARGIN = 12.0
_TITLE_SIZE = 6.0
_LINE_STEP = 5.2
_HEADER = 12.0 + 4 * _LINE_STEP
_RULER_LENGTH = 100.0
_RULER_COLUMN = 14.0
_FOOTER = 40.0
_QUIET = 5.0
_CROP_MARK = 6.0


def board_sheet(board: Board, owner: str, paper: Paper) -> Sheet:
    """A page with the board at true size, its description, and two rulers to check the printer's scale.

    A zone around the board stays white: 5 mm, or a marker's cell if that is wider. Marks outside it show where to cut,
    so that part of the white stays on, which detectors need.

    Args:
        owner: name of the arm that the board belongs to.
        paper: one of `PAPERS`.

    Raises:
        ConfigError: the board does not fit the page; or as `marker_cells`.
    """
    cells = marker_cells(board) == 0
    width, height = board.width * 1000, board.height * 1000
    cell = board.marker_length * 1000 / cells.shape[1]
    quiet = max(_QUIET, cell)
    frame = quiet + _CROP_MARK

    least_width = 2 * (_MARGIN + frame) + _RULER_COLUMN + width
    least_height = 2 * (_MARGIN + frame) + _HEADER + max(height, _RULER_LENGTH) + _FOOTER
    if least_width > paper.width or least_height > paper.height:
        raise ConfigError(
            f"board {board.name!r} is {width:.1f} x {height:.1f} mm and with its white border, marks and rulers needs "
            f"{least_width:.1f} x {least_height:.1f} mm, but {paper.name} is {paper.width:g} x {paper.height:g} mm; "
            "choose fewer or smaller markers"
        )

    left = (_MARGIN + _RULER_COLUMN + paper.width - _MARGIN - width) / 2
    top = _MARGIN + _HEADER + frame
    foot = top + max(height, _RULER_LENGTH) + frame
    return Sheet(
        paper,
        f"{owner}: {board.name}",
        (
            *_header(board, owner, paper),
            *_markers(board, cells, left, top),
            *_crop_marks(left, top, width, height, quiet),
            *_upright_ruler(_MARGIN + _RULER_COLUMN - 4, top),
            *_axes(_MARGIN + 6, foot + 24),
            *_level_ruler(paper.width - _MARGIN - _RULER_LENGTH - 4, foot + 8),
        ),
    )


def _header(board: Board, owner: str, paper: Paper) -> Iterator[Mark]:
    yield Text(_MARGIN, _MARGIN + _TITLE_SIZE, f"{owner}: {board.name}", _TITLE_SIZE, bold=True)
    lines = (
        f"Markers {board.ids[0]} to {board.ids[-1]}, row by row from the top left ({board.columns} x {board.rows}), of "
        f"{board.dictionary}.",
        f"Marker {board.marker_length * 1000:.3f} mm, gap {board.gap * 1000:.3f} mm, board {board.width * 1000:.3f} x "
        f"{board.height * 1000:.3f} mm.",
        f'Print on {paper.name} ({paper.width:g} x {paper.height:g} mm) at 100 % ("actual size"), never "fit to page".',
        "Cut between the corner marks, and leave the white border on: detectors need it.",
    )
    for k, line in enumerate(lines, start=1):
        yield Text(_MARGIN, _MARGIN + 8 + k * _LINE_STEP, line)


def _markers(board: Board, cells: NDArray[np.bool_], left: float, top: float) -> Iterator[Mark]:
    # From the `board` frame (origin at the centre, y up) to the page (y down).
    corners = 1000 * (board.corners()[:, 0, :2] * (1, -1) + (board.width / 2, board.height / 2))
    for (x, y), black in zip(corners, cells, strict=True):
        yield PrintedMarker(left + float(x), top + float(y), board.marker_length * 1000 / len(black), black)


def _crop_marks(left: float, top: float, width: float, height: float, quiet: float) -> Iterator[Mark]:
    border = 0.6 * quiet  # 3 mm for a white zone of 5 mm: the piece then fits the lab's 100 mm plate.
    far = quiet + _CROP_MARK
    for x in (left - border, left + width + border):
        yield Line(x, top - quiet, x, top - far)
        yield Line(x, top + height + quiet, x, top + height + far)
    for y in (top - border, top + height + border):
        yield Line(left - quiet, y, left - far, y)
        yield Line(left + width + quiet, y, left + width + far, y)


def _tick(mm: int) -> float:
    return 3.5 if mm % 10 == 0 else 2.5 if mm % 5 == 0 else 1.5


def _level_ruler(x: float, y: float) -> Iterator[Mark]:
    yield Bar(x, y, _RULER_LENGTH, 1.0)
    for mm in range(int(_RULER_LENGTH) + 1):
        yield Line(x + mm, y + 1, x + mm, y + 1 + _tick(mm))
        if mm % 10 == 0:
            yield Text(x + mm, y + 8, str(mm), 2.8, align="centre")
    yield Text(x, y - 2.5, "Measure: both bars must be 100.0 mm long.", bold=True)
    lines = (
        "If one is not, print again at 100 %.",
        "Then measure a marker and a gap, and set",
        "marker_length_mm and gap_mm in your rig",
        "to what you find.",
    )
    for k, line in enumerate(lines):
        yield Text(x, y + 14 + k * _LINE_STEP, line)


def _upright_ruler(x: float, y: float) -> Iterator[Mark]:
    yield Bar(x - 1, y, 1.0, _RULER_LENGTH)
    for mm in range(int(_RULER_LENGTH) + 1):
        yield Line(x - 1, y + mm, x - 1 - _tick(mm), y + mm)
        if mm % 10 == 0:
            yield Text(x - 5.5, y + mm + 1, str(mm), 2.8, align="right")


def _axes(x: float, y: float) -> Iterator[Mark]:
    length, head = 16.0, 1.8
    yield Line(x, y, x + length, y)
    yield Line(x + length, y, x + length - head, y - head / 2)
    yield Line(x + length, y, x + length - head, y + head / 2)
    yield Text(x + length + 1.5, y + 1.1, "board x, right")
    yield Line(x, y, x, y - length)
    yield Line(x, y - length, x - head / 2, y - length + head)
    yield Line(x, y - length, x + head / 2, y - length + head)
    yield Text(x, y - length - 1.8, "board y, up")
