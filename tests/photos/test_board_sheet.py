"""Boards as images, and their printed pages."""

import builtins
import re
import shutil
import struct
import subprocess

import cv2
import numpy as np
import pytest

from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.errors import ConfigError, ResourceError
from yamsim_cli.core.geometry.board import Board
from yamsim_cli.core.geometry.camera import Intrinsics, project_points
from yamsim_cli.core.geometry.se3 import pose, rotation_from_vector
from yamsim_cli.core.images.board_image import board_image, board_texture, marker_cells
from yamsim_cli.photos.board_sheet import (
    PAPERS,
    PageBar,
    PageLine,
    PageText,
    PrintedMarker,
    board_sheet,
    pdf_bytes,
    png_bytes,
)

BOARD = Board("larger_coarse_board", 217, 3, 3, "DICT_6X6_250", 29.230769e-3, 2.9230769e-3)
SECOND = Board("larger_coarse_board_arm2", 226, 3, 3, "DICT_6X6_250", 29.230769e-3, 2.9230769e-3)
UNEVEN = Board("uneven", 0, 4, 3, "DICT_4X4_50", 21.37e-3, 4.441e-3)

papers = pytest.mark.parametrize("paper", PAPERS.values(), ids=PAPERS)


@pytest.fixture
def reportlab():
    return pytest.importorskip("reportlab")


def detect(image, dictionary="DICT_6X6_250", refine=cv2.aruco.CORNER_REFINE_NONE):
    """Return id -> corners (4, 2) of the markers in an image."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = refine
    known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
    corners, ids, _ = cv2.aruco.ArucoDetector(known, parameters).detectMarkers(image)
    return {int(i): c.reshape(4, 2) for i, c in zip(ids.ravel(), corners, strict=True)}


def assert_true_size(image, px_per_mm, board):
    """Assert that all markers are found, at the board's distances: within 0.1 mm and, over the whole board, 0.1 %."""
    found = detect(image, board.dictionary, cv2.aruco.CORNER_REFINE_SUBPIX)
    assert tuple(sorted(found)) == board.marker_ids
    seen = np.array([found[i] for i in board.marker_ids]) / px_per_mm
    true = board.marker_corners()[..., :2] * (1000, -1000)
    assert np.abs((seen - seen.mean((0, 1))) - (true - true.mean((0, 1)))).max() < 0.1
    edges = np.linalg.norm(seen - np.roll(seen, 1, axis=1), axis=2)
    assert np.abs(edges - board.marker_length * 1000).max() < 0.1
    # Centres, because the edge's blur cancels out.
    spread = np.linalg.norm(seen.mean(1)[-1] - seen.mean(1)[0]) / np.linalg.norm(true.mean(1)[-1] - true.mean(1)[0])
    assert spread == pytest.approx(1, abs=1e-3)


def extent(mark, size=0.75):
    """A generous box around a mark: left, top, right, bottom in mm."""
    match mark:
        case PageBar():
            return mark.x, mark.y, mark.x + mark.width, mark.y + mark.height
        case PageLine():
            return min(mark.x0, mark.x1), min(mark.y0, mark.y1), max(mark.x0, mark.x1), max(mark.y0, mark.y1)
        case PrintedMarker():
            edge = mark.cell * len(mark.black)
            return mark.x, mark.y, mark.x + edge, mark.y + edge
        case PageText():
            width = len(mark.text) * mark.size * 0.62
            left = mark.x - width * {"left": 0, "right": 1, "centre": 0.5}[mark.align]
            return left, mark.y - mark.size * size, left + width, mark.y + mark.size * 0.25


@papers
@pytest.mark.parametrize("board", [BOARD, UNEVEN], ids=lambda board: board.name)
def test_the_sheet_has_the_documented_layout(paper, board):
    sheet = board_sheet(board, "arm1", paper)
    boxes = np.array([extent(mark) for mark in sheet.marks])
    assert (
        (boxes[:, :2] >= 5).all() and (boxes[:, 2] <= paper.width - 5).all() and (boxes[:, 3] <= paper.height - 5).all()
    )

    markers = np.array([extent(mark) for mark in sheet.marks if isinstance(mark, PrintedMarker)])
    left, top, right, bottom = *markers[:, :2].min(0), *markers[:, 2:].max(0)
    assert (right - left, bottom - top) == pytest.approx((board.width * 1000, board.height * 1000))
    quiet = max(5.0, board.marker_length * 1000 / (markers.shape[1] + 2)) - 1e-9
    others = np.array([extent(mark) for mark in sheet.marks if not isinstance(mark, PrintedMarker)])
    gaps = np.max([left - others[:, 2], others[:, 0] - right, top - others[:, 3], others[:, 1] - bottom], axis=0)
    assert gaps.min() >= min(quiet, 5.0)

    texts = np.array([extent(mark) for mark in sheet.marks if isinstance(mark, PageText)])
    overlaps = (texts[:, None, :2] < texts[None, :, 2:]).all(2) & (texts[None, :, :2] < texts[:, None, 2:]).all(2)
    assert overlaps.sum() == len(texts)
    lines = np.array([extent(mark) for mark in sheet.marks if isinstance(mark, PageLine)])
    assert not (
        (texts[:, None, :2] < lines[None, :, 2:]).all(2) & (lines[None, :, :2] < texts[:, None, 2:]).all(2)
    ).any()


def test_the_sheet_has_the_documented_text():
    words = " ".join(mark.text for mark in board_sheet(BOARD, "arm1", PAPERS["A4"]).marks if isinstance(mark, PageText))
    for part in ("arm1: larger_coarse_board", "217 to 225", "DICT_6X6_250", "29.231 mm", "A4", "100 %", "100.0 mm"):
        assert part in words
    assert words.isascii()


@papers
def test_both_rulers_are_100_mm_with_a_tick_a_millimetre(paper):
    marks = board_sheet(BOARD, "arm1", paper).marks
    level, upright = sorted((mark for mark in marks if isinstance(mark, PageBar)), key=lambda bar: bar.height)
    assert (level.width, upright.height) == (100.0, 100.0)
    lines = [mark for mark in marks if isinstance(mark, PageLine)]
    across = sorted(line.x0 - level.x for line in lines if line.y0 == level.y + level.height)
    down = sorted(line.y0 - upright.y for line in lines if line.x0 == upright.x)
    assert across == pytest.approx(range(101)) and down == pytest.approx(range(101))


def test_a_board_that_does_not_fit_says_by_how_much():
    board = Board("huge", 0, 5, 5, "DICT_6X6_250", 0.04, 0.004)
    with pytest.raises(ConfigError, match=r"'huge' is 216\.0 x 216\.0 mm .* needs 276\.0 x .* A4 is 210 x 297 mm"):
        board_sheet(board, "arm1", PAPERS["A4"])


@papers
@pytest.mark.usefixtures("reportlab")
def test_the_pdf_draws_in_true_millimetres(paper):
    text = pdf_bytes([board_sheet(BOARD, "arm1", paper)]).decode("latin-1")
    box = [float(value) * 25.4 / 72 for value in re.search(r"/MediaBox \[ (.*?) \]", text)[1].split()]
    assert box == pytest.approx([0, 0, paper.width, paper.height], abs=1e-3)
    assert "/PrintScaling /None" in text
    scale = float(re.search(r"^(2\.\S+) 0 0 \1 0 0 cm", text, re.MULTILINE)[1])
    rectangles = np.array(
        [[float(value) for value in line.split()] for line in re.findall(r"(\S+ \S+ \S+ \S+) re", text)]
    )
    mm = rectangles * scale * 25.4 / 72
    cell = 29.230769 / 8
    assert sorted(mm[np.isclose(mm[:, 2], 100, atol=1e-3), 2]) == pytest.approx([100.0], abs=1e-3)
    assert sorted(mm[np.isclose(mm[:, 3], 100, atol=1e-3), 3]) == pytest.approx([100.0], abs=1e-3)
    cells = mm[np.isclose(mm[:, 3], cell, atol=1e-3)]
    assert len(cells) == len(mm) - 2
    low, high = cells[:, :2].min(0), (cells[:, :2] + cells[:, 2:]).max(0)
    assert high - low == pytest.approx([BOARD.width * 1000, BOARD.height * 1000], abs=1e-3)


@pytest.mark.slow
@pytest.mark.usefixtures("reportlab")
@pytest.mark.skipif(shutil.which("pdftoppm") is None, reason="poppler-utils is not here: tools/ensure_test_programs.sh")
@papers
def test_a_rendered_pdf_has_every_marker_at_true_size(paper, tmp_path):
    boards = [BOARD, SECOND]
    (tmp_path / "boards.pdf").write_bytes(pdf_bytes([board_sheet(board, "arm", paper) for board in boards]))
    dpi = 200
    subprocess.run(
        ["pdftoppm", "-r", str(dpi), "-gray", str(tmp_path / "boards.pdf"), str(tmp_path / "page")],
        check=True,
        timeout=60,
    )
    pages = sorted(tmp_path.glob("page*.pgm"))
    assert len(pages) == len(boards)
    for page, board in zip(pages, boards, strict=True):
        image = cv2.imread(str(page), cv2.IMREAD_GRAYSCALE)
        assert image.shape == pytest.approx((paper.height / 25.4 * dpi, paper.width / 25.4 * dpi), abs=1.01)
        assert_true_size(image, dpi / 25.4, board)


@pytest.mark.parametrize("board", [BOARD, UNEVEN], ids=lambda board: board.name)
def test_a_png_prints_at_true_size(board):
    data = png_bytes(board_sheet(board, "arm1", PAPERS["A4"]))
    start = data.index(b"pHYs") + 4
    px_per_metre, down, unit = struct.unpack(">IIB", data[start : start + 9])
    assert px_per_metre == down and unit == 1
    assert px_per_metre * 0.0254 == pytest.approx(600, rel=0.06)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert np.array(image.shape) / px_per_metre * 1000 == pytest.approx([297, 210], abs=0.05)
    assert_true_size(image, px_per_metre / 1000, board)

    # The marker's edge, pixel by pixel: its scale differs by the rounding of pixels per metre to an integer.
    column = np.flatnonzero((image < 128).sum(axis=0) > 0.1 * image.shape[0])
    runs = np.split(column, np.flatnonzero(np.diff(column) > 1) + 1)
    edges = [len(run) for run in runs if len(run) > 200]
    assert len(edges) == board.columns
    assert np.array(edges) / px_per_metre == pytest.approx(board.marker_length, rel=5e-5)


@pytest.mark.usefixtures("reportlab")
def test_the_same_sheet_gives_the_same_bytes():
    def both():
        sheet = board_sheet(BOARD, "arm1", PAPERS["Letter"])
        return pdf_bytes([sheet]), png_bytes(sheet)

    assert both() == both()


def test_without_the_extra_the_error_names_it(monkeypatch):
    real = builtins.__import__

    def missing(name, *rest):
        if name.startswith("reportlab"):
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(ResourceError, match=r"pip install 'yamsim\[print\]'"):
        pdf_bytes([board_sheet(BOARD, "arm1", PAPERS["A4"])])


def test_all_markers_of_the_bimanual_rig_are_found_where_the_board_has_them(locations):
    rig = load_config(RigConfig, "rigs", "bimanual", locations)
    cell, quiet = 10, 2
    seen = []
    for board in (arm.board.board_in_metres for arm in rig.arms):
        found = detect(board_image(board, cell, quiet))
        assert tuple(sorted(found)) == board.marker_ids
        px_per_metre = 8 * cell / board.marker_length
        # From the `board` frame, y up, to pixel centres, y down.
        places = board.marker_corners()[..., :2] * (1, -1) + (board.width / 2, board.height / 2)
        expected = places * px_per_metre + quiet * cell - 0.5
        # OpenCV gives the outermost black pixels: half a pixel inside the edge.
        assert np.abs(np.array([found[i] for i in board.marker_ids]) - expected).max() < 0.6
        seen += found
    assert sorted(seen) == list(range(217, 235))


def test_a_camera_sees_the_corners_where_the_board_frame_puts_them():
    cell, quiet = 20, 2
    image = board_image(BOARD, cell, quiet)
    camera = Intrinsics(640, 480, 600, 600, 319.5, 239.5)
    # Facing the camera, rotated by 180 degrees about x, then tilted and turned.
    T_board_in_cam = pose((0.01, -0.02, 0.35), rotation_from_vector((0.3, 0.4, 0.2)) @ np.diag([1.0, -1.0, -1.0]))
    scale = BOARD.marker_length / (8 * cell)
    middle = (np.array(image.shape[::-1]) - 1) / 2
    board_from_pixel = np.array([[scale, 0, -scale * middle[0]], [0, -scale, scale * middle[1]], [0, 0, 1]])
    cam_from_pixel = camera.K @ T_board_in_cam[:3, [0, 1, 3]] @ board_from_pixel
    photo = cv2.warpPerspective(image, cam_from_pixel, (640, 480), flags=cv2.INTER_AREA, borderValue=(128,))

    found = detect(photo)
    assert tuple(sorted(found)) == BOARD.marker_ids
    corners = BOARD.marker_corners().reshape(-1, 3) @ T_board_in_cam[:3, :3].T + T_board_in_cam[:3, 3]
    expected = project_points(camera.K, corners).reshape(-1, 4, 2)
    assert np.abs(np.array([found[i] for i in BOARD.marker_ids]) - expected).max() < 1.5


def test_markers_are_opencvs_and_gaps_are_white():
    cell = 10
    image = board_image(BOARD, cell, quiet_cells=1)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250)
    assert image.shape == (276, 276)  # 2 quiet zones, 3 markers of 8 cells, 2 gaps of 0.8
    seen = np.full_like(image, 255)
    for k, number in enumerate(BOARD.marker_ids):
        y, x = (10 + part * 88 for part in divmod(k, 3))
        seen[y : y + 80, x : x + 80] = dictionary.generateImageMarker(number, 80, borderBits=1)
    assert np.array_equal(image, seen)


def test_an_uneven_gap_shifts_no_marker_by_more_than_half_a_pixel():
    board = Board("uneven", 0, 6, 2, "DICT_4X4_50", 0.02, 0.00377)
    found = detect(board_image(board, 10, 2), board.dictionary)
    assert tuple(sorted(found)) == board.marker_ids
    places = (board.marker_corners()[..., :2] * (1, -1) + (board.width / 2, board.height / 2)) * 60 / 0.02 + 20 - 0.5
    assert np.abs(np.array([found[i] for i in board.marker_ids]) - places).max() < 1.1


def test_a_texture_is_the_board_to_its_edge():
    texture = board_texture(BOARD)
    assert texture.shape == (512, 512)
    assert not texture[0, 0] and not texture[-1, -1]
    assert np.array_equal(np.pad(texture, 20, constant_values=255), board_image(BOARD, 20, 1))


def test_unknown_dictionaries_and_ids_name_what_would_be_valid():
    def cells(first_id, columns, dictionary):
        return marker_cells(Board("odd", first_id, columns, 1, dictionary, 0.03, 0.003))

    assert cells(249, 1, "DICT_6X6_250").shape == (1, 8, 8)
    assert cells(0, 1, "DICT_4X4_50").shape == (1, 6, 6)
    with pytest.raises(
        ConfigError, match=r"'odd': unknown dictionary 'DICT_6X6_25'; did you mean 'DICT_6X6_250'.*DICT_5X5"
    ):
        cells(0, 1, "DICT_6X6_25")
    with pytest.raises(ConfigError, match=r"ids 240\.\.250, but DICT_6X6_250 ends at 249; choose a first_id up to 239"):
        cells(240, 11, "DICT_6X6_250")
    with pytest.raises(ConfigError, match="51 markers, but DICT_4X4_50 only 50"):
        cells(0, 51, "DICT_4X4_50")
