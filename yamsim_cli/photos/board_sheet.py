"""Lay out a board's printed page as a PDF or PNG. Page lengths are in mm, x right and y down from the top left."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.errors import ConfigError, ResourceError
from ..core.geometry.board import Board
from ..core.images.board_image import WHITE, marker_cells
from ..core.images.image import Image
from ..core.images.png import encode_png


@dataclass(frozen=True)
class Paper:
    """A paper format in portrait orientation, mm."""

    name: str
    width: float
    height: float


# Source: ISO 216 and ANSI/ASME Y14.1.
PAPERS: Mapping[str, Paper] = {
    paper.name: paper for paper in (Paper("A4", 210.0, 297.0), Paper("Letter", 215.9, 279.4))
}


@dataclass(frozen=True)
class PrintedMarker:
    """A marker: top left corner (x, y), width `cell` of a square cell, and printed cells `black` (k, k)."""

    x: float
    y: float
    cell: float
    black: NDArray[np.bool_]


@dataclass(frozen=True)
class PageBar:
    """A filled rectangle with top left corner (x, y)."""

    x: float
    y: float
    width: float
    height: float


@dataclass(frozen=True)
class PageLine:
    """A line of width `LINE_WIDTH`."""

    x0: float
    y0: float
    x1: float
    y1: float


@dataclass(frozen=True)
class PageText:
    """ASCII text. `align` names the point of its baseline at (x, y)."""

    x: float
    y: float
    text: str
    size: float = 3.4
    bold: bool = False
    align: Literal["left", "right", "centre"] = "left"


PageMark = PrintedMarker | PageBar | PageLine | PageText

LINE_WIDTH = 0.15  # mm


@dataclass(frozen=True)
class PrintedPage:
    """A page and the marks on it."""

    paper: Paper
    title: str
    marks: tuple[PageMark, ...]


_PAGE_MARGIN = 12.0  # mm, edge where most printers cannot print
_TITLE_TEXT_HEIGHT = 6.0  # mm
_TEXT_LINE_SPACING = 5.2  # mm, between lines of text
_HEADER_HEIGHT = 12.0 + 4 * _TEXT_LINE_SPACING  # mm, title and four lines above the board
_RULER_LENGTH = 100.0  # mm, of the printed rulers, by which a print's scale is checked
_RULER_COLUMN = 14.0  # mm, width for the upright ruler
_FOOTER_HEIGHT = 40.0  # mm, level ruler, axes and text below the board
_MIN_QUIET_ZONE = 5.0  # mm, white zone around the board
_CROP_MARK = 6.0  # mm


def board_sheet(board: Board, owner: str, paper: Paper) -> PrintedPage:
    """Return a page with the arm's board at true size, its description, and two rulers to check the printer's scale.

    A white zone of 5 mm, or of a marker cell if wider, surrounds the board. Crop marks lie outside. The cut leaves part
    of the zone, which detectors need.

    Raises:
        ConfigError: the board does not fit the page; or as `marker_cells`.
    """
    cells = marker_cells(board) == 0
    width, height = board.width * 1000, board.height * 1000
    cell = board.marker_length * 1000 / cells.shape[1]
    quiet = max(_MIN_QUIET_ZONE, cell)
    frame = quiet + _CROP_MARK

    least_width = 2 * (_PAGE_MARGIN + frame) + _RULER_COLUMN + width
    least_height = 2 * (_PAGE_MARGIN + frame) + _HEADER_HEIGHT + max(height, _RULER_LENGTH) + _FOOTER_HEIGHT
    if least_width > paper.width or least_height > paper.height:
        raise ConfigError(
            f"board {board.name!r} is {width:.1f} x {height:.1f} mm and with its white border, marks and rulers needs "
            f"{least_width:.1f} x {least_height:.1f} mm, but {paper.name} is {paper.width:g} x {paper.height:g} mm; "
            "choose fewer or smaller markers"
        )

    left = (_PAGE_MARGIN + _RULER_COLUMN + paper.width - _PAGE_MARGIN - width) / 2
    top = _PAGE_MARGIN + _HEADER_HEIGHT + frame
    foot = top + max(height, _RULER_LENGTH) + frame
    return PrintedPage(
        paper,
        f"{owner}: {board.name}",
        (
            *_header_marks(board, owner, paper),
            *_printed_markers(board, cells, left, top),
            *_crop_marks(left, top, width, height, quiet),
            *_vertical_ruler(_PAGE_MARGIN + _RULER_COLUMN - 4, top),
            *_axis_marks(_PAGE_MARGIN + 6, foot + 24),
            *_horizontal_ruler(paper.width - _PAGE_MARGIN - _RULER_LENGTH - 4, foot + 8),
        ),
    )


def _header_marks(board: Board, owner: str, paper: Paper) -> Iterator[PageMark]:
    yield PageText(
        _PAGE_MARGIN, _PAGE_MARGIN + _TITLE_TEXT_HEIGHT, f"{owner}: {board.name}", _TITLE_TEXT_HEIGHT, bold=True
    )
    lines = (
        f"Markers {board.marker_ids[0]} to {board.marker_ids[-1]}, row by row from the top left "
        f"({board.columns} x {board.rows}), of "
        f"{board.dictionary}.",
        f"Marker {board.marker_length * 1000:.3f} mm, gap {board.gap * 1000:.3f} mm, board {board.width * 1000:.3f} x "
        f"{board.height * 1000:.3f} mm.",
        f'Print on {paper.name} ({paper.width:g} x {paper.height:g} mm) at 100 % ("actual size"), never "fit to page".',
        "Cut between the corner marks, and leave the white border on: detectors need it.",
    )
    for k, line in enumerate(lines, start=1):
        yield PageText(_PAGE_MARGIN, _PAGE_MARGIN + 8 + k * _TEXT_LINE_SPACING, line)


def _printed_markers(board: Board, cells: NDArray[np.bool_], left: float, top: float) -> Iterator[PageMark]:
    # From the `board` frame (origin at the centre, y up) to the page.
    corners = 1000 * (board.marker_corners()[:, 0, :2] * (1, -1) + (board.width / 2, board.height / 2))
    for (x, y), black in zip(corners, cells, strict=True):
        yield PrintedMarker(left + float(x), top + float(y), board.marker_length * 1000 / len(black), black)


def _crop_marks(left: float, top: float, width: float, height: float, quiet: float) -> Iterator[PageMark]:
    border = 0.6 * quiet  # 3 mm for a white zone of 5 mm, so that the cut piece fits the lab's 100 mm plate
    far = quiet + _CROP_MARK
    for x in (left - border, left + width + border):
        yield PageLine(x, top - quiet, x, top - far)
        yield PageLine(x, top + height + quiet, x, top + height + far)
    for y in (top - border, top + height + border):
        yield PageLine(left - quiet, y, left - far, y)
        yield PageLine(left + width + quiet, y, left + width + far, y)


def _tick_length(mm: int) -> float:
    return 3.5 if mm % 10 == 0 else 2.5 if mm % 5 == 0 else 1.5


def _horizontal_ruler(x: float, y: float) -> Iterator[PageMark]:
    yield PageBar(x, y, _RULER_LENGTH, 1.0)
    for mm in range(int(_RULER_LENGTH) + 1):
        yield PageLine(x + mm, y + 1, x + mm, y + 1 + _tick_length(mm))
        if mm % 10 == 0:
            yield PageText(x + mm, y + 8, str(mm), 2.8, align="centre")
    yield PageText(x, y - 2.5, "Measure: both bars must be 100.0 mm long.", bold=True)
    lines = (
        "If one is not, print again at 100 %.",
        "Then measure a marker and a gap, and set",
        "marker_length_mm and gap_mm in your rig",
        "to what you find.",
    )
    for k, line in enumerate(lines):
        yield PageText(x, y + 14 + k * _TEXT_LINE_SPACING, line)


def _vertical_ruler(x: float, y: float) -> Iterator[PageMark]:
    yield PageBar(x - 1, y, 1.0, _RULER_LENGTH)
    for mm in range(int(_RULER_LENGTH) + 1):
        yield PageLine(x - 1, y + mm, x - 1 - _tick_length(mm), y + mm)
        if mm % 10 == 0:
            yield PageText(x - 5.5, y + mm + 1, str(mm), 2.8, align="right")


def _axis_marks(x: float, y: float) -> Iterator[PageMark]:
    length, head = 16.0, 1.8
    yield PageLine(x, y, x + length, y)
    yield PageLine(x + length, y, x + length - head, y - head / 2)
    yield PageLine(x + length, y, x + length - head, y + head / 2)
    yield PageText(x + length + 1.5, y + 1.1, "board x, right")
    yield PageLine(x, y, x, y - length)
    yield PageLine(x, y - length, x - head / 2, y - length + head)
    yield PageLine(x, y - length, x + head / 2, y - length + head)
    yield PageText(x, y - length - 1.8, "board y, up")


_POINTS_PER_MM = 72 / 25.4
_PX_PER_MM = 600 / 25.4


def pdf_bytes(sheets: Sequence[PrintedPage]) -> bytes:
    """Return a deterministic PDF with a page per sheet and the preference for unscaled printing.

    Raises:
        ResourceError: the package reportlab is not installed.
    """
    try:
        from reportlab.pdfgen.canvas import Canvas
    except ImportError as error:
        raise ResourceError(
            "writing PDF needs the package reportlab: run `pip install 'yamsim[print]'`, or ask for .png instead"
        ) from error

    buffer = io.BytesIO()
    # `invariant` omits the date. Compressed pages would depend on the zlib version.
    canvas = Canvas(buffer, invariant=1, pageCompression=0, pdfVersion=(1, 6))
    canvas.setTitle(", ".join(sheet.title for sheet in sheets))
    canvas.setCreator("yamsim")
    canvas.setViewerPreference("PrintScaling", "None")
    for sheet in sheets:
        height = sheet.paper.height
        canvas.setPageSize((sheet.paper.width * _POINTS_PER_MM, height * _POINTS_PER_MM))
        canvas.scale(_POINTS_PER_MM, _POINTS_PER_MM)  # mm, y up
        canvas.setLineWidth(LINE_WIDTH)
        for mark in sheet.marks:
            match mark:
                case PrintedMarker():
                    # Viewers antialias each path separately: separate cells would show seams.
                    path = canvas.beginPath()
                    for x, y, width in _black_runs(mark):
                        path.rect(x, height - y - mark.cell, width, mark.cell)
                    canvas.drawPath(path, stroke=0, fill=1)
                case PageBar():
                    canvas.rect(mark.x, height - mark.y - mark.height, mark.width, mark.height, stroke=0, fill=1)
                case PageLine():
                    canvas.line(mark.x0, height - mark.y0, mark.x1, height - mark.y1)
                case PageText():
                    canvas.setFont("Helvetica-Bold" if mark.bold else "Helvetica", mark.size)
                    draw = {
                        "left": canvas.drawString,
                        "right": canvas.drawRightString,
                        "centre": canvas.drawCentredString,
                    }
                    draw[mark.align](mark.x, height - mark.y, mark.text)
        canvas.showPage()
    canvas.save()
    return buffer.getvalue()


def png_bytes(sheet: PrintedPage) -> bytes:
    """Return a grey PNG of the page, near 600 dpi with whole pixels for marker cells.

    The file's integer pixels per metre cause a scale error of at most 0.003 %.
    """
    image, px_per_mm = _draw_page(sheet)
    return encode_png(image, px_per_mm * 1000)


def _black_runs(marker: PrintedMarker) -> Iterator[tuple[float, float, float]]:
    """Yield runs of black cells as (left, top, width)."""
    for row, cells in enumerate(marker.black):
        steps = np.diff(cells.astype(np.int8), prepend=0, append=0)
        for start, end in zip(np.flatnonzero(steps == 1), np.flatnonzero(steps == -1), strict=True):
            yield marker.x + float(start) * marker.cell, marker.y + row * marker.cell, float(end - start) * marker.cell


def _draw_page(sheet: PrintedPage) -> tuple[Image, float]:
    cell_px = _cell_px(sheet)
    cell = next(mark.cell for mark in sheet.marks if isinstance(mark, PrintedMarker))
    scale = cell_px / cell
    image = np.full((round(sheet.paper.height * scale), round(sheet.paper.width * scale)), WHITE, dtype=np.uint8)
    thickness = max(1, round(LINE_WIDTH * scale))
    for mark in sheet.marks:
        match mark:
            case PrintedMarker():
                pixels = mark.black.repeat(cell_px, 0).repeat(cell_px, 1)
                top, left = round(mark.y * scale), round(mark.x * scale)
                image[top : top + len(pixels), left : left + len(pixels)][pixels] = 0
            case PageBar():
                top, left = round(mark.y * scale), round(mark.x * scale)
                bottom, right = round((mark.y + mark.height) * scale), round((mark.x + mark.width) * scale)
                image[top:bottom, left:right] = 0
            case PageLine():
                start = math.floor(mark.x0 * scale), math.floor(mark.y0 * scale)
                end = math.floor(mark.x1 * scale), math.floor(mark.y1 * scale)
                cv2.line(image, start, end, (0,), thickness)
            case PageText():
                _draw_text(image, mark, scale)
    return image, scale


def _cell_px(sheet: PrintedPage) -> int:
    """Return the pixels per cell near 600 dpi that put markers nearest to whole pixels."""
    markers = [mark for mark in sheet.marks if isinstance(mark, PrintedMarker)]
    cell = markers[0].cell
    offsets = np.array([(mark.x - markers[0].x, mark.y - markers[0].y) for mark in markers]) / cell
    wanted = cell * _PX_PER_MM
    choices = range(max(1, math.ceil(0.95 * wanted)), math.floor(1.05 * wanted) + 2)

    def rounding_error(cell_px: int) -> tuple[float, float]:
        places = offsets * cell_px
        return round(float(np.abs(places - places.round()).max()), 6), abs(cell_px - wanted)

    return min(choices, key=rounding_error)


_HERSHEY_UNITS = 21  # height of capitals, units of OpenCV's Hershey fonts
_CAPITAL_HEIGHT = 0.718  # height of capitals over the font size, Helvetica


def _draw_text(image: Image, text: PageText, scale: float) -> None:
    font, size = cv2.FONT_HERSHEY_SIMPLEX, _CAPITAL_HEIGHT * text.size * scale / _HERSHEY_UNITS
    thickness = max(1, round(text.size * scale / (9 if text.bold else 22)))
    (width, _), _ = cv2.getTextSize(text.text, font, size, thickness)
    left = text.x * scale - {"left": 0.0, "right": 1.0, "centre": 0.5}[text.align] * width
    cv2.putText(image, text.text, (round(left), round(text.y * scale)), font, size, (0,), thickness, cv2.LINE_AA)
