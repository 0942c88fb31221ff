"""CAN buses for other programs, on Unix sockets or on CAN interfaces of the kernel.

A message is a Linux `struct can_frame` of 16 bytes. Each program on a Unix socket receives the frames of motors and
other programs.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator, Mapping
from pathlib import Path

from yamsim_cli.core.errors import ResourceError

from ..motors import can_frames as frames
from ..motors.can_frames import CanFrame
from .socket_servers import ClientConnection, UnixServer

MAX_FRAMES_PER_READ = 256  # frames per read, limited so that a flood of frames does not stop physics
_READ_BYTES = MAX_FRAMES_PER_READ * frames.FRAME_BYTES
_BACKLOG_BYTES = 4096 * frames.FRAME_BYTES  # unsent bytes of a client; further frames are lost, as in a full adapter

# Plugin that replaces python-can's `socketcan`, only for programs that `yamsim can-run` starts.
_CAN_SITE_FOLDER = Path(__file__).resolve().parents[2] / "can_site"


class UnixBus(UnixServer):
    """A CAN bus on the Unix socket `<folder>/<channel>`, which the caller closes.

    Raises:
        ResourceError: another program serves the channel, or the socket cannot be made.
    """

    def __init__(self, folder: Path, channel: str) -> None:
        super().__init__(folder / channel, _READ_BYTES)

    def receive(self, ready: set[socket.socket]) -> Iterator[CanFrame]:
        """Yield received frames, and send each to the other clients; `ready` are readable sockets."""
        for client in self.receive_from_clients(ready):
            whole = len(client.received) - len(client.received) % frames.FRAME_BYTES
            wires = bytes(client.received[:whole])
            del client.received[:whole]
            for start in range(0, whole, frames.FRAME_BYTES):
                frame = frames.parse_frame(wires[start : start + frames.FRAME_BYTES])
                if frame is not None:
                    if len(self.clients) > 1:
                        self.send(frame, sender=client)
                    yield frame

    def send(self, frame: CanFrame, sender: ClientConnection | None = None) -> None:
        """Send a frame to all clients but its sender."""
        wire = frames.encode_frame(frame)
        for client in self.clients:
            if client is not sender:
                if len(client.outgoing) + len(wire) <= _BACKLOG_BYTES:
                    client.outgoing += wire
                self.send_outgoing(client)


class KernelBus:
    """A CAN bus on a kernel interface, such as by `ip link add can0 type vcan`. The caller closes the bus.

    Raises:
        ResourceError: the system has no CAN, or no interface with the name is up.
    """

    def __init__(self, channel: str) -> None:
        opened = None
        try:
            opened = socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
            opened.bind((channel,))
        except (AttributeError, OSError) as error:
            if opened is not None:
                opened.close()
            raise ResourceError(
                f"CAN interface {channel}: cannot be opened: {getattr(error, 'strerror', error)}. Make it with "
                f"`ip link add {channel} type vcan` and `ip link set {channel} up`, or leave out --kernel and "
                "use `yamsim can-run`"
            ) from error
        self._socket = opened
        self._socket.setblocking(False)

    @property
    def readers(self) -> list[socket.socket]:
        """Sockets to select for reading."""
        return [self._socket]

    def receive(self, ready: set[socket.socket]) -> Iterator[CanFrame]:
        """Yield the received frames."""
        for _ in range(MAX_FRAMES_PER_READ if self._socket in ready else 0):
            try:
                frame = frames.parse_frame(self._socket.recv(frames.FRAME_BYTES))
            except OSError:
                return
            if frame is not None:
                yield frame

    def send(self, frame: CanFrame) -> None:
        """Send a frame, which is lost if the interface is down or its buffer full."""
        try:
            self._socket.send(frames.encode_frame(frame))
        except OSError:
            return

    def flush(self) -> None:
        """Do nothing: `send` sends immediately."""

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def program_environment(environ: Mapping[str, str], folder: Path) -> dict[str, str]:
    """Return the environment in which a program's python-can opens the buses in `folder`.

    Raises:
        ResourceError: the folder has no sockets.
    """
    served = sorted(path.name for path in folder.glob("*") if path.is_socket()) if folder.is_dir() else []
    if not served:
        raise ResourceError(
            f"{folder}: no server runs there; start `yamsim serve-robot --rig yam_v1+linear_4310` first"
        )
    path = os.pathsep.join(filter(None, (str(_CAN_SITE_FOLDER), environ.get("PYTHONPATH"))))
    return {"PYTHONPATH": path, "YAMSIM_CAN_FOLDER": str(folder.resolve())}
