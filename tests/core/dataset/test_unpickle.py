"""Malicious pickles run nothing, and take no memory or time beyond their few bytes."""

from __future__ import annotations

import pickle
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from yamsim_cli.core.dataset.safe_unpickle import MAX_BYTES, ForbiddenPickleError, read_pickle
from yamsim_cli.core.errors import DatasetError

PROTO = b"\x80\x04"


def text(value: str) -> bytes:
    return pickle.SHORT_BINUNICODE + bytes([len(value)]) + value.encode()


def named(module: str, name: str) -> bytes:
    return text(module) + text(name) + pickle.STACK_GLOBAL


def number(value: int) -> bytes:
    return pickle.LONG1 + b"\x08" + struct.pack("<q", value)


def shape(*sides: int) -> bytes:
    return pickle.MARK + b"".join(map(number, sides)) + pickle.TUPLE


def dtype(name: str) -> bytes:
    return named("numpy", "dtype") + text(name) + pickle.NEWFALSE + pickle.NEWTRUE + pickle.TUPLE3 + pickle.REDUCE


def empty(*sides: int) -> bytes:
    """An array of this shape without content."""
    code = named("numpy._core.multiarray", "_reconstruct") + named("numpy", "ndarray") + shape(*sides)
    return code + pickle.SHORT_BINBYTES + b"\x01b" + pickle.TUPLE3 + pickle.REDUCE


def state(sides: bytes, raw: bytes) -> bytes:
    """An array of float32 with this shape, made of these bytes."""
    return (
        empty(0) + pickle.MARK + number(1) + sides + dtype("f4") + pickle.NEWFALSE + raw + pickle.TUPLE + pickle.BUILD
    )


def frame(value: bytes) -> bytes:
    """A pickle of {"joints": value}."""
    return PROTO + pickle.EMPTY_DICT + text("joints") + value + pickle.SETITEM + pickle.STOP


def doubled(times: int) -> bytes:
    """A tuple of two references to a tuple of two references ..."""
    code = pickle.EMPTY_TUPLE + pickle.BINPUT + b"\x00"
    for k in range(times):
        twice = (pickle.BINGET + bytes([k])) * 2
        code += pickle.POP + twice + pickle.TUPLE2 + pickle.BINPUT + bytes([k + 1])
    return code


DOUBLED = doubled(60)
FOUR_BYTES = pickle.SHORT_BINBYTES + b"\x04\0\0\0\0"
BOMBS = {
    # An index into the memo: the C unpickler allocates a table of that many entries.
    "memo": frame(pickle.NONE + pickle.LONG_BINPUT + struct.pack("<I", 2**31)),
    "memo in text": frame(pickle.NONE + b"p2147483648\n"),
    # Missing bytes.
    "bytes": frame(pickle.BINBYTES8 + struct.pack("<Q", 2**40)),
    "bytearray": frame(pickle.BYTEARRAY8 + struct.pack("<Q", 2**33)),
    "text": frame(pickle.BINUNICODE8 + struct.pack("<Q", 2**40)),
    "pickle frame": PROTO + pickle.FRAME + struct.pack("<Q", 2**40) + b"}.",
    # Shapes beyond their bytes.
    "reconstruct": frame(empty(2**33)),
    "ndarray itself": frame(named("numpy", "ndarray") + shape(2**33) + pickle.TUPLE1 + pickle.REDUCE),
    "shape": frame(state(shape(2**20, 2**20), FOUR_BYTES)),
    "shape of zeros": frame(state(shape(2**62, 0), FOUR_BYTES)),
    "negative shape": frame(state(shape(-1, -1), FOUR_BYTES)),
    "endless shape": frame(state(shape(*[1] * 2000), FOUR_BYTES)),
    "wide type": frame(dtype("V2147483647")),
    "array of arrays": frame(dtype("(9999,9999)f4")),
    # One long value, many times.
    "shared bytes": frame(
        pickle.BINBYTES
        + struct.pack("<I", 2**19)
        + bytes(2**19)
        + pickle.BINPUT
        + b"\x01"
        + pickle.POP
        + pickle.EMPTY_LIST
        + pickle.MARK
        + (pickle.BINGET + b"\x01") * 10_000
        + pickle.APPENDS
    ),
    # 2^60 values in 200 bytes: as a value, as a dictionary's key, as a shape.
    "doubled tuples": frame(DOUBLED),
    "doubled key": PROTO + pickle.EMPTY_DICT + DOUBLED + pickle.NONE + pickle.SETITEM + b".",
    "doubled shape": frame(state(DOUBLED, FOUR_BYTES)),
    "deep": frame(pickle.EMPTY_LIST * 50_000 + pickle.APPEND * 49_999),
    "a list in itself": frame(pickle.EMPTY_LIST + pickle.BINPUT + b"\x00" + pickle.BINGET + b"\x00" + pickle.APPEND),
    "long number": frame(pickle.LONG4 + struct.pack("<i", 100_000) + b"\x7f" * 100_000),
    "long number in text": frame(b"L" + b"9" * 500_000 + b"L\n"),
    "sets": frame(b"\x8f" * 500_000),
}


# Read as their small content: only the C unpickler is affected.
HARMLESS = {"memo", "memo in text", "pickle frame"}


@pytest.mark.parametrize("name", sorted(BOMBS.keys() - HARMLESS))
def test_a_bomb_is_refused(name: str) -> None:
    with pytest.raises(DatasetError) as caught:
        read_pickle(BOMBS[name])
    assert len(str(caught.value)) < 400
    assert "\n" not in str(caught.value)


def test_bombs_take_neither_memory_nor_time() -> None:
    """All of them, in a process with at most 200 MB beyond its start, within seconds."""
    script = (
        "import resource\n"
        "from tests.core.dataset.test_unpickle import BOMBS, DatasetError, read_pickle\n"
        "used = int(open('/proc/self/statm').read().split()[0]) * resource.getpagesize()\n"
        "resource.setrlimit(resource.RLIMIT_AS, (used + 200_000_000,) * 2)\n"
        "for name, data in BOMBS.items():\n"
        "    try: read_pickle(data)\n"
        "    except DatasetError as error: assert 'MemoryError' not in str(error), name\n"
    )
    root = Path(__file__).resolve().parents[3]
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=root, timeout=60, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_the_parts_of_a_bomb_make_an_array_when_they_fit() -> None:
    (array,) = read_pickle(frame(state(shape(1), FOUR_BYTES))).values()
    assert array.dtype == np.float32
    assert array.tolist() == [0.0]


def test_a_pickle_over_the_size_limit_is_not_read() -> None:
    with pytest.raises(ForbiddenPickleError, match=f"at most {MAX_BYTES} are read"):
        read_pickle(pickle.dumps(bytes(MAX_BYTES)))


@pytest.mark.parametrize(
    ("code", "said"),
    [
        (frame(named("numpy", "dtype") + text("O") + pickle.TUPLE1 + pickle.REDUCE), "an array of type O"),
        (frame(named("numpy", "dtype") + text("i4,i4") + pickle.TUPLE1 + pickle.REDUCE), "an array of type i4,i4"),
        (frame(named("numpy", "dtype")), "a function or a type"),
        (frame(named("numpy", "dtype") + pickle.EMPTY_DICT + pickle.BUILD), "changes a function"),
        (frame(named("numpy", "ndarray") + pickle.EMPTY_TUPLE + pickle.NEWOBJ), "the instruction NEWOBJ"),
        (frame(pickle.EXT1 + b"\x01"), "the instruction EXT1"),
        (frame(pickle.PERSID + b"x\n"), "the instruction PERSID"),
        (frame(b"cos\nsystem\n"), "names os.system"),
        (frame(pickle.MARK + b"ios\nsystem\n"), "names os.system"),
        (frame(named("os\x1b[2J", "system")), "names os\N{REPLACEMENT CHARACTER}[2J.system"),
    ],
)
def test_forbidden_content_of_a_pickle_is_named(code: bytes, said: str) -> None:
    with pytest.raises(ForbiddenPickleError) as caught:
        read_pickle(code)
    assert said in str(caught.value)


def test_no_module_is_imported_for_a_pickle() -> None:
    with pytest.raises(ForbiddenPickleError, match=r"antigravity\.fly"):
        read_pickle(frame(named("antigravity", "fly")))
    assert "antigravity" not in sys.modules


@pytest.mark.parametrize("dtype", ["<f4", ">f8", "|b1", "<i8", "<U7", "|S3", "<f2", "<c8"])
@pytest.mark.parametrize("protocol", [3, 4, 5])
def test_arrays_of_numbers_and_text_are_read(dtype: str, protocol: int) -> None:
    array = np.arange(6).reshape(2, 3).astype(dtype)
    for value in (array, np.asfortranarray(array), array[:0], array[0, 0]):
        found = read_pickle(pickle.dumps(value, protocol))
        assert found.dtype == value.dtype
        assert np.array_equal(found, value)


def test_arrays_can_be_written_to_as_others_can() -> None:
    array = read_pickle(pickle.dumps(np.zeros(3), 5))
    array += 1
    assert array.tolist() == [1, 1, 1]


@pytest.mark.parametrize("shape", [(), (2,), (1, 2)])
@pytest.mark.parametrize("protocol", [4, 5])
def test_text_in_arrays_of_objects_is_read(shape: tuple[int, ...], protocol: int) -> None:
    """As raiden's converter writes prompts."""
    array = np.full(shape, "put it there", dtype=object)
    read = read_pickle(pickle.dumps({"prompt": array}, protocol=protocol))["prompt"]
    assert read.dtype.kind == "U"
    assert read.shape == shape
    assert (read == "put it there").all()


@pytest.mark.parametrize("inside", [None, 3, {"a": 1}, b"text", np.zeros(2)])
def test_other_objects_in_arrays_are_refused(inside: object) -> None:
    array = np.empty((1,), dtype=object)
    array[0] = inside
    with pytest.raises(ForbiddenPickleError, match="an array of objects"):
        read_pickle(pickle.dumps({"prompt": array}))
