"""Checks a dataset as a whole: missing, duplicate and dissimilar episodes, and remains of writing."""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from ...shown_meshes import shown
from ..layout import RECORDINGS, STAGING, episode_name
from ..records import AttemptRecord
from .context import Context, looks_like_episode
from .facts import EpisodeFacts
from .ledger import check_manifest, compare_ledger
from .problem import Problem, Problems

# Starts that agree to so many digits of a metre are the same start: chance does not give them twice.
_SAME_PLACE_DIGITS = 6

_PART = re.compile(r"\..+\.part")


def check_whole(
    dataset: Path,
    context: Context,
    episodes: Sequence[EpisodeFacts],
    attempts: Sequence[AttemptRecord],
    problems: Problems,
) -> list[Problem]:
    """Faults of episodes that only show beside the others. Faults of the dataset are added to `problems`."""
    found: list[Problem] = []
    if not episodes:
        problems.add("dataset.empty")
    if context.recorded:
        numbers = {episode.number: episode for episode in episodes if episode.number is not None}
        found += compare_ledger(dataset, attempts, episodes, problems)
        listed, differing = check_manifest(dataset, numbers, problems) if episodes or attempts else (set(), [])
        logged = {attempt.episode for attempt in attempts if attempt.episode is not None}
        found += differing + _missing(set(numbers), listed | logged)
        _leftovers(dataset, {episode.name for episode in episodes}, problems)
    else:
        if not context.real:
            problems.add("dataset.plain")
        _gaps([episode.name for episode in episodes], problems)
    found += _twins(episodes)
    _mixed(episodes, problems)
    return found


def _missing(present: set[int], listed: set[int]) -> list[Problem]:
    """A fault for each run of missing episodes. Numbers start at 0 without gaps, and listed episodes existed once."""
    known = sorted(present | listed)
    runs = [(low + 1, high - 1) for low, high in itertools.pairwise([-1, *known]) if high - low > 1]
    runs += [(number, number) for number in listed - present]
    joined: list[tuple[int, int]] = []
    for low, high in sorted(runs):
        if joined and joined[-1][1] + 1 == low:
            joined[-1] = (joined[-1][0], high)
        else:
            joined.append((low, high))
    found = []
    for low, high in joined:
        own = Problems(episode_name(low))
        own.add("episode.missing", "", f"to {episode_name(high)}, {high - low + 1} episodes" if high > low else "")
        found += own.list()
    return found


def _gaps(names: Sequence[str], problems: Problems) -> None:
    """Note numbers that are left out, if all names are the same word with a number."""
    matches = [re.fullmatch(r"(.*?)([0-9]{1,18})", name) for name in names]
    parts = [(match[1], int(match[2])) for match in matches if match]
    if len(parts) < len(names) or len({word for word, _ in parts}) != 1:
        return
    numbers = sorted(number for _, number in parts)
    gaps = [(low + 1, high - 1) for low, high in itertools.pairwise(numbers) if high - low > 1]
    if gaps:
        shown = ", ".join(f"{low}" if low == high else f"{low} to {high}" for low, high in gaps)
        problems.add("episode.gap", "", shown)


def _twins(episodes: Sequence[EpisodeFacts]) -> list[Problem]:
    """Faults of episodes that equal an earlier one in all values, or in their start."""
    contents: dict[str, str] = {}
    layouts: dict[tuple[tuple[str, tuple[float, ...]], ...], str] = {}
    found = []
    for episode in episodes:
        own = Problems(episode.name)
        places = tuple(
            sorted((name, tuple(round(v, _SAME_PLACE_DIGITS) for v in place)) for name, place in episode.layout.items())
        )
        if episode.content and episode.content in contents:
            own.add("episode.duplicate", "", f"every value is that of {contents[episode.content]}")
        elif places and places in layouts:
            own.add("episode.layout", "", f"all objects lie as in {layouts[places]}")
        contents.setdefault(episode.content, episode.name)
        layouts.setdefault(places, episode.name)
        found += own.list()
    return found


def _mixed(episodes: Sequence[EpisodeFacts], problems: Problems) -> None:
    """Note settings that differ between episodes."""
    cameras = (", ".join(f"{name} {w}x{h}" for name, (w, h) in sorted(e.cameras.items())) for e in episodes)
    _differ("cameras", (text for text in cameras if text), problems)
    records = [episode.record for episode in episodes if episode.record]
    for key in ("source", "rig", "scene", "task", "grasp", "frame_period_s", "renderer"):
        _differ(key, (str(getattr(record, key)) for record in records), problems)
    drawn = [record.meshes for record in records]
    for name in sorted({name for meshes in drawn if meshes for name in meshes}):
        _differ(f"meshes {name}", ("not told" if m is None else shown(m.get(name)) for m in drawn), problems)
    for package in sorted({package for record in records for package in record.versions}):
        _differ(package, (record.versions.get(package, "none") for record in records), problems)


def _differ(what: str, values: Iterable[str], problems: Problems) -> None:
    counts = Counter(values)
    if len(counts) > 1:
        problems.add("dataset.mixed", "", f"{what}: " + "; ".join(f"{n} x {text}" for text, n in counts.most_common()))


def _leftovers(dataset: Path, known: set[str], problems: Problems) -> None:
    for path in sorted(dataset.iterdir()):
        if path.name in (STAGING, RECORDINGS):
            for staged in sorted(path.glob("*")):
                problems.add("leftover.staging", f"{path.name}/{staged.name}")
        elif _PART.fullmatch(path.name):
            problems.add("leftover.staging", path.name)
        elif path.name not in known and looks_like_episode(path):
            problems.add("leftover.directory", path.name)
