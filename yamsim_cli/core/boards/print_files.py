"""Writes sheets as a PDF of vector shapes, or as a PNG with its resolution."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Sequence

import cv2
import numpy as np

from ..errors import ResourceError
from ..images.image import Image
from ..images.png import encode_png
from .board_image import WHITE
from .sheet import LINE_WIDTH, Bar, Line, PrintedMarker, Sheet, Text

_POINTS_PER_MM = 72 / 25.4
_PX_PER_MM = 600 / 25.4


def pdf_bytes(sheets: Sequence[Sheet]) -> bytes:
    """A PDF with a page for each sheet, which asks viewers to print it unscaled. The same sheets give the same bytes.

    Raises:
        ResourceError: the package that writes PDF is not installed.
    """
    try:
        from reportlab.pdfgen.canvas import Canvas
    except ImportError as error:
        raise ResourceError(
            "writing PDF needs the package reportlab: run `pip install 'yamsim[print]'`, or ask for .png instead"
        ) from error

    buffer = io.BytesIO()
    # `invariant` leaves out the date. Pages are not compressed, so that the bytes do not depend on the zlib version.
    canvas = Canvas(buffer, invariant=1, pageCompression=0, pdfVersion=(1, 6))
    canvas.setTitle(", ".join(sheet.title for sheet in sheets))
    canvas.setCreator("yamsim")
    canvas.setViewerPreference("PrintScaling", "None")
    for sheet in sheets:
        height = sheet.paper.height
        canvas.setPageSize((sheet.paper.width * _POINTS_PER_MM, height * _POINTS_PER_MM))
        canvas.scale(_POINTS_PER_MM, _POINTS_PER_MM)  # Millimetres from here on, with y up.
        canvas.setLineWidth(LINE_WIDTH)
        for mark in sheet.marks:
            match mark:
                case PrintedMarker():
                    # One path for each marker: viewers smooth each path by itself, so that single cells show seams.
                    path = canvas.beginPath()
                    for x, y, width in _runs(mark):
                        path.rect(x, height - y - mark.cell, width, mark.cell)
                    canvas.drawPath(path, stroke=0, fill=1)
                case Bar():
                    canvas.rect(mark.x, height - mark.y - mark.height, mark.width, mark.height, stroke=0, fill=1)
                case Line():
                    canvas.line(mark.x0, height - mark.y0, mark.x1, height - mark.y1)
                case Text():
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


def png_bytes(sheet: Sheet) -> bytes:
    """A grey PNG of the whole page, at a resolution near 600 dpi at which marker cells are whole pixels.

    The file holds the resolution as a whole number of pixels per metre, so that a print is off by 0.003 % at most.
    """
    image, px_per_mm = _raster(sheet)
    return encode_png(image, px_per_mm * 1000)


def _runs(marker: PrintedMarker) -> Iterator[tuple[float, float, float]]:
    """Runs of black cells side by side, as (left, top, width)."""
    for row, cells in enumerate(marker.black):
        # +1 where a run begins, -1 behind its end.
        steps = np.diff(cells.astype(np.int8), prepend=0, append=0)
        for start, end in zip(np.flatnonzero(steps == 1), np.flatnonzero(steps == -1), strict=True):
            yield marker.x + float(start) * marker.cell, marker.y + row * marker.cell, float(end - start) * marker.cell


def _raster(sheet: Sheet) -> tuple[Image, float]:
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
            case Bar():
                top, left = round(mark.y * scale), round(mark.x * scale)
                bottom, right = round((mark.y + mark.height) * scale), round((mark.x + mark.width) * scale)
                image[top:bottom, left:right] = 0
            case Line():
                # Pixel k covers k..k+1.
                start = math.floor(mark.x0 * scale), math.floor(mark.y0 * scale)
                end = math.floor(mark.x1 * scale), math.floor(mark.y1 * scale)
                cv2.line(image, start, end, (0,), thickness)
            case Text():
                _write(image, mark, scale)
    return image, scale


def _cell_px(sheet: Sheet) -> int:
    """Pixels to a marker's cell: near 600 dpi, so that the markers' places are as near to whole pixels as possible."""
    markers = [mark for mark in sheet.marks if isinstance(mark, PrintedMarker)]
    cell = markers[0].cell
    offsets = np.array([(mark.x - markers[0].x, mark.y - markers[0].y) for mark in markers]) / cell
    wanted = cell * _PX_PER_MM
    choices = range(max(1, math.ceil(0.95 * wanted)), math.floor(1.05 * wanted) + 2)

    def miss(cell_px: int) -> tuple[float, float]:
        places = offsets * cell_px
        return round(float(np.abs(places - places.round()).max()), 6), abs(cell_px - wanted)

    return min(choices, key=miss)


# Height of capitals: in OpenCV's Hershey fonts, units; in Helvetica, as a share of the font size. Source: both fonts.
_HERSHEY_UNITS = 21
_CAPITALS = 0.718


def _write(image: Image, text: Text, scale: float) -> None:
    font, size = cv2.FONT_HERSHEY_SIMPLEX, _CAPITALS * text.size * scale / _HERSHEY_UNITS
    thickness = max(1, round(text.size * scale / (9 if text.bold else 22)))
    (width, _), _ = cv2.getTextSize(text.text, font, size, thickness)
    left = text.x * scale - {"left": 0.0, "right": 1.0, "centre": 0.5}[text.align] * width
    cv2.putText(image, text.text, (round(left), round(text.y * scale)), font, size, (0,), thickness, cv2.LINE_AA)
