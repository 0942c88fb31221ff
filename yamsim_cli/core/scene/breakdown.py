"""Physics that breaks down. MuJoCo would write of it to the terminal and into a file in the working directory, and go
on from a reset; here it is asked for, and told as why an attempt failed.
"""

from __future__ import annotations

import mujoco

# After these MuJoCo resets the state, or lets go of the drives: what follows is no simulation of the attempt.
_FATAL = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
    mujoco.mjtWarning.mjWARN_BADCTRL,
)


def keep_warnings_quiet() -> None:
    """Let MuJoCo's warnings reach neither the terminal nor a MUJOCO_LOG.TXT in this process, unless a program that uses
    this one hears them already. Every simulation counts its own, see `breakdown`.
    """
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(lambda text: None)


def breakdown(data: mujoco.MjData) -> str | None:
    """What broke a simulation since its reset, in MuJoCo's words; None if nothing did."""
    for kind in _FATAL:
        counted = data.warning[int(kind)]
        if counted.number:
            text: str = mujoco.mju_warningText(kind, counted.lastinfo)
            return text.split(".")[0]
    return None
