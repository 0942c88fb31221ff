"""Writes the page on a gap: its figures, and every joint of the recording that is worst over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..report.gap_page import CaptionedJpeg, JointCurves, gap_page
from ..report.markup import made_line, write_page
from ..sim.follow import held
from .figures import Gap


def write_gap_page(
    report: Mapping[str, Any], gaps: Sequence[Gap], pictures: Sequence[CaptionedJpeg], path: Path
) -> None:
    """Write the page, replacing what is there.

    Args:
        report: of `tally.report_of`.
        gaps: that the report is of.
        pictures: for the page, the worst first.

    Raises:
        ResourceError: the file cannot be written.
    """
    worst = max(gaps, key=lambda gap: abs(gap.worst.error))
    write_page(gap_page(report, joint_curves(worst), pictures, made_line()), path)


def joint_curves(gap: Gap) -> list[JointCurves]:
    """Each joint of a recording over the time that was compared."""
    found = []
    compared = np.flatnonzero(gap.counted)
    shown = slice(int(compared[0]), int(compared[-1]) + 1)
    names = iter(gap.joints)
    for real, made in zip(gap.motion.arms, gap.simulated.arms, strict=True):
        assert real.commands is not None, "it was followed"
        commands = held(real.commands, real.joints)
        for k in range(real.joints.shape[1]):
            joint = next(names)
            marked = (joint.arm, joint.name) == (gap.worst.arm, gap.worst.joint)
            found.append(
                JointCurves(
                    f"{joint.arm} {joint.name}".strip(),
                    gap.motion.times[shown],
                    commands[shown, k],
                    np.where(gap.counted, real.joints[:, k], np.nan)[shown],
                    np.where(gap.counted, made.joints[:, k], np.nan)[shown],
                    gap.worst.time if marked else None,
                )
            )
    return found
