"""How time passes, changed so that frames come at a rate that somebody asks for."""

from __future__ import annotations

from .program_task import ProgramTiming

_TICK_CHANGE = 0.07  # share by which a control tick may become longer or shorter; skills count some waits in ticks


def at_rate(timing: ProgramTiming, fps: float) -> dict[str, float | int]:
    """What of a timing is otherwise with so many frames a second: as many ticks a frame as fit best, a little longer or
    shorter.

    Returns:
        `timestep` (s) and `ticks_per_frame`.

    Raises:
        ValueError: whole ticks of about this length do not make that rate.
    """
    ticks = max(1, round(1 / (fps * timing.tick)))
    tick = 1 / (fps * ticks)
    if abs(tick / timing.tick - 1) > _TICK_CHANGE:
        low, high = (1 / (timing.tick * (1 + sign * _TICK_CHANGE)) for sign in (1, -1))
        valid = ", ".join(f"{low / n:.1f} to {high / n:.1f}" for n in (1, 2, 3, 4))
        raise ValueError(
            f"{fps:g} frames a second are no whole number of control ticks of about {timing.tick * 1000:.0f} ms; "
            f"valid: {valid}, and so on"
        )
    return {"timestep": tick / timing.physics_steps_per_tick, "ticks_per_frame": ticks}
