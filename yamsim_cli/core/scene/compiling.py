"""Compiling what was composed; what MuJoCo refuses is told in one line."""

from __future__ import annotations

import mujoco

from ..errors import SimulationError, YamsimError
from .breakdown import keep_warnings_quiet


def compile_spec(spec: mujoco.MjSpec, called: str = "", refused: type[YamsimError] = SimulationError) -> mujoco.MjModel:
    """Compile a scene, or a thing alone.

    Args:
        called: what it is, for the message; the scene by its name unless given.
        refused: the error if MuJoCo refuses it.

    Raises:
        SimulationError: MuJoCo refused it; or `refused`, if that is given.
    """
    keep_warnings_quiet()
    try:
        return spec.compile()
    except ValueError as error:
        called = called or f"scene {spec.modelname!r}"
        raise refused(f"{called} does not compile: {' '.join(str(error).split())}") from error
