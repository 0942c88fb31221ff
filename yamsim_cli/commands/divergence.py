"""What differs between a recorded episode and the same made again, in words."""

from __future__ import annotations

from typing import Any

# Another kind of processor rounds the last bit of a sine or a sum differently, and contacts amplify that. On an
# emulated processor the difference came to 1.5e-4 in most of 40 episodes, and to 1.4e-3 (the tilt of a rolling banana)
# in the worst.
_ROUNDING = 0.005

# Check -> how the episode was made again.
WAYS = {"seed": "made again from its seed", "actions": "from its actions", "images": "rendered again"}


def sentence(divergence: dict[str, Any]) -> str:
    """One divergence of a report: where it is, and both values."""
    frame, time_s = divergence["frame"], divergence["time_s"]
    place = f"ep_{divergence['episode']:06d}"
    if frame is not None:
        place += f" frame {frame}" + (f" ({time_s:.3f} s)" if time_s is not None else "")
    stored, got = (f"{v:.9g}" if isinstance(v, float) else v for v in (divergence["stored"], divergence["got"]))
    apart = divergence["difference"]
    by = "" if apart is None else f", {apart:.3g} apart"
    return f"{place}: {divergence['quantity']} is stored as {stored} and is {got} {WAYS[divergence['check']]}{by}"


def trouble(problem: dict[str, Any]) -> str:
    """One problem of a report: the file, and what is wrong with it."""
    place = f"ep_{problem['episode']:06d}/{problem['file']}: " if problem["file"] else ""
    return f"{place}{problem['problem']}"


def verdict(report: dict[str, Any]) -> str:
    """The one line on what was found first."""
    first = report["first_divergence"]
    text = sentence(first) if first else trouble(report["problems"][0])
    differing = report["episodes"] - report["agree"]
    more = f" (and {differing - 1} more episodes)" if differing > 1 else ""
    changes = ", ".join(f"{c['name']} {c['recorded']} (now {c['now']})" for c in report["versions_changed"])
    since = f"; recorded with {changes}" if changes else ""
    return f"{report['path']}: {text}{more}{since}{_hint(report)}"


def _hint(report: dict[str, Any]) -> str:
    """What to do where rounding alone may be the reason."""
    unequal = any(divergence["difference"] is None for divergence in report["divergences"])
    if unequal or report["problems"] or not report["tolerance"] < report["max_error"] <= _ROUNDING:
        return ""
    return f"; if it was recorded on another kind of processor, rounding does that: --tolerance {_ROUNDING:g}"
