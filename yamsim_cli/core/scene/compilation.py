"""Compiling scenes, and detecting physics that breaks down.

MuJoCo alone would write warnings to the terminal and to MUJOCO_LOG.TXT, and continue from a reset state.
"""

from __future__ import annotations

import mujoco

from ..errors import SimulationError, YamsimError

# Warnings after which MuJoCo resets the state or ignores the drives: the attempt is no longer simulated.
_FATAL = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
    mujoco.mjtWarning.mjWARN_BADCTRL,
)


def compile_spec(spec: mujoco.MjSpec, called: str = "", refused: type[YamsimError] = SimulationError) -> mujoco.MjModel:
    """Compile a spec.

    Args:
        called: the subject of the error message; by default the scene by its name.
        refused: type of the error that is raised if MuJoCo refuses the spec.
    """
    keep_warnings_quiet()
    try:
        return spec.compile()
    except ValueError as error:
        called = called or f"scene {spec.modelname!r}"
        raise refused(f"{called} does not compile: {' '.join(str(error).split())}") from error


def keep_warnings_quiet() -> None:
    """Silence MuJoCo's warnings in this process, unless the calling program has set a handler; see `breakdown`."""
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(lambda text: None)


def physics_failure(data: mujoco.MjData) -> str | None:
    """MuJoCo's text on the fatal warning of a simulation since its reset; None without one."""
    for kind in _FATAL:
        counted = data.warning[int(kind)]
        if counted.number:
            text: str = mujoco.mju_warningText(kind, counted.lastinfo)
            return text.split(".")[0]
    return None
