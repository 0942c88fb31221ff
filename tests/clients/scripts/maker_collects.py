"""The maker's GUI, which notes when a row of its recording was read and commanded: for `tools.bench.collection`.

`maker_collects.py CHECKOUT TIMES.npz ARGUMENTS...`; its `EpisodeRecorder` and `YamRobot` work as before.
"""

from __future__ import annotations

import functools
import sys
import time
from typing import Any

import numpy as np


def main(checkout: str, out: str, *arguments: str) -> None:
    sys.path.insert(0, checkout)
    from yam_abc_reproduce import cli
    from yam_abc_reproduce.data.recorder import EpisodeRecorder
    from yam_abc_reproduce.robot.yam_adapter import YamRobot

    read_s: dict[int, float] = {}  # id of an arm -> when the SDK read its last state
    told_s: dict[int, float] = {}  # id of an arm -> when it was commanded
    rows: list[tuple[float, list[float], list[float]]] = []

    def after(owner: type, name: str, note: Any) -> None:
        original = getattr(owner, name)

        @functools.wraps(original)
        def noted(self: Any, *given: Any, **named: Any) -> Any:
            found = original(self, *given, **named)
            note(self)
            return found

        setattr(owner, name, noted)

    def note_row(recorder: Any) -> None:
        if recorder.is_recording and len(read_s) == len(told_s) == 2:
            rows.append((time.time(), list(read_s.values()), list(told_s.values())))

    # The SDK's states have a time; a command is sent in the next cycle of the SDK's own loop.
    after(YamRobot, "get_observations", lambda arm: read_s.update({id(arm): arm._robot._joint_state.timestamp}))
    after(YamRobot, "command_joint_pos", lambda arm: told_s.update({id(arm): time.time()}))
    after(EpisodeRecorder, "tick", note_row)
    stop = EpisodeRecorder.stop

    def stop_and_write(recorder: Any) -> Any:
        began = time.time()
        folder = stop(recorder)
        saving = time.time() - began
        recorded, read, told = zip(*rows, strict=True)
        np.savez(out, rows=np.array(recorded), read=np.array(read), told=np.array(told), saving=saving)
        return folder

    EpisodeRecorder.stop = stop_and_write
    cli.gui([*arguments])


if __name__ == "__main__":
    main(*sys.argv[1:])
