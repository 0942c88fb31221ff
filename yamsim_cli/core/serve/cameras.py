"""Pictures for programs that read cameras: a Unix socket, on which each message is its length, JSON, and raw bytes.

`yamsim_cli.camera_reader` is the other side. A program asks for `cameras`, or for the `picture` of one after a number,
and is answered when there is a newer one.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from .connections import Program, Server
from .pictures import PictureProcess, Shot
from .places import CAMERA_SOCKET
from .sockets import listen_in

# Of what a program says, bytes.
_LARGEST = 4096
_READ_BYTES = 4096


class _WrongError(ValueError):
    """What a program said is no message; the text says what is wrong."""


class CameraServer(Server):
    """Hands out what a scene's cameras see; close it. It never blocks.

    Raises:
        ResourceError: somebody else serves cameras in that folder, or the socket cannot be made.
    """

    def __init__(self, folder: Path, source: PictureProcess) -> None:
        self._source = source
        self.path = folder / CAMERA_SOCKET
        super().__init__(listen_in(self.path), _READ_BYTES)
        # Program -> camera, and the number after which it waits for a picture.
        self._waiting: dict[Program, tuple[str, int]] = {}

    def handle(self, ready: set[Any]) -> None:
        """Take what programs ask for."""
        for program in self._connections.heard(ready):
            self._serve(program)

    def flush(self) -> None:
        """Give those their picture for whom there is a newer one, and send what waits."""
        programs = self._connections.programs
        self._waiting = {program: asked for program, asked in self._waiting.items() if program in programs}
        shot = self._source.shot
        for program, (camera, after) in list(self._waiting.items()):
            if shot is not None and shot.number > after:
                del self._waiting[program]
                self._give(program, camera, shot)
        self._connections.flush()
        for program in programs:
            if program.came and not program.waits:
                self._serve(program)

    def close(self) -> None:
        """Leave nothing behind."""
        super().close()
        self.path.unlink(missing_ok=True)

    def _serve(self, program: Program) -> None:
        try:
            # One thing after the other: nothing piles up for a program that asks faster than it reads.
            while not program.waits and program not in self._waiting and (asked := _next_message(program)) is not None:
                self._answer(program, asked)
                self._connections.flush(program)
        except _WrongError:
            self._connections.drop(program)
            return
        if len(program.came) > _LARGEST + 4:
            self._connections.drop(program)

    def _answer(self, program: Program, asked: dict[str, Any]) -> None:
        source = self._source
        kind, camera, after = asked.get("ask"), asked.get("camera"), asked.get("after", -1)
        if kind == "cameras":
            width, height = source.size
            one = {"width": width, "height": height, "fps": source.fps}
            told = {name: {**one, "K": source.K[name].ravel().tolist()} for name in source.cameras}
            _say(program, {"cameras": told})
        elif kind != "picture" or type(after) is not int:
            _say(program, {"error": "ask for cameras, or for a picture with its camera and the number after"})
        elif camera not in source.cameras:
            _say(program, {"error": f"there is no camera {camera!r:.80}; there are: {', '.join(source.cameras)}"})
        else:
            self._waiting[program] = str(camera), after

    def _give(self, program: Program, camera: str, shot: Shot) -> None:
        picture = shot.pictures[camera]
        height, width, _ = picture.shape
        known = {"camera": camera, "number": shot.number, "time_ns": shot.time_ns, "sim_time": shot.sim_time}
        pose = shot.T_cam_in_base[camera].ravel().tolist()
        _say(program, {**known, "width": width, "height": height, "T_cam_in_base": pose}, picture.tobytes())


def _say(program: Program, told: dict[str, Any], data: bytes = b"") -> None:
    head = json.dumps({**told, "bytes": len(data)}).encode()
    program.waits += len(head).to_bytes(4, "little") + head + data


def _next_message(program: Program) -> dict[str, Any] | None:
    """The next whole message, taken from what has come; None until it has.

    Raises:
        _WrongError: what came is none.
    """
    came = program.came
    if len(came) < 4:
        return None
    length = int.from_bytes(came[:4], "little")
    if not 2 <= length <= _LARGEST:
        raise _WrongError(f"a message of {length} bytes")
    if len(came) < 4 + length:
        return None
    try:
        asked = json.loads(bytes(came[4 : 4 + length]))
    # Too many brackets are a RecursionError.
    except (ValueError, RecursionError) as error:
        raise _WrongError("a message that is not JSON") from error
    if not isinstance(asked, dict):
        raise _WrongError("a message that is no object")
    del came[: 4 + length]
    return asked
