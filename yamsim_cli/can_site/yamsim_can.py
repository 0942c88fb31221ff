"""python-can bus on the sockets of `yamsim serve-robot`, for programs that `yamsim can-run` starts.

The entry point beside this file replaces python-can's `socketcan` interface. The module does not import yamsim. A
channel that yamsim does not serve is opened as a CAN interface of the machine.
"""

import os
import select
import socket
import struct
import time
from pathlib import Path

import can
from can.interfaces.socketcan import SocketcanBus

_FRAME = struct.Struct("=IB3x8s")  # Linux `struct can_frame`: identifier with flags, length, 8 data bytes
_EXTENDED, _REMOTE, _ERROR = 0x80000000, 0x40000000, 0x20000000  # flags in the identifier
_FOLDER_VARIABLE = "YAMSIM_CAN_FOLDER"  # environment variable: folder with a Unix socket per channel


def _bus_socket_path(channel):
    return Path(os.environ[_FOLDER_VARIABLE]) / str(channel)


class Bus(can.BusABC):
    """Connection to a CAN bus that yamsim simulates."""

    def __new__(cls, channel, **kwargs):
        """Return a connection if yamsim serves the channel, else python-can's `SocketcanBus`."""
        if not _bus_socket_path(channel).is_socket():
            return SocketcanBus(channel, **kwargs)
        return super().__new__(cls)

    def __init__(self, channel, can_filters=None, receive_own_messages=False, **kwargs):
        self.channel = channel
        self.channel_info = f"yamsim channel '{channel}'"
        self._receives_own = receive_own_messages
        self._own_messages = []
        self._buffer = b""
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            self._socket.connect(str(_bus_socket_path(channel)))
        except OSError as error:
            self._socket.close()
            raise can.CanInitializationError(
                f"{channel}: yamsim no longer serves this channel: {error.strerror}"
            ) from error
        self._socket.setblocking(False)
        super().__init__(channel=channel, can_filters=can_filters, **kwargs)

    def send(self, msg, timeout=None):
        """Send a message on the bus."""
        flags = _EXTENDED * msg.is_extended_id | _REMOTE * msg.is_remote_frame | _ERROR * msg.is_error_frame
        data = bytes(msg.data)
        wire = _FRAME.pack(msg.arbitration_id | flags, msg.dlc, data)
        while wire:
            try:
                wire = wire[self._socket.send(wire) :]
            except BlockingIOError:
                if not select.select([], [self._socket], [], timeout)[1]:
                    raise can.CanOperationError(
                        f"{self.channel}: the bus accepts no message within the timeout"
                    ) from None
            except OSError as error:
                raise can.CanOperationError(f"{self.channel}: the connection is lost: {error.strerror}") from error
        if self._receives_own:
            self._own_messages.append(self._decode_message(_FRAME.pack(msg.arbitration_id | flags, msg.dlc, data)))

    def _recv_internal(self, timeout):
        if self._own_messages:
            return self._own_messages.pop(0), False
        if len(self._buffer) < _FRAME.size:
            try:
                if not select.select([self._socket], [], [], timeout)[0]:
                    return None, False
                data = self._socket.recv(256 * _FRAME.size)
            except (OSError, ValueError) as error:
                raise can.CanOperationError(f"{self.channel} was closed: {error}") from error
            if not data:
                raise can.CanOperationError(f"{self.channel}: the connection is lost: yamsim serve-robot has ended")
            self._buffer += data
            if len(self._buffer) < _FRAME.size:
                return None, False
        wire, self._buffer = self._buffer[: _FRAME.size], self._buffer[_FRAME.size :]
        return self._decode_message(wire), False

    def _decode_message(self, wire):
        identifier, length, data = _FRAME.unpack(wire)
        extended = bool(identifier & _EXTENDED)
        return can.Message(
            timestamp=time.time(),
            arbitration_id=identifier & (0x1FFFFFFF if extended else 0x7FF),
            is_extended_id=extended,
            is_remote_frame=bool(identifier & _REMOTE),
            is_error_frame=bool(identifier & _ERROR),
            dlc=length,
            data=data[:length],
            channel=self.channel,
        )

    @property
    def state(self):
        """State of the bus, which is always active."""
        return can.BusState.ACTIVE

    def fileno(self):
        """Return the socket's file descriptor, which `select` needs."""
        return self._socket.fileno()

    def shutdown(self):
        """Close the connection."""
        super().shutdown()
        self._socket.close()
