"""What the cameras of a served scene see, drawn in a process of its own: physics never waits for a picture."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory

import numpy as np

from ..attempt.pictures import render
from ..attempt.simulators import simulator_for
from ..errors import ResourceError, SimulationError, YamsimError
from ..geometry.se3 import Array
from ..images.image import Image
from ..session import Session
from ..types import Attempt, EpisodeJob
from ..workers.processes import start_process

# One that is drawn on while the other is looked at.
_SLOTS = 2
# Compiling a scene with all of its meshes takes seconds, on a busy machine many.
_START_SECONDS = 300.0
_END_SECONDS = 5.0
# How an answer of the process begins.
_DRAWN, _FAILED = b"d", b"f"


@dataclass(frozen=True)
class Shot:
    """What all cameras saw at one moment.

    Attributes:
        number: of the shot, from 0.
        time_ns: when that was by the machine's clock, ns since 1970.
        sim_time: when that was in the simulation, s.
        joints: of each arm then, (dofs,) with the gripper last, as its follower tells them.
        T_cam_in_base: pose (4, 4) of each camera in the left arm's base then, in OpenCV's convention.
        pictures: of each camera, RGB (height, width, 3). They are drawn over after the next shot.
    """

    number: int
    time_ns: int
    sim_time: float
    joints: tuple[Array, ...]
    T_cam_in_base: dict[str, Array]
    pictures: dict[str, Image]


@dataclass(frozen=True)
class Moment:
    """A state that is to be drawn: MuJoCo's positions (nq,), and what a `Shot` tells beside."""

    qpos: Array
    sim_time: float
    joints: tuple[Array, ...]


class PictureProcess:
    """Draws a scene's cameras; close it.

    Attributes:
        cameras: their names, in order.
        size: of the pictures, width and height, px.
        fps: shots a second, at most.
        K: camera -> intrinsics (3, 3).
        shot: the newest; None until the first is drawn.

    Args:
        moment: gives the present state.
        clock: gives the present time, ns since 1970.

    Raises:
        ResourceError: nothing can draw here.
        SimulationError: the scene cannot be compiled.
    """

    def __init__(
        self,
        session: Session,
        cameras: Sequence[str],
        fps: float,
        moment: Callable[[], Moment],
        clock: Callable[[], int],
    ) -> None:
        self.cameras, self.size, self.fps = tuple(cameras), session.config.image.size_px, fps
        self.shot: Shot | None = None
        self._moment, self._clock = moment, clock
        self._asked: tuple[int, Moment] | None = None
        self._count, self._due = 0, 0.0
        width, height = self.size
        self._shape = (_SLOTS, len(self.cameras), height, width, 3)
        self._memory = SharedMemory(create=True, size=int(np.prod(self._shape)))
        self._pictures = np.ndarray(self._shape, np.uint8, self._memory.buf)
        try:
            self._process, self._pipe = start_process(
                "yamsim-pictures",
                _draw,
                # A scene has the cameras that are recorded, and these may be others.
                session.with_values(cameras=self.cameras),
                self.cameras,
                self._shape,
                self._memory.name,
            )
        except BaseException:
            self._free()
            raise
        try:
            if not self._pipe.poll(_START_SECONDS):
                raise ResourceError(f"the process that draws pictures was not ready after {_START_SECONDS:g} s")
            K = np.frombuffer(self._answer()).reshape(-1, 3, 3)
        except BaseException:
            self.close()
            raise
        self.K = dict(zip(self.cameras, K, strict=True))

    @property
    def readers(self) -> list[Connection]:
        """What to wait for until there may be a shot."""
        return [self._pipe]

    @property
    def writers(self) -> list[Connection]:
        """Nothing waits to be sent."""
        return []

    def handle(self, ready: set[object]) -> None:
        """Take a shot that is drawn.

        Raises:
            SimulationError, ResourceError: the process has ended.
        """
        if self._pipe not in ready or self._asked is None:
            return
        poses = np.frombuffer(self._answer()).reshape(-1, 4, 4)
        time_ns, moment = self._asked
        self._asked = None
        self.shot = Shot(
            self._count,
            time_ns,
            moment.sim_time,
            moment.joints,
            dict(zip(self.cameras, poses, strict=True)),
            dict(zip(self.cameras, self._pictures[self._count % _SLOTS], strict=True)),
        )
        self._count += 1

    def flush(self) -> None:
        """Have the next shot drawn, if it is time and the one before is done."""
        now = time.monotonic()
        if self._asked is not None or now < self._due:
            return
        self._due = max(self._due + 1 / self.fps, now)
        self._asked = self._clock(), self._moment()
        # A state has some hundreds of bytes, and the process waits for it: this does not block.
        with contextlib.suppress(OSError):
            self._pipe.send_bytes(bytes([self._count % _SLOTS]) + self._asked[1].qpos.tobytes())

    def close(self) -> None:
        """End the process."""
        self._pipe.close()
        self._process.kill()
        self._process.join(_END_SECONDS)
        self.shot = None
        self._free()

    def _answer(self) -> bytes:
        try:
            said = self._pipe.recv_bytes()
        except (EOFError, OSError):
            raise SimulationError("the process that draws pictures has ended, perhaps for want of memory") from None
        if said[:1] == _FAILED:
            raise ResourceError(said[1:].decode())
        return said[1:]

    def _free(self) -> None:
        del self._pictures
        # Somebody may still look at a picture; its memory goes with the process then.
        with contextlib.suppress(BufferError):
            self._memory.close()
        self._memory.unlink()


def _draw(pipe: Connection, session: Session, cameras: Sequence[str], shape: tuple[int, ...], memory: str) -> None:
    """Draw each state that comes, until the pipe closes."""
    shared = SharedMemory(name=memory)
    pictures = np.ndarray(shape, np.uint8, shared.buf)
    attempt = Attempt(EpisodeJob(0, 0))
    try:
        with (
            simulator_for(session, EpisodeJob(session.config.seed, 0)) as simulator,
            contextlib.suppress(EOFError, OSError),
        ):
            replica, size = simulator.replica, session.config.image.size_px
            # The first picture takes longest: it has everything uploaded.
            render(simulator, attempt, simulator.scene.model.qpos0, cameras)
            pipe.send_bytes(_DRAWN + np.array([replica.intrinsics(name, size).K for name in cameras]).tobytes())
            while True:
                data = pipe.recv_bytes()
                drawn = render(simulator, attempt, np.frombuffer(data[1:]), cameras)
                for k, name in enumerate(cameras):
                    pictures[data[0], k] = drawn[name]
                pipe.send_bytes(_DRAWN + np.array([replica.T_cam_in_base(name) for name in cameras]).tobytes())
    except YamsimError as error:
        with contextlib.suppress(OSError):
            pipe.send_bytes(_FAILED + str(error).encode())
