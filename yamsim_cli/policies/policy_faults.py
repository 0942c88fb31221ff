from __future__ import annotations

import sysconfig
import textwrap
import traceback
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

_YAMSIM_FOLDER = str(Path(__file__).resolve().parents[1])
# Python and installed packages. A fault is described by the last line outside these folders.
_INSTALLED_FOLDERS = tuple({sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib")})
_MAX_CHARACTERS = 300  # of an exception's message in a description


@dataclass(frozen=True)
class PolicyFault:
    """An exception that a policy's code raised, or another fault of the policy.

    Attributes:
        text: one line with the exception, and in brackets the last executed line of the user's code.
        traceback: traceback from the policy's first line on; empty if unknown.
    """

    text: str
    traceback: str = ""


def describe_fault(error: BaseException, folder: Path) -> PolicyFault:
    """Describe an exception that a policy raised, with paths relative to `folder`."""
    trace = error.__traceback__
    while (
        trace is not None and trace.tb_next is not None and _is_below(trace.tb_frame.f_code.co_filename, _YAMSIM_FOLDER)
    ):
        trace = trace.tb_next
    whole = "".join(traceback.format_exception(type(error), error, trace))
    return PolicyFault(summarize_exception(error) + _user_code_line(trace, folder), whole)


def summarize_exception(error: BaseException) -> str:
    """Return the type and the message of an exception in one line."""
    try:
        message = str(error)
    # Converting a user's exception to text may raise any exception.
    except Exception:  # noqa: BLE001
        message = "its message cannot be shown"
    message = textwrap.shorten(message, _MAX_CHARACTERS, placeholder=" ...")
    return f"{type(error).__name__}: {message}" if message else type(error).__name__


def _user_code_line(trace: TracebackType | None, folder: Path) -> str:
    frames = [frame for frame in traceback.extract_tb(trace) if not _is_below(frame.filename, _YAMSIM_FOLDER)]
    frames = [frame for frame in frames if not frame.filename.startswith("<")]
    own = [frame for frame in frames if not any(_is_below(frame.filename, place) for place in _INSTALLED_FOLDERS)]
    # A policy may itself be an installed package.
    if not (frames := own or frames):
        return ""
    path = Path(frames[-1].filename)
    shown = path.relative_to(folder) if path.is_relative_to(folder) else path
    return f" ({shown}:{frames[-1].lineno}, in {frames[-1].name})"


def _is_below(file: str, folder: str) -> bool:
    return Path(file).is_relative_to(folder)
