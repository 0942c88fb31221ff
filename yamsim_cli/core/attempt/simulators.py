"""The simulators of a session: one for every cast of things, a few of them kept."""

from __future__ import annotations

from collections import OrderedDict

from ..closing import Closing
from ..goals.cast import Cast
from ..session import Session
from ..tasks.casting import draw_cast
from ..types import EpisodeJob
from .simulator import Simulator, played_session

# How many are kept: each holds a compiled scene, and a renderer once it has rendered.
_KEPT = 4

_Key = tuple[tuple[str, str, float], ...]


def cast_for(session: Session, job: EpisodeJob) -> Cast:
    """Return who plays which role in an attempt."""
    return draw_cast(session.config.task, job)


def simulator_for(session: Session, job: EpisodeJob) -> Simulator:
    """Return a simulator of the things of an attempt.

    Raises:
        SimulationError: its scene cannot be compiled, or a thing not be made in its size.
    """
    cast = cast_for(session, job)
    return Simulator(played_session(session, cast), cast)


class Simulators(Closing):
    """Makes simulators and keeps the latest few. Close it, or use it as a context manager."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self._made: OrderedDict[_Key, Simulator] = OrderedDict()

    def of(self, job: EpisodeJob) -> Simulator:
        """The simulator in which an attempt takes place; use it before the next one is asked for.

        Raises:
            SimulationError: its scene cannot be compiled.
        """
        cast = cast_for(self.session, job)
        key = tuple((name, cast.kinds[name], cast.sizes.get(name, 1.0)) for name in cast.kinds)
        if key in self._made:
            self._made.move_to_end(key)
            return self._made[key]
        while len(self._made) >= _KEPT:
            self._made.popitem(last=False)[1].close()
        made = self._made[key] = Simulator(played_session(self.session, cast), cast)
        return made

    def close(self) -> None:
        """Free all renderers."""
        while self._made:
            self._made.popitem()[1].close()
