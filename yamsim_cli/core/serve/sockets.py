"""Where programs reach the buses: a Unix socket for each, or a CAN interface of the kernel's.

Either way a message is 16 bytes, Linux' `struct can_frame`. On a Unix socket every program has a connection of its own,
and hears what the motors say and what other programs send, as on a bus.
"""

from __future__ import annotations

import os
import socket
import stat
from collections.abc import Iterator
from pathlib import Path

from ..errors import ResourceError
from ..motors import frames
from ..motors.frames import Frame
from .connections import Connections, Program

# Frames that are read at once: whoever sends without end does not stop physics.
_READ_FRAMES = 256
# Bytes that are read at once, and that wait for a program which does not read: more is thrown away, as a full buffer of
# an adapter is.
_READ_BYTES = _READ_FRAMES * frames.FRAME_BYTES
_BACKLOG_BYTES = 4096 * frames.FRAME_BYTES


def open_folder(folder: Path) -> Path:
    """A folder of the user's own in which sockets may lie; made if it is not there.

    Raises:
        ResourceError: it cannot be made, or somebody else could get at what lies there.
    """
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.lstat()
    except OSError as error:
        raise ResourceError(f"{folder}: cannot be made: {error.strerror}; name another one with --folder") from error
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise ResourceError(f"{folder}: is not a folder that is yours alone; name another one with --folder")
    return folder


def listen_in(path: Path) -> socket.socket:
    """A Unix socket that listens at a path, in a folder of `open_folder`.

    Raises:
        ResourceError: somebody else listens there, or the socket cannot be made.
    """
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        open_folder(path.parent)
        _drop_stale(path)
        listener.bind(str(path))
    except OSError as error:
        listener.close()
        raise ResourceError(f"{path}: cannot be listened on: {error.strerror or error}") from error
    except ResourceError:
        listener.close()
        raise
    return listener


class UnixBus:
    """A bus on a Unix socket, `<folder>/<channel>`; close it.

    Raises:
        ResourceError: somebody else serves that channel there, or the socket cannot be made.
    """

    def __init__(self, folder: Path, channel: str) -> None:
        self.path = folder / channel
        self._listener = listen_in(self.path)
        self._connections = Connections(self._listener, _READ_BYTES)

    @property
    def readers(self) -> list[socket.socket]:
        """What to wait for until there may be something to read."""
        return self._connections.readers

    @property
    def clients(self) -> int:
        """How many programs are on the bus."""
        return len(self._connections.programs)

    def receive(self, ready: set[socket.socket]) -> Iterator[Frame]:
        """The frames that have come on sockets where there is something to read."""
        for program in self._connections.heard(ready):
            whole = len(program.came) - len(program.came) % frames.FRAME_BYTES
            wires = bytes(program.came[:whole])
            del program.came[:whole]
            for start in range(0, whole, frames.FRAME_BYTES):
                frame = frames.parse(wires[start : start + frames.FRAME_BYTES])
                if frame is not None:
                    if self.clients > 1:
                        self.send(frame, but=program)
                    yield frame

    def send(self, frame: Frame, but: Program | None = None) -> None:
        """Put a frame before all programs, but for one."""
        wire = frames.to_wire(frame)
        for program in self._connections.programs:
            if program is not but:
                if len(program.waits) + len(wire) <= _BACKLOG_BYTES:
                    program.waits += wire
                self._connections.flush(program)

    def flush(self) -> None:
        """Send on what programs could not take before."""
        self._connections.flush()

    def close(self) -> None:
        """Leave nothing behind."""
        self._connections.close()
        self.path.unlink(missing_ok=True)


class KernelBus:
    """A bus on a CAN interface of the kernel's, such as one that `ip link add can0 type vcan` made; close it.

    Raises:
        ResourceError: this system has no CAN, or no interface of that name that is up.
    """

    clients = 0

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
        """What to wait for until there may be something to read."""
        return [self._socket]

    def receive(self, ready: set[socket.socket]) -> Iterator[Frame]:
        """The frames that have come."""
        for _ in range(_READ_FRAMES if self._socket in ready else 0):
            try:
                frame = frames.parse(self._socket.recv(frames.FRAME_BYTES))
            except OSError:
                return
            if frame is not None:
                yield frame

    def send(self, frame: Frame) -> None:
        """Put a frame onto the bus; one that its buffer has no room for, or whose interface is down, is lost."""
        try:
            self._socket.send(frames.to_wire(frame))
        except OSError:
            return

    def flush(self) -> None:
        """There is nothing that waits."""

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def _drop_stale(path: Path) -> None:
    """Remove a socket that a killed server left; raise an OSError if one still listens there."""
    if not path.is_socket():
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(str(path))
        except OSError:
            path.unlink(missing_ok=True)
            return
    raise OSError("another program serves this channel")
