"""The photo behind a scene: the station without its arms, and the table's surface from above."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..core.config.scene import Table
from ..core.images.image import Image
from .pinhole_view import PinholeView

_MARGIN_SHARE = 0.012  # of the image's width, around the rendered arms: poses and models are not exact
_INPAINT_PX = 5.0  # px, radius of `cv2.inpaint`
_TEXEL = 0.002  # m, of the table's texture: about a pixel at 1 m with 640 px
_MIN_SEEN = 0.05  # share of the table that the photo has to show


@dataclass(frozen=True)
class StationPlate:
    """The station without arms, RGB (height, width, 3); `filled_share` of the pixels no photo shows."""

    image: Image
    filled_share: float


def make_plate(photos: Sequence[Image], arms: Sequence[NDArray[np.bool_]]) -> StationPlate:
    """Return the median of the photos (height, width, 3) where arms (height, width) hide nothing.

    Pixels that arms hide in all photos are filled from their surroundings.
    """
    reach = max(1, round(_MARGIN_SHARE * photos[0].shape[1]))
    kernel = np.ones((2 * reach + 1,) * 2, np.uint8)
    hidden = np.stack([cv2.dilate(mask.astype(np.uint8), kernel) > 0 for mask in arms])
    unseen = hidden.all(axis=0)
    stack = np.where((hidden & ~unseen)[..., None], np.nan, np.stack(photos).astype(np.float32))
    plate: Image = np.rint(np.nanmedian(stack, axis=0)).astype(np.uint8)
    if unseen.any():
        plate = np.asarray(cv2.inpaint(plate, unseen.astype(np.uint8), _INPAINT_PX, cv2.INPAINT_TELEA), np.uint8)  # type: ignore[arg-type]
    return StationPlate(plate, float(unseen.mean()))


def table_photo(
    plate: Image, white_table: Image, on_table: NDArray[np.bool_], view: PinholeView, table: Table
) -> Image | None:
    """Return the table's colours from above (height, width, 3), with +x to the right and +y up.

    Args:
        plate: the station without arms (height, width, 3).
        white_table: what a white table would look like in the same light.
        on_table: where the table's surface is seen (height, width).

    Parts that the plate does not show get the mean colour. Returns None if the plate shows too little of the table.
    """
    half_x, half_y, _ = table.half_size
    columns, rows = max(2, round(2 * half_x / _TEXEL)), max(2, round(2 * half_y / _TEXEL))
    x = table.position[0] + half_x * (2 * (np.arange(columns) + 0.5) / columns - 1)
    y = table.position[1] - half_y * (2 * (np.arange(rows) + 0.5) / rows - 1)
    points = np.stack([*np.meshgrid(x, y), np.full((rows, columns), table.top_height)], axis=-1).reshape(-1, 3)
    pixels, inside = view.project(points)
    maps = (pixels[:, 0].reshape(rows, columns), pixels[:, 1].reshape(rows, columns))

    def warp_from_above(image: NDArray[np.float32], interpolation: int) -> NDArray[np.float32]:
        return np.asarray(cv2.remap(image, *maps, interpolation, borderMode=cv2.BORDER_REPLICATE), np.float32)

    seen = inside.reshape(rows, columns) & (warp_from_above(on_table.astype(np.float32), cv2.INTER_NEAREST) > 0)
    if seen.mean() < _MIN_SEEN:
        return None
    colours = warp_from_above(plate.astype(np.float32), cv2.INTER_LINEAR)
    shade = np.maximum(warp_from_above(white_table.astype(np.float32), cv2.INTER_LINEAR), 1.0)
    albedo = np.clip(255.0 * colours / shade, 0, 255)
    albedo[~seen] = albedo[seen].mean(axis=0)
    return np.rint(albedo).astype(np.uint8)
