"""Detects physics that breaks down, so that the attempt fails with this cause.

MuJoCo alone would write a warning to the terminal and to a file in the working directory, and go on from a reset.
"""

from __future__ import annotations

import mujoco

# After these warnings MuJoCo resets the state or ignores the drives: what follows is no simulation of the attempt.
_FATAL = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
    mujoco.mjtWarning.mjWARN_BADCTRL,
)


def keep_warnings_quiet() -> None:
    """Keep MuJoCo's warnings in this process from the terminal and from MUJOCO_LOG.TXT.

    A handler that the calling program has set stays. Every simulation counts its own warnings, see `breakdown`.
    """
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(lambda text: None)


def breakdown(data: mujoco.MjData) -> str | None:
    """MuJoCo's text on what broke a simulation since its reset; None if nothing did."""
    for kind in _FATAL:
        counted = data.warning[int(kind)]
        if counted.number:
            text: str = mujoco.mju_warningText(kind, counted.lastinfo)
            return text.split(".")[0]
    return None
