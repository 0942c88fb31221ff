"""Programs on a simulated bus: their frames arrive, and none does harm."""

from __future__ import annotations

import random
import resource
import select
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest

from yamsim_cli.core.errors import ResourceError
from yamsim_cli.real.motors import can_frames as frames
from yamsim_cli.real.motors.can_frames import CanFrame
from yamsim_cli.real.motors.motor import MOTOR_KINDS, Motor
from yamsim_cli.real.motors.motor_bus import MotorBus
from yamsim_cli.real.serve import can_bus
from yamsim_cli.real.serve.can_bus import KernelBus, UnixBus, program_environment

ENABLE = struct.pack("=IB3x8s", 1, 8, b"\xff" * 7 + b"\xfc")


@pytest.fixture
def served(tmp_path: Path) -> Iterator[UnixBus]:
    bus = UnixBus(tmp_path / "buses", "can0")
    yield bus
    bus.close()


def join(bus: UnixBus) -> socket.socket:
    one = socket.socket(socket.AF_UNIX)
    one.settimeout(5)
    one.connect(str(bus.path))
    heard(bus)
    return one


def heard(bus: UnixBus) -> list[CanFrame]:
    """Return the bus's frames until no more arrive."""
    found = []
    while ready := select.select(bus.readers, [], [], 0.02)[0]:
        found += bus.receive(set(ready))
    return found


def test_a_frame_gets_there_whole_however_it_is_cut(served: UnixBus) -> None:
    one = join(served)
    one.sendall(ENABLE[:5])
    assert heard(served) == []
    one.sendall(ENABLE[5:] + ENABLE)
    assert heard(served) == [CanFrame(1, b"\xff" * 7 + b"\xfc")] * 2
    served.send(CanFrame(0x11, b"abc"))
    assert one.recv(16) == struct.pack("=IB3x8s", 0x11, 3, b"abc")


def test_programs_on_a_bus_hear_each_other(served: UnixBus) -> None:
    one, other = join(served), join(served)
    one.sendall(ENABLE)
    assert len(heard(served)) == 1
    assert other.recv(16) == ENABLE
    one.setblocking(False)
    with pytest.raises(BlockingIOError):
        one.recv(16)


def test_random_bytes_do_no_harm_and_fill_no_memory(served: UnixBus) -> None:
    """A program that sends 10,000 random messages and never reads; another one is answered all the same."""
    motors = MotorBus("can0", [Motor(1, MOTOR_KINDS["DM4340"])])
    noisy, other = join(served), join(served)
    draw = random.Random(5)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for k in range(10_000):
        noisy.sendall(draw.randbytes(draw.randrange(1, 64)) if k % 3 else ENABLE)
        if k % 20 == 0:
            other.setblocking(False)
            while select.select([other], [], [], 0)[0]:
                other.recv(65_536)
            ready = select.select(served.readers, [], [], 0)[0]
            for frame in served.receive(set(ready)):
                for answer in motors.send(frame, 0.0):
                    served.send(answer)
    assert len(served.clients) == 2
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 20_000
    noisy.close()
    heard(served)
    assert len(served.clients) == 1


def test_programs_beyond_the_limit_are_disconnected(served: UnixBus) -> None:
    joined = [join(served) for _ in range(20)]
    assert len(served.clients) == 16
    assert joined[-1].recv(16) == b""


def test_the_socket_of_a_killed_server_is_replaced(tmp_path: Path) -> None:
    left = UnixBus(tmp_path / "buses", "can0")
    with pytest.raises(ResourceError, match="another program serves this channel"):
        UnixBus(tmp_path / "buses", "can0")
    for one in left.readers:
        one.close()
    UnixBus(tmp_path / "buses", "can0").close()


def test_a_folder_that_others_can_reach_is_refused(tmp_path: Path) -> None:
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o755)
    with pytest.raises(ResourceError, match="other users can access this folder"):
        UnixBus(tmp_path / "open", "can0")


def test_a_program_finds_the_buses_first(served: UnixBus, tmp_path: Path) -> None:
    environ = program_environment({"PYTHONPATH": "/own", "HOME": "/home"}, served.path.parent)
    site, own = environ["PYTHONPATH"].split(":")
    entry = next(Path(site).glob("*.dist-info/entry_points.txt")).read_text()
    assert "socketcan = yamsim_can:Bus" in entry and Path(site, "yamsim_can.py").exists()
    assert own == "/own" and environ.keys() == {"PYTHONPATH", "YAMSIM_CAN_FOLDER"}
    with pytest.raises(ResourceError, match="no server runs there"):
        program_environment({}, tmp_path)


def test_frames_of_other_kinds_are_ignored() -> None:
    for flag in (0x80000000, 0x40000000, 0x20000000):
        assert frames.parse_frame(struct.pack("=IB3x8s", 1 | flag, 8, bytes(8))) is None
    assert frames.parse_frame(struct.pack("=IB3x8s", 0x800, 8, bytes(8))) is None
    assert frames.parse_frame(struct.pack("=IB3x8s", 1, 9, bytes(8))) is None
    assert frames.parse_frame(struct.pack("=IB3x8s", 1, 2, b"abcdefgh")) == CanFrame(1, b"ab")


class CanSocket:
    """Replaces a raw socket of the kernel: datagrams of one frame, to the other end."""

    def __init__(self, *kind: int) -> None:
        self.kind = kind
        self.bound: tuple[str] | None = None
        self._ours, self.other = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.fileno, self.send, self.recv = self._ours.fileno, self._ours.send, self._ours.recv
        self.setblocking = self._ours.setblocking

    def bind(self, address: tuple[str]) -> None:
        if address != ("can0",):
            raise OSError(19, "No such device")
        self.bound = address

    def close(self) -> None:
        self._ours.close()


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[CanSocket]]:
    """A kernel with one CAN interface, can0; the sockets that are opened there."""
    opened: list[CanSocket] = []

    class Kernel:
        AF_CAN, SOCK_RAW, CAN_RAW = 29, 3, 1

        @staticmethod
        def socket(*kind: int) -> CanSocket:
            opened.append(CanSocket(*kind))
            return opened[-1]

    monkeypatch.setattr(can_bus, "socket", Kernel)
    yield opened
    for one in opened:
        one.close()
        one.other.close()


def test_an_interface_of_the_kernels_carries_the_same_frames(kernel: list[CanSocket]) -> None:
    bus = KernelBus("can0")
    (can,) = kernel
    assert can.kind == (29, 3, 1) and can.bound == ("can0",)
    (reader,) = bus.readers
    assert not list(bus.receive({reader}))  # nothing has come, and it does not wait
    can.other.send(ENABLE)
    can.other.send(struct.pack("=IB3x8s", 1 | 0x80000000, 8, bytes(8)))  # Of another kind, which no motor has.
    can.other.send(ENABLE)
    assert [frame.id for frame in bus.receive({reader})] == [1, 1]
    bus.send(CanFrame(0x11, b"12345678"))
    assert can.other.recv(64) == frames.encode_frame(CanFrame(0x11, b"12345678"))
    can.other.close()
    bus.send(CanFrame(0x11, b"12345678"))  # an interface that went down loses frames, and stops nothing
    bus.close()


def test_a_flood_on_an_interface_is_read_in_parts(kernel: list[CanSocket], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(can_bus, "MAX_FRAMES_PER_READ", 5)
    bus = KernelBus("can0")
    for _ in range(8):
        kernel[0].other.send(ENABLE)
    (reader,) = bus.readers
    assert [len(list(bus.receive({reader}))) for _ in range(2)] == [5, 3]
    bus.close()


def test_an_interface_that_is_not_there_is_one_line(kernel: list[CanSocket]) -> None:
    with pytest.raises(ResourceError, match="CAN interface can1: cannot be opened: No such device"):
        KernelBus("can1")
