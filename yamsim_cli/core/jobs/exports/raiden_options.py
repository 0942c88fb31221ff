"""What a user can choose of an export to raiden's layout."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

# raiden's own rate: `rd replay` plays at it, and `rd shardify` counts windows in its frames.
FPS = 30.0

# Drawn anew at each frame's time; or the recorded one that is nearest to it.
Pictures = Literal["draw", "nearest"]
# Files of pictures. raiden's code reads PNG alone.
ImageFormat = Literal["png", "jpg"]
# Whose kinematics say where a hand is, see `raiden_frames.HAND_FRAMES`.
HandFrameName = Literal["yamsim", "i2rt"]


@dataclass(frozen=True)
class RaidenOptions:
    """What to write.

    Attributes:
        fps: frames a second; None for the recorded frames and no others.
        pictures: where those come from, given fps.
        images: what they are stored as.
        single: the arrays of a lone arm hold that arm alone, instead of a right one that stands still.
        hand_frame: whose hand `action` and `actual_poses` tell of.
    """

    fps: float | None = FPS
    pictures: Pictures = "draw"
    images: ImageFormat = "png"
    single: bool = False
    hand_frame: HandFrameName = "yamsim"

    @property
    def draws(self) -> bool:
        """Whether anything has to be drawn."""
        return self.fps is not None and self.pictures == "draw"
