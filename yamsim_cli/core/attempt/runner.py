"""Workers that make attempts: each attempt is a pure function of its job."""

from __future__ import annotations

import platform

from ..closing import Closing
from ..errors import ResourceError
from ..scene.build import shown_meshes
from ..session import Session
from ..shown_meshes import differences
from ..types import EpisodeJob, EpisodePayload
from .engine import demonstrate
from .payload import payload, result
from .sampling import sample
from .simulator import Simulators

# Where meshes are shown, when a worker's are not the recorder's.
_PLACES = ("for the recorder", "there")


class EpisodeRunner(Closing):
    """Makes attempts from their numbers alone, in a worker or in this process.

    Args:
        render: whether successes become files; otherwise attempts are made in physics alone.

    Raises:
        ResourceError: it would show other meshes than the config says.
    """

    def __init__(self, session: Session, *, render: bool) -> None:
        self._render = render
        if render:
            require_meshes(session)
        self._simulators = Simulators(session)
        # Now, since the files that it is made from need not be there any more when the first job comes.
        self._simulators.of(EpisodeJob(session.config.seed, 0)).prepare()

    def run(self, job: EpisodeJob) -> EpisodePayload:
        """Make one attempt."""
        simulator = self._simulators.of(job)
        done = demonstrate(simulator, sample(simulator, job))
        return payload(simulator, done) if self._render else result(done)

    def close(self) -> None:
        """Free the renderers."""
        self._simulators.close()


def require_meshes(session: Session) -> None:
    """Make sure that the pictures of a worker's session show the meshes that the config states.

    Raises:
        ResourceError: the session shows other meshes.
    """
    expected = session.config.meshes
    if expected is not None and (others := differences(expected, shown_meshes(session), _PLACES)):
        raise ResourceError(
            f"a worker on {platform.node()} would show other meshes than the recorder: {'; '.join(others)}; they "
            "changed meanwhile, or yamsim is another one there: mend that, and go on with --resume"
        )
