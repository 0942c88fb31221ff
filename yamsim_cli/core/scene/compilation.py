"""Compilation of scenes, and detection of physics failures.

By default, MuJoCo writes warnings to the terminal and to MUJOCO_LOG.TXT, and continues from a reset state.
"""

from __future__ import annotations

import mujoco

from ..errors import SimulationError, YamsimError

# After these warnings, MuJoCo resets the state or ignores the drives, so the simulation is no longer valid.
_FATAL_WARNINGS = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
    mujoco.mjtWarning.mjWARN_BADCTRL,
)


def compile_spec(spec: mujoco.MjSpec, called: str = "", refused: type[YamsimError] = SimulationError) -> mujoco.MjModel:
    """Compile a spec, or raise an error of type `refused` with MuJoCo's reason about `called`, by default the scene."""
    silence_mujoco_warnings()
    try:
        return spec.compile()
    except ValueError as error:
        called = called or f"scene {spec.modelname!r}"
        raise refused(f"{called} does not compile: {' '.join(str(error).split())}") from error


def silence_mujoco_warnings() -> None:
    """Silence MuJoCo's warnings in this process, unless a handler is set. `physics_failure` reports fatal ones."""
    if mujoco.get_mju_user_warning() is None:
        mujoco.set_mju_user_warning(lambda text: None)


def physics_failure(data: mujoco.MjData) -> str | None:
    """Return MuJoCo's fatal warning since the last reset of `data`; None without one."""
    for kind in _FATAL_WARNINGS:
        counted = data.warning[int(kind)]
        if counted.number:
            text: str = mujoco.mju_warningText(kind, counted.lastinfo)
            return text.split(".")[0]
    return None
