from __future__ import annotations

import platform

from ..attempt_data import AttemptJob, AttemptPayload
from ..closable import Closable
from ..config.mesh_provenance import mesh_differences
from ..config.session import Session
from ..errors import ResourceError
from ..scene.build import describe_meshes
from .attempt_payload import build_payload, payload_without_files
from .execution import simulate_expert
from .sampling import sample_attempt
from .simulator import SimulatorCache

# Places of the expected and of the found meshes, in an error message.
_MESH_SIDE_LABELS = ("for the recorder", "there")


class SessionRunner(Closable):
    """Base of runners of jobs, which own the simulators of a session."""

    def __init__(self, session: Session) -> None:
        self._simulators = SimulatorCache(session)

    def close(self) -> None:
        """Free the renderers."""
        self._simulators.close()


class AttemptRunner(SessionRunner):
    """Runs attempts from their seed and number; `render` renders successes. Raises as `require_stated_meshes`."""

    def __init__(self, session: Session, *, render: bool) -> None:
        self._render = render
        if render:
            require_stated_meshes(session)
        super().__init__(session)
        # The files that the expert's planner needs may be gone when the first job comes.
        self._simulators.get(AttemptJob(session.config.seed, 0)).prepare()

    def run(self, job: AttemptJob) -> AttemptPayload:
        """Run one attempt."""
        simulator = self._simulators.get(job)
        simulated = simulate_expert(simulator, sample_attempt(simulator, job))
        return build_payload(simulator, simulated) if self._render else payload_without_files(simulated)


def require_stated_meshes(session: Session) -> None:
    """Raise ResourceError if this process renders other visual meshes than the config states."""
    expected = session.config.meshes
    if expected is not None and (found := mesh_differences(expected, describe_meshes(session), _MESH_SIDE_LABELS)):
        raise ResourceError(
            f"a worker on {platform.node()} would show other meshes than the recorder: {'; '.join(found)}; "
            "install the same meshes and the same yamsim there, then continue with --resume"
        )
