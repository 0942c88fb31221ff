"""Photos without a board of a rig, with objects that look like one."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from yamsim_cli.core.geometry.board import Board
from yamsim_cli.core.images.board_image import board_image

Picture = np.ndarray

# Dictionaries of other boards, and their numbers of markers.
DICTIONARIES = {"DICT_4X4_250": 250, "DICT_5X5_1000": 1000, "DICT_6X6_1000": 1000, "DICT_7X7_250": 250}
SIDE = 520


def _board(rng: np.random.Generator, ours: Board, dictionary: str, first_id: int) -> Picture:
    """A grid of other markers, with our board's measures."""
    return board_image(replace(ours, dictionary=dictionary, first_id=first_id), 16, quiet_cells=1)


def other_dictionary(rng: np.random.Generator, ours: Board) -> Picture:
    name = str(rng.choice([one for one in DICTIONARIES if one != ours.dictionary]))
    # Larger dictionaries of a size begin with the smaller ones: our ids are left out.
    return _board(rng, ours, name, int(rng.integers(0, 190)))


def other_ids(rng: np.random.Generator, ours: Board) -> Picture:
    return _board(rng, ours, ours.dictionary, int(rng.integers(0, 200)))


def mirrored(rng: np.random.Generator, ours: Board) -> Picture:
    return board_image(ours, 16, quiet_cells=1)[:, ::-1]


def inverted(rng: np.random.Generator, ours: Board) -> Picture:
    return 255 - board_image(ours, 16, quiet_cells=0)


def shuffled(rng: np.random.Generator, ours: Board) -> Picture:
    """Random bits in our grid: a board of no dictionary."""
    image = board_image(ours, 16, quiet_cells=1)
    step = (ours.marker_length + ours.gap) / ours.marker_length * 128
    for k in range(len(ours.marker_ids)):
        row, column = divmod(k, ours.columns)
        top, left = 32 + round(row * step), 32 + round(column * step)
        image[top : top + 96, left : left + 96] = (255 * rng.integers(0, 2, (6, 6))).repeat(16, 0).repeat(16, 1)
    return image


def qr_code(rng: np.random.Generator, ours: Board) -> Picture:
    text = "".join(rng.choice(list("abcdefghijklmnopqrstuvwxyz0123456789"), int(rng.integers(8, 90))))
    code = cv2.QRCodeEncoder.create().encode(text)
    return cv2.resize(code, (SIDE, SIDE), interpolation=cv2.INTER_NEAREST)


def checkerboard(rng: np.random.Generator, ours: Board) -> Picture:
    rows, columns = rng.integers(3, 14, 2)
    cells = (np.indices((rows, columns)).sum(axis=0) % 2).astype(np.uint8) * 255
    return cells.repeat(SIDE // columns, 0).repeat(SIDE // columns, 1)


def text(rng: np.random.Generator, ours: Board) -> Picture:
    page = np.full((SIDE, SIDE), 245, np.uint8)
    size = float(rng.uniform(0.4, 1.6))
    for y in range(20, SIDE, int(26 * size) + 6):
        line = "".join(rng.choice(list("etaoin shrdlu cmfwyp ETAOIN 0123"), 60))
        cv2.putText(page, line, (10, y), int(rng.choice([0, 2, 3, 4])), size, 20, int(rng.integers(1, 4)), cv2.LINE_AA)
    return page


def keyboard(rng: np.random.Generator, ours: Board) -> Picture:
    rows, columns = int(rng.integers(3, 6)), int(rng.integers(3, 13))
    key, gap = 60, int(rng.integers(4, 12))
    board = np.full((rows * (key + gap) + gap, columns * (key + gap) + gap), int(rng.integers(90, 230)), np.uint8)
    for row in range(rows):
        for column in range(columns):
            x, y = gap + column * (key + gap), gap + row * (key + gap)
            cv2.rectangle(board, (x, y), (x + key, y + key), int(rng.integers(15, 60)), -1)
            letter = chr(int(rng.integers(65, 91)))
            cv2.putText(board, letter, (x + 14, y + 42), 0, 1.1, int(rng.integers(150, 255)), 2, cv2.LINE_AA)
    return board


def windows(rng: np.random.Generator, ours: Board) -> Picture:
    rows, columns = int(rng.integers(2, 8)), int(rng.integers(2, 8))
    wide, high = int(rng.integers(30, 80)), int(rng.integers(30, 80))
    gap = int(rng.integers(3, 30))
    wall = np.full((rows * (high + gap) + gap, columns * (wide + gap) + gap), int(rng.integers(150, 250)), np.uint8)
    for row in range(rows):
        for column in range(columns):
            x, y = gap + column * (wide + gap), gap + row * (high + gap)
            pane = rng.integers(10, 130, (int(rng.integers(1, 5)), int(rng.integers(1, 5)))).astype(np.uint8)
            wall[y : y + high, x : x + wide] = cv2.resize(pane, (wide, high), interpolation=cv2.INTER_NEAREST)
    return wall


KINDS: dict[str, Callable[[np.random.Generator, Board], Picture]] = {
    "boards of other dictionaries": other_dictionary,
    "boards with other ids": other_ids,
    "our boards mirrored": mirrored,
    "our boards inverted": inverted,
    "our grid with random bits": shuffled,
    "QR codes": qr_code,
    "checkerboards": checkerboard,
    "text": text,
    "keyboards": keyboard,
    "grids of windows": windows,
}


def stranger(rng: np.random.Generator, kind: str, ours: Board, size: tuple[int, int] = (640, 480)) -> Picture:
    """A grey photo (height, width) of one to three objects of a kind, at random places, tilts, blurs and lights."""
    width, height = size
    ground = cv2.resize(rng.integers(60, 220, (5, 6)).astype(np.float32), size, interpolation=cv2.INTER_CUBIC)
    for _ in range(int(rng.integers(1, 4))):
        picture = KINDS[kind](rng, ours).astype(np.float32)
        high, wide = picture.shape
        # Drawn at a higher resolution, which a lens would average.
        across = float(math.exp(rng.uniform(math.log(25), math.log(320))))
        turn, slant = rng.uniform(-math.pi, math.pi), math.radians(rng.uniform(0, 72))
        flat = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * (0.5, 0.5 * high / wide) * across
        spin, lean = _turn(turn), _turn(rng.uniform(-math.pi, math.pi))
        squeezed = flat @ spin.T @ lean.T * (1, math.cos(slant))
        depth = 1 + squeezed[:, 1] * math.tan(slant) / 600
        at = (squeezed / depth[:, None]) @ lean + rng.uniform((40, 40), (width - 40, height - 40))
        finer = 3
        corners = np.array([[0, 0], [wide, 0], [wide, high], [0, high]], np.float32) - 0.5
        seen = cv2.getPerspectiveTransform(corners, ((at + 0.5) * finer - 0.5).astype(np.float32))
        shape = (width * finer, height * finer)
        laid = cv2.warpPerspective(picture + 1, seen, shape, flags=cv2.INTER_AREA)
        on = cv2.resize((laid > 0).astype(np.float32), size, interpolation=cv2.INTER_AREA)
        mean = cv2.resize(np.maximum(laid - 1, 0), size, interpolation=cv2.INTER_AREA)
        black, white = rng.uniform(10, 60), rng.uniform(150, 250)
        ground = ground * (1 - on) + black * on + mean * (white - black) / 255
    blurred = cv2.GaussianBlur(ground, (0, 0), float(math.exp(rng.uniform(math.log(0.4), math.log(4)))))
    noisy = blurred + rng.normal(0, rng.uniform(0.5, 6), blurred.shape)
    return np.clip(np.round(noisy), 0, 255).astype(np.uint8)


def _turn(angle: float) -> np.ndarray:
    return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
