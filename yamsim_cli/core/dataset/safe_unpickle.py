"""Read pickles from untrusted sources: only numpy arrays and plain containers of limited size.

A pickle is a program. Four restrictions make it harmless:

- Names that a pickle may call resolve to small classes in this module. They do not resolve to numpy functions, which
  trust shapes and buffers. No module is ever imported for a pickle.
- Only opcodes that data needs are allowed, and the pure Python unpickler runs them. The C unpickler allocates a table
  as large as the largest memo index: gigabytes for a file of ten bytes.
- Dictionary keys are text or numbers. Hashing nested tuples with shared elements could take exponential time.
- The result is copied with a limit on its size. Otherwise, lists that are shared many times would multiply when
  printed or hashed.
"""

from __future__ import annotations

import io
import math
import pickle
import pickletools
import re
import struct
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from ..errors import DatasetError

# A recorded frame has 2 kB and 150 values. An opcode takes at least one byte and allocates at most 64 bytes, so these
# limits bound the memory too.
MAX_BYTES: Final = 2**20  # bytes of a pickle, and of its decoded arrays and text
_MAX_VALUES: Final = 20_000  # decoded values
_MAX_DEPTH: Final = 16  # levels of nested containers
_MAX_INT_BITS: Final = 1024  # bits of an integer

# Booleans, numbers, text of fixed width, and objects ("O8"). Object arrays are accepted only if all elements are text.
_DTYPE = re.compile(r"[biufc]\d{1,2}|[SU]\d{1,5}|O8")

# Opcodes of all protocols that build numbers, text, lists, tuples, dictionaries and arrays. INST is included so that
# the error message can name the requested class.
_OPCODES: Final = """
    PROTO FRAME STOP MARK POP POP_MARK DUP PUT BINPUT LONG_BINPUT MEMOIZE GET BINGET LONG_BINGET
    NONE NEWTRUE NEWFALSE INT BININT BININT1 BININT2 LONG LONG1 LONG4 FLOAT BINFLOAT
    UNICODE SHORT_BINUNICODE BINUNICODE BINUNICODE8 SHORT_BINBYTES BINBYTES BINBYTES8 BYTEARRAY8
    EMPTY_LIST LIST APPEND APPENDS EMPTY_TUPLE TUPLE TUPLE1 TUPLE2 TUPLE3 EMPTY_DICT DICT SETITEM SETITEMS
    GLOBAL STACK_GLOBAL INST REDUCE BUILD
"""
_OPCODE_NAMES: Final = {ord(code.code): code.name for code in pickletools.opcodes}


class ForbiddenPickleError(DatasetError):
    """Raised for a pickle that names a function or class, or exceeds the size limits of a frame."""


class _DType:
    """Safe replacement for `numpy.dtype(text, align, copy)`, including the byte order that the pickle sets."""

    __slots__ = ("dtype",)

    def __init__(self, text: Any, *_: Any) -> None:
        if not isinstance(text, str) or not _DTYPE.fullmatch(text):
            raise ForbiddenPickleError(
                f"the pickle has an array of type {_describe_value(text)}; only numbers and text are read"
            )
        self.dtype: np.dtype[Any] = np.dtype(text)

    def __setstate__(self, state: Any) -> None:
        _, order, base, names, fields, *_ = state
        if order not in ("<", ">", "=", "|") or (base, names, fields) != (None, None, None):
            raise ForbiddenPickleError("the pickle has an array of records; only numbers and text are read")
        self.dtype = self.dtype.newbyteorder(order)


class _ArrayDescription:
    """Description of an array or numpy scalar in a pickle. `make_array` checks the description against the bytes."""

    __slots__ = ("_description", "_scalar")

    def __init__(self, *description: Any, scalar: bool = False) -> None:
        self._description = description
        self._scalar = scalar

    def __setstate__(self, state: Any) -> None:
        _, shape, dtype, fortran, raw = state
        self._description = (raw, dtype, shape, "F" if fortran else "C")

    @property
    def nbytes(self) -> int:
        raw, kind, *_ = self._description
        return sum(map(len, self._decode_texts())) if kind.dtype.hasobject else len(raw)

    def _decode_texts(self) -> list[str]:
        raw = self._description[0]
        if not isinstance(raw, list) or not all(isinstance(text, str) for text in raw):
            raise ForbiddenPickleError("the pickle has an array of objects; only numbers and text are read")
        return raw

    def make_array(self) -> Any:
        raw, kind, shape, order = self._description
        if kind.dtype.hasobject:
            texts = self._decode_texts()
            if math.prod(shape) != len(texts):
                raise ValueError(f"an array of shape {_describe_value(shape)} and {len(texts)} texts")
            return np.array(texts, dtype=np.str_).reshape(shape)
        if math.prod(shape) * kind.dtype.itemsize != len(raw) or min(shape, default=0) < 0:
            raise ValueError(f"an array of shape {_describe_value(shape)} and {kind.dtype} in {len(raw)} bytes")
        # The copy is writable and aligned.
        array = np.frombuffer(raw, kind.dtype).reshape(shape, order=order).copy(order=order)
        return array[()] if self._scalar else array


class _AllowedName:
    """Immutable callable that stands for an allowed name."""

    __slots__ = ("_call",)

    def __init__(self, call: Callable[..., Any] | None) -> None:
        self._call = call

    def __call__(self, *arguments: Any) -> Any:
        if self._call is None:
            raise ForbiddenPickleError("the pickle makes an array without content; it was not run")
        return self._call(*arguments)

    def __setstate__(self, state: Any) -> None:
        raise ForbiddenPickleError("the pickle changes a function; it was not run")


_NDARRAY = _AllowedName(None)  # stands for `numpy.ndarray`; a pickle can only pass it to `_reconstruct_array`


def _reconstruct_array(kind: Any, shape: Any, _: Any) -> _ArrayDescription:
    if kind is not _NDARRAY or shape != (0,):
        raise ForbiddenPickleError(f"the pickle makes an array of shape {_describe_value(shape)} without content")
    return _ArrayDescription(b"", _DType("u1"), (0,), "C")


def _from_buffer(raw: Any, dtype: Any, shape: Any, order: Any) -> _ArrayDescription:
    return _ArrayDescription(raw, dtype, shape, order)


def _scalar(dtype: Any, raw: Any) -> _ArrayDescription:
    return _ArrayDescription(raw, dtype, (), "C", scalar=True)


# Allowed (module, name) -> callable, with the module names of numpy 2 and of numpy 1.
_ALLOWED_NAMES: Final[dict[tuple[str, str], _AllowedName]] = {
    (f"{core}.{module}", name): _AllowedName(call)
    for core in ("numpy._core", "numpy.core")
    for module, name, call in (
        ("multiarray", "_reconstruct", _reconstruct_array),
        ("multiarray", "scalar", _scalar),
        ("numeric", "_frombuffer", _from_buffer),
    )
} | {("numpy", "ndarray"): _NDARRAY, ("numpy", "dtype"): _AllowedName(_DType)}


class _Dispatch(dict[int, Callable[[Any], None]]):
    def __missing__(self, code: int) -> Callable[[Any], None]:
        name = _OPCODE_NAMES.get(code, f"{code:#04x}")
        raise ForbiddenPickleError(f"the pickle has the instruction {name}, which is not allowed in a frame")


class _Unpickler(pickle._Unpickler):
    stack: list[Any]
    pop_mark: Callable[[], list[Any]]
    read: Callable[[int], bytes]

    dispatch = _Dispatch(
        {code: run for code, run in pickle._Unpickler.dispatch.items() if _OPCODE_NAMES[code] in _OPCODES.split()}
    )

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) not in _ALLOWED_NAMES:
            raise ForbiddenPickleError(
                f"the pickle names {_describe_value(module)}.{_describe_value(name)}, which is not allowed in "
                "a frame; it was not run"
            )
        return _ALLOWED_NAMES[module, name]

    def _set_items(self, items: list[Any]) -> None:
        for key, value in zip(items[::2], items[1::2], strict=True):
            if not isinstance(key, str | int):
                raise ForbiddenPickleError(f"the pickle has a key of type {type(key).__name__}; a key must be text")
            self.stack[-1][key] = value

    def load_setitem(self) -> None:
        items = self.stack[-2:]
        del self.stack[-2:]
        self._set_items(items)

    def load_setitems(self) -> None:
        self._set_items(self.pop_mark())

    def load_dict(self) -> None:
        items = self.pop_mark()
        self.stack.append({})
        self._set_items(items)

    def load_bytearray8(self) -> None:
        (size,) = struct.unpack("<Q", self.read(8))
        if size > MAX_BYTES:
            raise EOFError(f"{size} bytes are announced")
        self.stack.append(bytearray(self.read(size)))

    dispatch[pickle.SETITEM[0]] = load_setitem
    dispatch[pickle.SETITEMS[0]] = load_setitems
    dispatch[pickle.DICT[0]] = load_dict
    dispatch[pickle.BYTEARRAY8[0]] = load_bytearray8


def read_pickle(data: bytes) -> Any:
    """Return the content of a pickle: numbers, text, bytes, None, lists, tuples, dictionaries and numpy arrays.

    Raises:
        ForbiddenPickleError: the pickle names any other type, or exceeds the memory limit of a frame.
        DatasetError: the data is truncated, or not a pickle.
    """
    if len(data) > MAX_BYTES:
        raise ForbiddenPickleError(f"the pickle has {len(data)} bytes; at most {MAX_BYTES} are read")
    try:
        return _SizeLimitedCopy().copy_value(_Unpickler(io.BytesIO(data)).load(), 0)
    except DatasetError:
        raise
    # The unpickler can raise almost any exception on a broken pickle.
    except Exception as error:
        raise DatasetError(f"not a valid pickle: {type(error).__name__}: {_describe_value(str(error))}") from error


class _SizeLimitedCopy:
    """Copies the content of a pickle up to a size limit, and replaces array descriptions by arrays."""

    def __init__(self) -> None:
        self._values = _MAX_VALUES
        self._bytes = MAX_BYTES

    def copy_value(self, item: Any, depth: int) -> Any:
        self._values -= 1
        if depth > _MAX_DEPTH or self._values < 0:
            raise ForbiddenPickleError(f"the pickle has over {_MAX_VALUES} values, or {_MAX_DEPTH} nested levels")
        if isinstance(item, dict):
            return {self.copy_value(key, depth): self.copy_value(inner, depth + 1) for key, inner in item.items()}
        if isinstance(item, list | tuple):
            return type(item)([self.copy_value(inner, depth + 1) for inner in item])
        if isinstance(item, _ArrayDescription):
            self._spend_bytes(item.nbytes)
            return item.make_array()
        if isinstance(item, str | bytes | bytearray):
            self._spend_bytes(len(item))
        elif isinstance(item, int) and item.bit_length() > _MAX_INT_BITS:
            raise ForbiddenPickleError(f"the pickle has a number of {item.bit_length()} bits, over {_MAX_INT_BITS}")
        elif item is not None and not isinstance(item, int | float):
            raise ForbiddenPickleError("the pickle holds a function or a type, which is not allowed in a frame")
        return item

    def _spend_bytes(self, size: int) -> None:
        self._bytes -= size
        if self._bytes < 0:
            raise ForbiddenPickleError(f"the pickle holds more than {MAX_BYTES} bytes of arrays and text")


def _describe_value(value: Any) -> str:
    if isinstance(value, tuple) and len(value) <= 8 and all(isinstance(part, int) for part in value):
        text = f"({', '.join(map(_describe_value, value))})"
    elif isinstance(value, str | int | float):
        text = str(value) if not isinstance(value, int) or value.bit_length() < _MAX_INT_BITS else "a long number"
    else:
        text = type(value).__name__
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in text[:200])
