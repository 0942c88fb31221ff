"""Non-blocking socket servers, and the folder of `serve-robot`'s Unix sockets."""

from __future__ import annotations

import os
import socket
import stat
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from yamsim_cli.core.errors import ResourceError

CAMERA_SOCKET = "cameras.sock"  # its dot avoids conflicts with bus names

_MAX_CLIENTS = 16  # further connections are closed


def default_socket_folder(environ: Mapping[str, str]) -> Path:
    """Return this user's socket folder, in XDG_RUNTIME_DIR if set, else in the temporary folder."""
    runtime = environ.get("XDG_RUNTIME_DIR")
    return Path(runtime) / "yamsim-can" if runtime else Path(tempfile.gettempdir()) / f"yamsim-can-{os.getuid()}"


@dataclass(eq=False)
class ClientConnection:
    """One connection to a server: `received` bytes are not handled yet, `outgoing` bytes not sent."""

    socket: socket.socket
    received: bytearray = field(default_factory=bytearray)
    outgoing: bytearray = field(default_factory=bytearray)
    handshake_done: bool = False


class SocketServer:
    """Server on a listening socket. The caller closes the server; no method blocks.

    Args:
        listener: closed with the server.
        read_bytes: per read from a client, at most.
        max_outgoing: unsent bytes above which a client that reads nothing is dropped.
    """

    def __init__(self, listener: socket.socket, read_bytes: int, max_outgoing: int | None = None) -> None:
        self._listener, self._read_bytes, self._max_outgoing = listener, read_bytes, max_outgoing
        self._clients: dict[socket.socket, ClientConnection] = {}
        listener.setblocking(False)
        listener.listen(_MAX_CLIENTS)

    @property
    def clients(self) -> list[ClientConnection]:
        """Connected clients."""
        return list(self._clients.values())

    @property
    def readers(self) -> list[socket.socket]:
        """Sockets to select for reading."""
        return [self._listener, *self._clients]

    @property
    def writers(self) -> list[socket.socket]:
        """Sockets of clients with unsent bytes."""
        return [one for one, client in self._clients.items() if client.outgoing]

    def receive_from_clients(self, ready: set[socket.socket]) -> Iterator[ClientConnection]:
        """Accept connections, receive from `ready` sockets, and yield the clients that sent bytes."""
        if self._listener in ready:
            self._accept_client()
        for one in ready & self._clients.keys():
            # The caller may have dropped it while handling an earlier client.
            client = self._clients.get(one)
            if client is not None and self._receive_bytes(client):
                yield client

    def send_outgoing(self, client: ClientConnection) -> None:
        """Send as many bytes as the socket accepts."""
        try:
            del client.outgoing[: client.socket.send(client.outgoing)]
        except BlockingIOError:
            if self._max_outgoing is not None and len(client.outgoing) > self._max_outgoing:
                self.drop_client(client)
        except OSError:
            self.drop_client(client)

    def flush(self) -> None:
        """Send all clients' outgoing bytes."""
        for client in self.clients:
            if client.outgoing:
                self.send_outgoing(client)

    def drop_client(self, client: ClientConnection) -> None:
        """Close a client's connection."""
        client.socket.close()
        self._clients.pop(client.socket, None)

    def close(self) -> None:
        """Close all connections and the listening socket."""
        for client in self.clients:
            self.drop_client(client)
        self._listener.close()

    def _accept_client(self) -> None:
        try:
            one, _ = self._listener.accept()
        except OSError:
            return
        if len(self._clients) >= _MAX_CLIENTS:
            one.close()
            return
        one.setblocking(False)
        if one.family != socket.AF_UNIX:
            one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._clients[one] = ClientConnection(one)

    def _receive_bytes(self, client: ClientConnection) -> bool:
        try:
            data = client.socket.recv(self._read_bytes)
        except BlockingIOError:
            return False
        except OSError:
            data = b""
        if not data:
            self.drop_client(client)
            return False
        client.received += data
        return True


class TcpServer(SocketServer):
    """Server on a TCP `port`, 0 for a free one; `flag` sets the port, for the error message.

    Raises:
        ResourceError: the server cannot listen on the port.
    """

    def __init__(self, host: str, port: int, flag: str, read_bytes: int, max_outgoing: int | None = None) -> None:
        try:
            listener = socket.create_server((host, port))
        except OSError as error:
            raise ResourceError(f"cannot listen on {host}:{port}: {error.strerror}; try another {flag}") from error
        super().__init__(listener, read_bytes, max_outgoing)
        self.port = int(listener.getsockname()[1])


class UnixServer(SocketServer):
    """Server on a Unix socket `path` in a folder of the user's own; `close` removes the socket.

    Raises:
        ResourceError: another program listens on the socket, or the folder or the socket cannot be made.
    """

    def __init__(self, path: Path, read_bytes: int) -> None:
        self.path = path
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            _make_folder(path.parent)
            _remove_stale_socket(path)
            listener.bind(str(path))
        except OSError as error:
            listener.close()
            raise ResourceError(f"cannot listen on {path}: {error.strerror or error}") from error
        except ResourceError:
            listener.close()
            raise
        super().__init__(listener, read_bytes)

    def close(self) -> None:
        """Close all connections, and remove the socket's file."""
        super().close()
        self.path.unlink(missing_ok=True)


def _make_folder(folder: Path) -> None:
    """Make a folder, or raise a ResourceError if other users can access it."""
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.lstat()
    except OSError as error:
        raise ResourceError(f"{folder}: cannot be made: {error.strerror}; give another --folder") from error
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid() or found.st_mode & 0o077:
        raise ResourceError(f"{folder}: other users can access this folder; give another --folder")


def _remove_stale_socket(path: Path) -> None:
    if not path.is_socket():
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(str(path))
        except OSError:
            path.unlink(missing_ok=True)
            return
    raise OSError("another program serves this channel")
