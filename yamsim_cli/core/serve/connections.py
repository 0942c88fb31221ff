"""Programs at a socket of ours, none of which is ever waited for."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from dataclasses import dataclass, field

from ..errors import ResourceError

# Programs at a time; more are hung up on.
_MOST = 16


@dataclass(eq=False)
class Program:
    """One program.

    Attributes:
        socket: on which it is.
        came: what came from it and is not taken yet.
        waits: what it is told and has not taken yet.
        greeted: for who serves it: whether it has said what it speaks.
    """

    socket: socket.socket
    came: bytearray = field(default_factory=bytearray)
    waits: bytearray = field(default_factory=bytearray)
    greeted: bool = False


class Connections:
    """The programs at a listening socket; close it.

    Args:
        listener: is closed with it.
        read_bytes: that are read at once.
        most_waiting: bytes that may wait for a program which takes none, before it is hung up on; None for any.
    """

    def __init__(self, listener: socket.socket, read_bytes: int, most_waiting: int | None = None) -> None:
        self._listener, self._read_bytes, self._most_waiting = listener, read_bytes, most_waiting
        self._programs: dict[socket.socket, Program] = {}
        listener.setblocking(False)
        listener.listen(_MOST)

    @property
    def readers(self) -> list[socket.socket]:
        """What to wait for until there may be something to read."""
        return [self._listener, *self._programs]

    @property
    def writers(self) -> list[socket.socket]:
        """What to wait for until a program takes what waits for it."""
        return [one for one, program in self._programs.items() if program.waits]

    @property
    def programs(self) -> list[Program]:
        """All that are there."""
        return list(self._programs.values())

    def heard(self, ready: set[socket.socket]) -> Iterator[Program]:
        """The programs from which something came, of the sockets where there is something to read."""
        if self._listener in ready:
            self._accept()
        for one in ready & self._programs.keys():
            # One that takes nothing may be gone by what another one says.
            program = self._programs.get(one)
            if program is not None and self._read(program):
                yield program

    def flush(self, program: Program | None = None) -> None:
        """Send a program what waits for it, as far as it takes it; or all of them."""
        if program is None:
            for one in self.programs:
                if one.waits:
                    self.flush(one)
            return
        try:
            del program.waits[: program.socket.send(program.waits)]
        except BlockingIOError:
            if self._most_waiting is not None and len(program.waits) > self._most_waiting:
                self.drop(program)
        except OSError:
            self.drop(program)

    def drop(self, program: Program) -> None:
        """Hang up on a program."""
        program.socket.close()
        self._programs.pop(program.socket, None)

    def close(self) -> None:
        """Hang up on all, and listen no more."""
        for program in self.programs:
            self.drop(program)
        self._listener.close()

    def _accept(self) -> None:
        try:
            one, _ = self._listener.accept()
        except OSError:
            return
        if len(self._programs) >= _MOST:
            one.close()
            return
        one.setblocking(False)
        if one.family != socket.AF_UNIX:
            one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._programs[one] = Program(one)

    def _read(self, program: Program) -> bool:
        """Whether something came."""
        try:
            data = program.socket.recv(self._read_bytes)
        except BlockingIOError:
            return False
        except OSError:
            data = b""
        if not data:
            self.drop(program)
            return False
        program.came += data
        return True


class Server:
    """A `loop.Port` whose programs are at one socket; close it. It never blocks."""

    def __init__(self, listener: socket.socket, read_bytes: int, most_waiting: int | None = None) -> None:
        self._connections = Connections(listener, read_bytes, most_waiting)

    @property
    def readers(self) -> list[socket.socket]:
        """What to wait for until there may be something to read."""
        return self._connections.readers

    @property
    def writers(self) -> list[socket.socket]:
        """What to wait for until a program takes what it is told."""
        return self._connections.writers

    def close(self) -> None:
        """Hang up on all, and listen no more."""
        self._connections.close()


def listen_at(host: str, port: int, flag: str) -> socket.socket:
    """A socket that listens at a TCP port; 0 takes any.

    Args:
        flag: by which a person chooses another one, for the message.

    Raises:
        ResourceError: the port cannot be had.
    """
    try:
        return socket.create_server((host, port))
    except OSError as error:
        raise ResourceError(f"{host}:{port} cannot be listened on: {error.strerror}; try another {flag}") from error
