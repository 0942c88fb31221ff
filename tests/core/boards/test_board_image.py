import struct
import zlib

import cv2
import numpy as np
import pytest

from yamsim_cli.core.boards.board_image import board_image, board_texture, marker_cells
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.errors import ConfigError
from yamsim_cli.core.geometry.board import Board
from yamsim_cli.core.geometry.camera import Intrinsics, project
from yamsim_cli.core.geometry.se3 import pose, rotation_from_vector
from yamsim_cli.core.images.png import encode_png

BOARD = Board("b", 217, 3, 3, "DICT_6X6_250", 29.230769e-3, 2.9230769e-3)


def detect(image, name="DICT_6X6_250"):
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(image)
    return {} if ids is None else {int(i): c.reshape(4, 2) for i, c in zip(ids.ravel(), corners, strict=True)}


def test_all_markers_of_the_bimanual_rig_are_found_where_the_board_has_them(locations):
    rig = load_config(RigConfig, "rigs", "bimanual", locations)
    cell, quiet = 10, 2
    seen = []
    for board in (arm.board.board for arm in rig.arms):
        found = detect(board_image(board, cell, quiet))
        assert tuple(sorted(found)) == board.ids
        px_per_metre = 8 * cell / board.marker_length
        # From the `board` frame, y up, to pixel centres, y down.
        places = board.corners()[..., :2] * (1, -1) + (board.width / 2, board.height / 2)
        expected = places * px_per_metre + quiet * cell - 0.5
        # OpenCV gives the outermost black pixels: half a pixel inside the edge.
        assert np.abs(np.array([found[i] for i in board.ids]) - expected).max() < 0.6
        seen += found
    assert sorted(seen) == list(range(217, 235))


def test_a_camera_sees_the_corners_where_the_board_frame_puts_them():
    cell, quiet = 20, 2
    image = board_image(BOARD, cell, quiet)
    camera = Intrinsics(640, 480, 600, 600, 319.5, 239.5)
    # Facing the camera, turned by 180 degrees about x, then tilted and turned.
    T_board_in_cam = pose((0.01, -0.02, 0.35), rotation_from_vector((0.3, 0.4, 0.2)) @ np.diag([1.0, -1.0, -1.0]))
    scale = BOARD.marker_length / (8 * cell)
    middle = (np.array(image.shape[::-1]) - 1) / 2
    board_from_pixel = np.array([[scale, 0, -scale * middle[0]], [0, -scale, scale * middle[1]], [0, 0, 1]])
    cam_from_pixel = camera.K @ T_board_in_cam[:3, [0, 1, 3]] @ board_from_pixel
    photo = cv2.warpPerspective(image, cam_from_pixel, (640, 480), flags=cv2.INTER_AREA, borderValue=(128,))

    found = detect(photo)
    assert tuple(sorted(found)) == BOARD.ids
    corners = BOARD.corners().reshape(-1, 3) @ T_board_in_cam[:3, :3].T + T_board_in_cam[:3, 3]
    expected = project(camera.K, corners).reshape(-1, 4, 2)
    assert np.abs(np.array([found[i] for i in BOARD.ids]) - expected).max() < 1.5


def test_markers_are_opencvs_and_gaps_are_white():
    cell = 10
    image = board_image(BOARD, cell, quiet_cells=1)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_6X6_250)
    assert image.shape == (276, 276)  # 2 quiet zones, 3 markers of 8 cells, 2 gaps of 0.8
    seen = np.full_like(image, 255)
    for k, number in enumerate(BOARD.ids):
        y, x = (10 + part * 88 for part in divmod(k, 3))
        seen[y : y + 80, x : x + 80] = dictionary.generateImageMarker(number, 80, borderBits=1)
    assert np.array_equal(image, seen)


def test_an_uneven_gap_shifts_no_marker_by_more_than_half_a_pixel():
    board = Board("uneven", 0, 6, 2, "DICT_4X4_50", 0.02, 0.00377)
    found = detect(board_image(board, 10, 2), board.dictionary)
    assert tuple(sorted(found)) == board.ids
    places = (board.corners()[..., :2] * (1, -1) + (board.width / 2, board.height / 2)) * 60 / 0.02 + 20 - 0.5
    assert np.abs(np.array([found[i] for i in board.ids]) - places).max() < 1.1


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


def test_png_holds_its_scale():
    image = board_image(BOARD, 5)
    plain, scaled = encode_png(image), encode_png(image, 23263.3)
    assert b"pHYs" not in plain
    start = scaled.index(b"pHYs")
    across, down, unit = struct.unpack(">IIB", scaled[start + 4 : start + 13])
    assert (across, down, unit) == (23263, 23263, 1)
    assert scaled[start + 13 : start + 17] == struct.pack(">I", zlib.crc32(scaled[start : start + 13]))
    assert scaled.index(b"IHDR") < start < scaled.index(b"IDAT")
    for data in (plain, scaled):
        assert np.array_equal(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED), image)


def test_png_of_colour_is_rgb():
    image = np.zeros((2, 3, 3), np.uint8)
    image[..., 0] = 200
    decoded = cv2.imdecode(np.frombuffer(encode_png(image), np.uint8), cv2.IMREAD_COLOR)
    assert (decoded[..., 2] == 200).all()
