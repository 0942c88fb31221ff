"""The real recordings that an export reads: frames as they were recorded, or at even times the ones nearest to them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..config.real import RealConfig
from ..config.rig import RigConfig
from ..dataset.layout import image_name, lowdim_name
from ..dataset.reader import RecordedEpisode, StoredEpisode, open_recorded, select_episodes
from ..dataset.real import RealRecord, real_config
from ..errors import DatasetError
from ..geometry.se3 import Array
from ..resources import Locations
from .source import AnySource, require_alike

# Where an action is from: what was commanded, what was measured one frame later, or nowhere.
ActionSource = Literal["recorded", "measured", "none"]

# Frames a second so near to a whole number are that, as a share: clocks of computers and cameras differ by less.
_WHOLE_FPS = 0.01
# Pauses between frames that differ by more from the period in an export are worth a word; and so are episodes whose
# usual pause does, since their frames would play too fast or too slow.
_UNEVEN = 0.1
# Times are compared with this tolerance, so that the last frame counts, s.
_ROUNDING_S = 1e-9


@dataclass(frozen=True)
class RealEpisode(RecordedEpisode):
    """A recording with some of its frames, which may repeat.

    Attributes:
        chosen: number of the recorded frame that each one is.
    """

    record: RealRecord
    chosen: tuple[int, ...]

    def frames(self) -> list[dict[str, Any]]:
        """The low-dimensional data of the chosen frames; raises as that of all."""
        recorded = {k: self.frame(k, self.whole(lowdim_name(k))) for k in dict.fromkeys(self.chosen)}
        return [recorded[k] for k in self.chosen]

    def image(self, camera: str, number: int) -> bytes:
        """A chosen frame's JPEG as it was recorded; raises as any."""
        return self.whole(image_name(camera, self.chosen[number]))


@dataclass(frozen=True)
class RealSource(AnySource):
    """Episodes of one dataset of real recordings, all with the same cameras and arms.

    Attributes:
        first: as it was recorded.
        config: what the dataset says of itself.
        period: from one frame to the next in what is written, s.
        even: whether frames are at even times, each the recorded one that is nearest; else the recorded ones, in order.
    """

    first: RecordedEpisode
    config: RealConfig
    period: float
    even: bool

    @property
    def rig(self) -> RigConfig:
        """Whose arms were recorded."""
        return self.config.rig

    @property
    def frame_period(self) -> float:
        """Time from one frame to the next in what is written, s."""
        return self.period

    @property
    def drives(self) -> tuple[str, ...]:
        """Names of what `joints` holds; without grippers where nobody recorded them."""
        rig, count = self.rig, self.first.record.drives
        named = zip(self.prefixes, rig.recorded, strict=True)
        return tuple(prefix + name for prefix, k in named for name in rig.arms[k].robot.drives[:count])

    def episodes(self) -> Iterator[RealEpisode]:
        """The episodes, opened one after the other.

        Raises:
            DatasetError: one is damaged, or has other cameras or arms than the first, or frames at another rate.
        """
        for directory in self.directories:
            episode = open_recorded(directory)
            require_alike(episode, self.first, ("cameras", "arms", "drives"))
            usual = episode.record.frame_period_s
            if not self.even and abs(usual / self.period - 1) > _UNEVEN:
                raise DatasetError(
                    f"{directory} has a frame every {1000 * usual:.1f} ms, and the chosen episodes usually every "
                    f"{1000 * self.period:.1f}: export it apart, see --episodes, or give --fps"
                )
            yield self._chosen(episode)

    def _chosen(self, episode: RecordedEpisode) -> RealEpisode:
        record = episode.record
        assert isinstance(record, RealRecord), "the dataset's config says so"
        if not self.even:
            return RealEpisode(episode.directory, record, tuple(range(record.frames)))
        times = np.array([frame["timestamp"] for frame in episode.frames()])
        chosen = nearest_to_even(times, self.period)
        record = record.model_copy(update={"frames": len(chosen), "frame_period_s": self.period})
        return RealEpisode(episode.directory, record, chosen)

    def shares(self, values: ArrayLike) -> Array:
        """Joints or commands of each arm (n, arms, drives) from rows of them (n, arms * drives).

        Joints are in rad. Grippers, recorded as openings of one finger in m, become shares: 0 closed, 1 open. Beyond
        both ends they stay beyond.
        """
        record = self.first.record
        rows = np.array(values, dtype=np.float64).reshape(-1, record.arms, record.drives)
        for k, arm in enumerate(self.rig.recorded):
            robot = self.rig.arms[arm].robot
            if robot.fingers is not None and record.drives > robot.dof:
                rows[:, k, robot.dof] /= robot.fingers.full_opening
        return rows

    def unevenness(self, episode: RecordedEpisode, frames: Sequence[Mapping[str, Any]]) -> str | None:
        """A line on an episode whose frames were not recorded at even times, but are written so; None of any other."""
        pauses = np.diff([frame["timestamp"] for frame in frames])
        if self.even or len(pauses) == 0 or np.abs(pauses / self.period - 1).max() <= _UNEVEN:
            return None
        return (
            f"{episode.directory.name}: its frames were recorded {1000 * pauses.min():.1f} to "
            f"{1000 * pauses.max():.1f} ms apart, and are {1000 * self.period:.1f} ms apart here, "
            f"{len(pauses) * self.period:.2f} s instead of {pauses.sum():.2f}; --fps has frames at even times"
        )


def nearest_to_even(times: Array, period: float) -> tuple[int, ...]:
    """The frame that is nearest to each multiple of a period, from the first frame to the last one.

    Args:
        times: of the frames (n,), s, increasing.
    """
    since = times - times[0]
    even = np.arange(math.floor((since[-1] + _ROUNDING_S) / period) + 1) * period
    middles = (since[1:] + since[:-1]) / 2
    # A rounding error before the middle between two frames is the middle, and the earlier one is taken there.
    return tuple(np.searchsorted(middles, even - _ROUNDING_S).tolist())


def open_real_source(dataset: Path, episodes: str | None, locations: Locations, fps: float | None = None) -> RealSource:
    """The chosen episodes of a dataset of real recordings.

    Args:
        episodes: numbers and ranges, such as `0,3,5-9`; None for all.
        fps: frames a second at even times; None for the recorded frames, at their own usual rate.

    Raises:
        DatasetError: there is no dataset, it is damaged, or was simulated.
        UsageError: an episode is named that is not there.
    """
    chosen = select_episodes(dataset, episodes, None)
    directories = tuple(directory for _, directory in chosen)
    config = real_config(dataset, locations)
    opened = [open_recorded(directory) for directory in directories]
    for episode in opened:
        if isinstance(episode, StoredEpisode):
            raise DatasetError(f"{episode.directory} was simulated, and its dataset holds real recordings: move it out")
    period = 1 / fps if fps else 1 / _usual_fps([episode.record.frame_period_s for episode in opened])
    return RealSource(dataset, directories, opened[0], config, period, fps is not None)


def _usual_fps(periods: Sequence[float]) -> float:
    """Frames a second, from each episode's usual pause (s) between them; a whole number where it nearly is one."""
    rate = 1 / float(np.median(periods))
    whole = round(rate)
    return float(whole) if abs(rate - whole) <= _WHOLE_FPS * rate else round(rate, 3)


def actions_of(
    source: RealSource, episode: RealEpisode, frames: Sequence[Mapping[str, Any]], wanted: ActionSource
) -> NDArray[np.float64]:
    """What each arm was told at each frame (n, arms, drives), joints in rad, grippers as shares.

    Args:
        wanted: `recorded` commands, or what was `measured` one frame later, at the last frame then.

    Raises:
        DatasetError: commands are wanted, and nobody recorded them.
    """
    if wanted == "measured":
        later = [*frames[1:], frames[-1]]
        return source.shares([frame["joints"] for frame in later])
    if not all("ctrl" in frame for frame in frames):
        raise DatasetError(
            f"{episode.directory} has no commands: nobody recorded what its arms were told. --actions measured takes "
            "what was measured one frame later"
        )
    return source.shares([frame["ctrl"] for frame in frames])
