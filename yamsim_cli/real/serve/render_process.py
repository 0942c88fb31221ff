"""Render a served scene's cameras in a separate process: physics never waits for an image."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.shared_memory import SharedMemory

import numpy as np

from yamsim_cli.core.attempt_data import Attempt, AttemptJob
from yamsim_cli.core.config.session import Session
from yamsim_cli.core.episode.attempt_payload import render_cameras
from yamsim_cli.core.episode.simulator import make_simulator
from yamsim_cli.core.errors import ResourceError, SimulationError, YamsimError
from yamsim_cli.core.geometry.se3 import Array
from yamsim_cli.core.images.image import Image
from yamsim_cli.core.workers.process_pool import start_process

_IMAGE_SLOTS = 2  # sets of images in shared memory: the newest, and one being rendered
_START_SECONDS = 300.0  # s; compiling meshes takes long on a busy machine
_END_SECONDS = 5.0  # s
# First byte of an answer.
_RENDERED, _FAILED = b"d", b"f"


@dataclass(frozen=True)
class CameraFrames:
    """Images of all cameras in one state.

    Attributes:
        number: of the set, from 0.
        time_ns: by the machine's clock, since 1970.
        sim_time: s.
        joints: (dofs,) of each arm, rad, last the gripper, 0 (closed) to 1 (open).
        T_cam_in_base: camera -> pose (4, 4) in the left arm's base, OpenCV's convention.
        pictures: camera -> RGB (height, width, 3); set `number + 2` overwrites its memory.
    """

    number: int
    time_ns: int
    sim_time: float
    joints: tuple[Array, ...]
    T_cam_in_base: dict[str, Array]
    pictures: dict[str, Image]


@dataclass(frozen=True)
class SceneState:
    """A state to render: MuJoCo's positions (nq,), and values for `CameraFrames`."""

    qpos: Array
    sim_time: float
    joints: tuple[Array, ...]


class RenderProcess:
    """Renders a scene's cameras in a process that the caller closes.

    Attributes:
        size: width and height, px.
        fps: largest rate of sets of images, 1/s.
        K: camera -> intrinsics (3, 3).
        newest_frames: None until the first set is rendered.

    Args:
        state: returns the state to render next.
        clock: returns ns since 1970.

    Raises:
        ResourceError: the machine cannot render, or the process did not start in time.
        SimulationError: the scene cannot be compiled.
    """

    def __init__(
        self,
        session: Session,
        cameras: Sequence[str],
        fps: float,
        state: Callable[[], SceneState],
        clock: Callable[[], int],
    ) -> None:
        self.cameras, self.size, self.fps = tuple(cameras), session.config.image.size_px, fps
        self.newest_frames: CameraFrames | None = None
        self._state, self._clock = state, clock
        self._requested: tuple[int, SceneState] | None = None
        self._count, self._due = 0, 0.0
        width, height = self.size
        self._shape = (_IMAGE_SLOTS, len(self.cameras), height, width, 3)
        self._memory = SharedMemory(create=True, size=int(np.prod(self._shape)))
        self._pictures = np.ndarray(self._shape, np.uint8, self._memory.buf)
        try:
            self._process, self._pipe = start_process(
                "yamsim-pictures",
                _render_states,
                # A scene has only recorded cameras, which may differ from the served ones.
                session.with_values(cameras=self.cameras),
                self.cameras,
                self._shape,
                self._memory.name,
            )
        except BaseException:
            self._free_shared_memory()
            raise
        try:
            if not self._pipe.poll(_START_SECONDS):
                raise ResourceError(f"the rendering process was not ready after {_START_SECONDS:g} s")
            K = np.frombuffer(self._receive_answer()).reshape(-1, 3, 3)
        except BaseException:
            self.close()
            raise
        self.K = dict(zip(self.cameras, K, strict=True))

    @property
    def readers(self) -> list[Connection]:
        """Connections to select for reading."""
        return [self._pipe]

    @property
    def writers(self) -> list[Connection]:
        """None, because no bytes wait to be sent."""
        return []

    def handle(self, ready: set[object]) -> None:
        """Receive a set of images.

        Raises:
            SimulationError, ResourceError: the process has ended or failed.
        """
        if self._pipe not in ready or self._requested is None:
            return
        poses = np.frombuffer(self._receive_answer()).reshape(-1, 4, 4)
        time_ns, state = self._requested
        self._requested = None
        self.newest_frames = CameraFrames(
            self._count,
            time_ns,
            state.sim_time,
            state.joints,
            dict(zip(self.cameras, poses, strict=True)),
            dict(zip(self.cameras, self._pictures[self._count % _IMAGE_SLOTS], strict=True)),
        )
        self._count += 1

    def flush(self) -> None:
        """Request the next set, if it is due and the previous one is rendered."""
        now = time.monotonic()
        if self._requested is not None or now < self._due:
            return
        self._due = max(self._due + 1 / self.fps, now)
        self._requested = self._clock(), self._state()
        # Sending does not block: a state is small, and the process waits for it.
        with contextlib.suppress(OSError):
            self._pipe.send_bytes(bytes([self._count % _IMAGE_SLOTS]) + self._requested[1].qpos.tobytes())

    def close(self) -> None:
        """End the process."""
        self._pipe.close()
        self._process.kill()
        self._process.join(_END_SECONDS)
        self.newest_frames = None
        self._free_shared_memory()

    def _receive_answer(self) -> bytes:
        try:
            answer = self._pipe.recv_bytes()
        except (EOFError, OSError):
            raise SimulationError("the rendering process has ended, perhaps because memory ran out") from None
        if answer[:1] == _FAILED:
            raise ResourceError(answer[1:].decode())
        return answer[1:]

    def _free_shared_memory(self) -> None:
        del self._pictures
        # Referenced images keep their memory until this process ends.
        with contextlib.suppress(BufferError):
            self._memory.close()
        self._memory.unlink()


def _render_states(
    pipe: Connection, session: Session, cameras: Sequence[str], shape: tuple[int, ...], memory: str
) -> None:
    shared = SharedMemory(name=memory)
    pictures = np.ndarray(shape, np.uint8, shared.buf)
    attempt = Attempt(AttemptJob(0, 0))
    try:
        with (
            make_simulator(session, AttemptJob(session.config.seed, 0)) as simulator,
            contextlib.suppress(EOFError, OSError),
        ):
            replica = simulator.state_replay
            # The first image uploads the scene, which takes longest.
            render_cameras(simulator, attempt, simulator.scene.model.qpos0, cameras)
            pipe.send_bytes(_RENDERED + np.array([simulator.intrinsics(name).K for name in cameras]).tobytes())
            while True:
                data = pipe.recv_bytes()
                images = render_cameras(simulator, attempt, np.frombuffer(data[1:]), cameras)
                for k, name in enumerate(cameras):
                    pictures[data[0], k] = images[name]
                pipe.send_bytes(_RENDERED + np.array([replica.T_cam_in_base(name) for name in cameras]).tobytes())
    except YamsimError as error:
        with contextlib.suppress(OSError):
            pipe.send_bytes(_FAILED + str(error).encode())
