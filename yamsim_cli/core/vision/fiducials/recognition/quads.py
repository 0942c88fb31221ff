"""Dark four-sided patches in a photo: each may be a whole board whose markers cannot be read, or one of its markers.

Seen from afar or blurred, a print is a patch darker than the paper around it, and so is each marker. Whole prints are
looked for once thin light lines, the gaps between markers among them, are closed. The photo is cut at several grey
levels, since no one level suits every light, and each dark patch that four straight edges enclose well is a candidate.
On ground as bright as it is on average, as steep views make it, a print is a patch full of edges instead.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from ....geometry.se3 import Array

Grey = NDArray[np.uint8]

# How many times smaller the photo is looked at, and how thick light lines (px of that photo) are closed.
_LOOKS = ((1, 3), (2, 3), (2, 7))
_MARKER_LOOKS = ((1, 0),)
# Longer sides of photos that are looked at closest: larger ones are made smaller first.
_LARGEST = 960
# Grey levels at which the photo is cut, as shares of its range.
_LEVELS = np.linspace(0.12, 0.84, 9)
_ENDS = (0.5, 99.5)
# Differences within 3 px from which on a place counts as an edge, as shares of the photo's range, and how far edges may
# be apart in one patch, px; how thick (px) a patch is at least: a single edge is thinner.
_EDGES, _THICK = ((0.14, 3), (0.18, 3), (0.22, 3), (0.27, 3), (0.34, 3), (0.42, 5)), 5
# A patch has at least this area and so long an edge (px of the photo looked at), and at most this share of its sides.
_LEAST_AREA, _LEAST_CONTOUR, _LARGEST_SHARE = 30, 20, 0.8
# How much of its convex hull a patch fills, and how much more than the hull its four edges may enclose.
_FILLED, _LOOSE = 0.78, 1.3
# Candidates whose corners all lie nearer than this share of their size are one.
_SAME = 0.04


def dark_quads(grey: Grey, whole: bool) -> list[Array]:
    """Corners (4, 2) in pixels, clockwise in the picture, of patches in a photo (height, width); each patch once.

    Args:
        whole: with light lines closed, for whole prints; otherwise as they are, for markers.
    """
    grey, factor = _at_most(_LARGEST, grey)
    low, high = np.percentile(grey[::4, ::4], _ENDS)
    found: list[Array] = []
    for smaller, close in _LOOKS if whole else _MARKER_LOOKS:
        look = grey
        if smaller > 1:
            look = np.asarray(
                cv2.resize(grey, None, fx=1 / smaller, fy=1 / smaller, interpolation=cv2.INTER_AREA), dtype=np.uint8
            )
        if close:
            look = np.asarray(cv2.morphologyEx(look, cv2.MORPH_OPEN, np.ones((close, close), np.uint8)), dtype=np.uint8)
        for level in low + _LEVELS * (high - low):
            for quad in _enclosed(look < level):
                found.append(((quad + 0.5) * smaller * factor) - 0.5)
    return _distinct(found)


def restless_quads(grey: Grey) -> list[Array]:
    """Corners (4, 2) in pixels, clockwise in the picture, of patches full of edges in a photo (height, width)."""
    grey, factor = _at_most(_LARGEST, grey)
    low, high = np.percentile(grey[::4, ::4], _ENDS)
    near, thick = np.ones((3, 3), np.uint8), np.ones((_THICK, _THICK), np.uint8)
    difference = cv2.morphologyEx(grey, cv2.MORPH_GRADIENT, near)
    found: list[Array] = []
    for level, apart in _EDGES:
        edges = (difference > level * (high - low)).astype(np.uint8)
        # An edge counts a pixel to either side of it.
        full = cv2.erode(cv2.morphologyEx(edges, cv2.MORPH_CLOSE, np.ones((apart, apart), np.uint8)), near)
        for quad in _enclosed(cv2.morphologyEx(full, cv2.MORPH_OPEN, thick) > 0):
            found.append((quad + 0.5) * factor - 0.5)
    return _distinct(found)


def _at_most(longest: int, grey: Grey) -> tuple[Grey, float]:
    """A photo whose longer side is at most so long, and how many times smaller it is."""
    factor = max(1.0, max(grey.shape) / longest)
    if factor > 1:
        size = tuple(round(side / factor) for side in grey.shape[::-1])
        grey = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    return grey, factor


def _enclosed(dark: NDArray[np.bool_]) -> Iterator[Array]:
    """Four edges (4, 2) around each patch that they enclose well."""
    contours, nested = cv2.findContours(dark.view(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    most = _LARGEST_SHARE * np.array(dark.shape[::-1])
    for k, contour in enumerate(contours):
        # Long enough to go around the least area, and no hole in another patch.
        if len(contour) < _LEAST_CONTOUR or nested[0, k, 3] >= 0:
            continue
        if (np.ptp(contour[:, 0], axis=0) > most).any():
            continue
        hull = cv2.convexHull(contour)
        area = cv2.contourArea(hull)
        if len(hull) < 4 or area < _LEAST_AREA or cv2.contourArea(contour) < _FILLED * area:
            continue
        quad = np.asarray(cv2.approxPolyN(hull, 4), dtype=np.float32).reshape(-1, 2)
        if len(quad) == 4 and cv2.contourArea(quad) < _LOOSE * area:
            yield quad.astype(np.float64)


def _distinct(quads: list[Array]) -> list[Array]:
    """One of each: corners in the same order, from the one nearest the top left."""
    kept: list[Array] = []
    for quad in quads:
        signed = cv2.contourArea(quad.astype(np.float32), oriented=True)
        quad = quad if signed > 0 else quad[::-1]
        quad = np.roll(quad, -int(np.argmin(quad.sum(axis=1))), axis=0)
        size = np.sqrt(abs(signed))
        if all(np.abs(quad - other).max() > _SAME * size for other in kept):
            kept.append(quad)
    return kept
