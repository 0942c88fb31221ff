"""Makes attempts in a worker: each attempt is a pure function of its job."""

from __future__ import annotations

import platform

from ..closing import Closing
from ..config.session import Session
from ..config.shown_meshes import differences
from ..errors import ResourceError
from ..scene.build import shown_meshes
from ..types import EpisodeJob, EpisodePayload
from .engine import demonstrate
from .payload import payload, result
from .sampling import sample
from .simulator import Simulators

# Places in which meshes are shown, for messages: the recorder and the worker.
_PLACES = ("for the recorder", "there")


class EpisodeRunner(Closing):
    """Makes attempts from their seed and number, in a worker or in this process.

    Args:
        render: whether successes become files; otherwise attempts are simulated without rendering.

    Raises:
        ResourceError: other meshes would be shown than the config states.
    """

    def __init__(self, session: Session, *, render: bool) -> None:
        self._render = render
        if render:
            require_meshes(session)
        self._simulators = Simulators(session)
        # The expert's tools are made now, since the files that they need may be gone when the first job comes.
        self._simulators.of(EpisodeJob(session.config.seed, 0)).prepare()

    def run(self, job: EpisodeJob) -> EpisodePayload:
        """Make one attempt."""
        simulator = self._simulators.of(job)
        simulated = demonstrate(simulator, sample(simulator, job))
        return payload(simulator, simulated) if self._render else result(simulated)

    def close(self) -> None:
        """Free the renderers."""
        self._simulators.close()


def require_meshes(session: Session) -> None:
    """Check that a worker shows the meshes that the config states.

    Raises:
        ResourceError: the session shows other meshes.
    """
    expected = session.config.meshes
    if expected is not None and (found := differences(expected, shown_meshes(session), _PLACES)):
        raise ResourceError(
            f"a worker on {platform.node()} would show other meshes than the recorder: {'; '.join(found)}; they "
            "changed meanwhile, or yamsim is another one there: mend that, and go on with --resume"
        )
