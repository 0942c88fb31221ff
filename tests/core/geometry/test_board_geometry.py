import cv2
import numpy as np
import pytest

from yamsim_cli.core.geometry.board import Board
from yamsim_cli.core.geometry.se3 import pose

BOARD = Board("b", 217, 3, 3, "DICT_6X6_250", 0.0292, 0.0029)
WIDE = Board("wide", 0, 4, 2, "DICT_4X4_50", 0.02, 0.005)


@pytest.mark.parametrize("board", [BOARD, WIDE], ids=lambda board: board.name)
def test_board_cv_is_the_frame_of_opencvs_grid_board(board):
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    grid = cv2.aruco.GridBoard(
        (board.columns, board.rows), board.marker_length, board.gap, dictionary, np.array(board.marker_ids)
    )
    T = pose((board.width / 2, board.height / 2, 0.0), np.diag([1.0, -1.0, -1.0]))
    ours = board.marker_corners() @ T[:3, :3].T + T[:3, 3]
    assert tuple(grid.getIds().ravel()) == board.marker_ids
    assert np.allclose(ours, np.array(grid.getObjPoints()), atol=1e-7)


@pytest.mark.parametrize("board", [BOARD, WIDE], ids=lambda board: board.name)
def test_the_board_frame_has_its_origin_in_the_middle_and_y_up(board):
    corners = board.marker_corners()
    assert np.allclose(corners.reshape(-1, 3).mean(axis=0), 0, atol=1e-12)
    assert np.allclose(corners[0, 0], (-board.width / 2, board.height / 2, 0))
    assert np.allclose(corners[-1, 2], (board.width / 2, -board.height / 2, 0))
    # Clockwise as seen on the paper, so against +z.
    edges = np.diff(corners[:, :3], axis=1)
    assert (np.cross(edges[:, 0], edges[:, 1])[:, 2] < 0).all()
