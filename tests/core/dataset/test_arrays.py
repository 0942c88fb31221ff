from __future__ import annotations

import io
import zipfile

import numpy as np
import pytest

from yamsim_cli.core.dataset.ground_truth_files import dump_arrays, dump_depth, load_arrays, load_depth
from yamsim_cli.core.errors import DatasetError

MOST = 10_000
ARRAYS = {"depth": np.arange(12, dtype=np.uint16).reshape(3, 4), "K": np.eye(3), "b": np.array([True, False])}


def test_arrays_come_back_as_they_were() -> None:
    found = load_arrays(dump_arrays(ARRAYS), MOST)
    assert list(found) == list(ARRAYS)
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(found[name], array)
        assert found[name].dtype == array.dtype


def test_numpy_reads_the_written_arrays() -> None:
    with np.load(io.BytesIO(dump_arrays(ARRAYS))) as archive:
        np.testing.assert_array_equal(archive["depth"], ARRAYS["depth"])


def test_arrays_written_by_numpy_are_read() -> None:
    stream = io.BytesIO()
    np.savez_compressed(stream, a=np.asfortranarray(np.arange(6.0).reshape(2, 3)))
    np.testing.assert_array_equal(load_arrays(stream.getvalue(), MOST)["a"], np.arange(6.0).reshape(2, 3))


def test_equal_arrays_give_equal_bytes_at_any_time(monkeypatch: pytest.MonkeyPatch) -> None:
    first = dump_arrays(ARRAYS)
    monkeypatch.setattr("time.time", lambda: 2e9)
    monkeypatch.setattr("time.localtime", lambda *_: (2033, 5, 18, 3, 33, 20, 2, 138, 0))
    assert dump_arrays({name: array.copy(order="F") for name, array in ARRAYS.items()}) == first
    assert all(entry.date_time[0] == 1980 for entry in zipfile.ZipFile(io.BytesIO(first)).infolist())


def archive_of(content: bytes, name: str = "depth.npy") -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, content)
    return stream.getvalue()


def npy(header: str, content: bytes = b"") -> bytes:
    text = header.encode().ljust(118 - 1) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + content


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"PK\x03\x04",
        dump_arrays(ARRAYS)[:-30],
        dump_arrays(ARRAYS)[:40] + b"\xff\xff" + dump_arrays(ARRAYS)[42:],
        archive_of(b"no array"),
        archive_of(npy("{'descr': '<u2', 'fortran_order': False, 'shape': (1000000000000,), }")),
        archive_of(npy("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }", b"cos\nsystem\n(S'true'\ntR.")),
        archive_of(npy("{'descr': '<u2', 'fortran_order': False, 'shape': (-1,), }")),
        archive_of(npy("__import__('os').system('true')")),
    ],
    ids=["empty", "start", "cut", "altered", "no array", "huge shape", "objects", "negative", "code"],
)
def test_damage_is_told_and_nothing_is_run(data: bytes) -> None:
    with pytest.raises(DatasetError, match="not a valid npz"):
        load_arrays(data, MOST)


def test_an_archive_that_unpacks_to_gigabytes_is_not_unpacked() -> None:
    with pytest.raises(DatasetError, match="holds 1000000 bytes; at most 10000 are read"):
        load_arrays(archive_of(bytes(1_000_000)), MOST)


def test_depth_has_the_format_of_raiden() -> None:
    depth = np.array([[0, 1000], [2500, 65535]], np.uint16)
    with np.load(io.BytesIO(dump_depth(depth))) as archive:
        assert archive.files == ["depth"]
        assert archive["depth"].dtype == np.uint16
    np.testing.assert_array_equal(load_depth(dump_depth(depth)), depth)
