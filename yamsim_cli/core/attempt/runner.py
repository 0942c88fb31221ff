"""Workers that make attempts: each attempt is a pure function of its job."""

from __future__ import annotations

import platform

from ..closing import Closing
from ..errors import ResourceError
from ..session import Session
from ..shown_meshes import differences
from ..types import EpisodeJob, EpisodePayload
from .payload import payload, result
from .planned import demonstrate
from .sampling import sample
from .simulator import Simulator

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
        self._simulator = recording_simulator(session) if render else Simulator(session)
        # Now, since the files that it is made from need not be there any more when the first job comes.
        _ = self._simulator.planner

    def run(self, job: EpisodeJob) -> EpisodePayload:
        """Make one attempt."""
        simulator = self._simulator
        done = demonstrate(simulator, sample(simulator, job))
        return payload(simulator, done) if self._render else result(done)

    def close(self) -> None:
        """Free the renderer."""
        self._simulator.close()


def recording_simulator(session: Session) -> Simulator:
    """A simulator whose pictures are to be recorded.

    Raises:
        ResourceError: it would show other meshes than the config says.
    """
    simulator, said = Simulator(session), session.config.meshes
    if said is not None and (others := differences(said, simulator.scene.shown_meshes, _PLACES)):
        simulator.close()
        raise ResourceError(
            f"a worker on {platform.node()} would show other meshes than the recorder: {'; '.join(others)}; they "
            "changed meanwhile, or yamsim is another one there: mend that, and go on with --resume"
        )
    return simulator
