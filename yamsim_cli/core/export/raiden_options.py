"""The options of an export to raiden's layout."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

# raiden's own rate: `rd replay` plays at it, and `rd shardify` counts windows in its frames.
FPS = 30.0

# "draw" renders a picture at each frame's time; "nearest" takes the recorded one that is nearest in time.
PictureSource = Literal["draw", "nearest"]
# Formats of pictures. raiden's code reads only PNG.
ImageFormat = Literal["png", "jpg"]
# The kinematics by which hands' poses are computed, see `raiden_frames.HAND_FRAMES`.
HandFrameName = Literal["yamsim", "i2rt"]


@dataclass(frozen=True)
class RaidenOptions:
    """The options of an export.

    Attributes:
        fps: frames a second; None for the recorded frames and no others.
        pictures: where pictures come from, if `fps` is given.
        images: their format.
        single: whether the arrays of a lone arm hold only that arm, and no right one that stands still.
        hand_frame: by which kinematics `action` and `actual_poses` are computed.
    """

    fps: float | None = FPS
    pictures: PictureSource = "draw"
    images: ImageFormat = "png"
    single: bool = False
    hand_frame: HandFrameName = "yamsim"

    @property
    def renders(self) -> bool:
        """Whether anything has to be rendered."""
        return self.fps is not None and self.pictures == "draw"
