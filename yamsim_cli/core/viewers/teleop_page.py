"""A browser page from which a person drives an arm, or two in turn, and records what they do."""

from __future__ import annotations

import html
import threading
from collections.abc import Callable, Coroutine
from typing import Any

import numpy as np
import viser

from ..errors import counted
from ..geometry.se3 import pose, pose_from_quat, quat_from_rotation, rotation_z
from .address import PageAddress
from .bodies_page import BodiesPage
from .driven import Driven, DriveStatus
from .target_fields import TargetFields, heading_of
from .viewpoint import Viewpoint

_FREE, _STOPPED, _RECORDING = (46, 139, 87), (200, 40, 40), (200, 40, 40)

# How far a key moves the target, m, or turns it about the vertical, rad.
_STEP, _TURN = 0.01, np.radians(5.0)

# Key, description, and how it moves the target: the shift along the world's axes, and the turn about the vertical.
_MOVES = (
    ("I", "Target away from the base", (_STEP, 0, 0), 0.0),
    ("K", "Target towards the base", (-_STEP, 0, 0), 0.0),
    ("J", "Target to the left", (0, _STEP, 0), 0.0),
    ("L", "Target to the right", (0, -_STEP, 0), 0.0),
    ("Y", "Target up", (0, 0, _STEP), 0.0),
    ("H", "Target down", (0, 0, -_STEP), 0.0),
    ("U", "Turn the hand left", (0, 0, 0), _TURN),
    ("O", "Turn the hand right", (0, 0, 0), -_TURN),
)

_KEYS = (
    "Keys: **I K** away and back, **J L** left and right, **Y H** up and down, **U O** turn, "
    "**N** point down, **G** gripper, **R** start or stop, **X** discard"
)


class TeleopPage(BodiesPage):
    """The page of a driven arm: a gizmo for its hand's target, buttons for recording, and what is in the way."""

    def __init__(self, arm: Driven, viewpoint: Viewpoint, address: PageAddress) -> None:
        super().__init__(arm, viewpoint, address)
        self._arm = arm
        self._dragged = False
        # Many actions read the target and set a new one that follows from it, so they run one after the other.
        self._acting = threading.Lock()
        self._notice = self._server.gui.add_html("")
        self._add_recording()
        self._add_hand()
        self._gizmo = self._server.scene.add_transform_controls("/target", scale=0.12, line_width=3.0, depth_test=False)
        self._ball = self._server.scene.add_icosphere("/target/ball", 0.008, color=_FREE)
        self._gizmo.on_update(self._drag)
        self._server.on_client_disconnect(self._left)
        status = arm.status
        magnet, other = "" if status.magnet is None else ", **M** magnet", ", **T** other arm" if status.arm else ""
        self._server.gui.add_markdown(_KEYS + magnet + other)
        for key, name, shift, turn in _MOVES:
            self._add_key(name, key, lambda shift=shift, turn=turn: self._move(shift, turn))  # type: ignore[misc]
        self.update()

    def update(self) -> None:
        """Send what has changed since the last call to all clients."""
        super().update()
        with self._acting:
            if self._fields.ready:
                self._take_typed()
            if not self._dragged:
                self._show_target()
        self._show(self._arm.status)

    def _add_recording(self) -> None:
        icons = viser.Icon
        self._start = self._add_button("Start recording", self._arm.start, icon=icons.PLAYER_RECORD, color=_FREE)
        self._stop = self._add_button("Stop and judge", self._arm.stop, icon=icons.PLAYER_STOP, color=_RECORDING)
        self._discard = self._add_button("Discard", self._arm.discard, icon=icons.TRASH)
        self._add_key("Start or stop recording", "R", self._start_or_stop)
        self._add_key("Discard the recording", "X", self._arm.discard)

    def _add_hand(self) -> None:
        if self._arm.status.arm:
            name = "Drive the other arm"
            self._add_button(name, self._arm.switch_arm, icon=viser.Icon.SWITCH_HORIZONTAL)
            self._add_key(name, "T", self._arm.switch_arm)
        self._gripper = self._add_button("Close gripper", self._arm.toggle_gripper)
        self._magnet: viser.GuiButtonHandle | None = None
        if self._arm.status.magnet is not None:
            self._magnet = self._add_button("Magnet on", self._switch_magnet)
            self._add_key("Magnet on or off", "M", self._switch_magnet)
        self._add_key("Open or close the gripper", "G", self._arm.toggle_gripper)
        self._add_button(
            "Point down", self._point_down, icon=viser.Icon.ARROW_DOWN, hint="The hand upright over the table"
        )
        self._add_key("Point the hand down", "N", self._point_down)
        self._fields = TargetFields(self._server.gui)

    def _add_button(self, label: str, act: Callable[[], None], **looks: Any) -> viser.GuiButtonHandle:
        button = self._server.gui.add_button(label, **looks)
        button.on_click(self._in_turn(act))
        return button

    def _add_key(self, name: str, key: Any, act: Callable[[], None]) -> None:
        self._server.gui.add_command(name, hotkey=key).on_trigger(self._in_turn(act))

    def _in_turn(self, act: Callable[[], None]) -> Callable[[Any], Coroutine[Any, Any, None]]:
        """A callback of a button or a key that runs after everything that was pressed before it."""

        # A coroutine runs in the server's own loop. In threads, two quick keys could overtake each other, or be lost.
        async def act_in_turn(_: Any) -> None:
            with self._acting:
                self._take_typed()
                act()

        return act_in_turn

    def _take_typed(self) -> None:
        if self._fields.typed:
            self._arm.aim(self._fields.take(self._arm.target))

    def _start_or_stop(self) -> None:
        if self._arm.status.recording:
            self._arm.stop()
        else:
            self._arm.start()

    # A coroutine runs in the server's own loop, where a client that comes back is counted first.
    async def _left(self, _: viser.ClientHandle) -> None:
        if not self._server.get_clients():
            self._arm.leave()

    def _switch_magnet(self) -> None:
        self._arm.set_magnet(not self._arm.status.magnet)

    def _move(self, shift: tuple[float, float, float], turn: float) -> None:
        target = self._arm.target
        self._arm.aim(pose(target[:3, 3] + shift, rotation_z(turn) @ target[:3, :3]))

    def _point_down(self) -> None:
        target = self._arm.target
        y = rotation_z(heading_of(target))[:, 0]
        down = np.array([0.0, 0.0, -1.0])
        self._arm.aim(pose(target[:3, 3], np.column_stack([np.cross(y, down), y, down])))

    # A coroutine runs in the server's own loop, so that a drag's steps stay in order.
    async def _drag(self, event: viser.TransformControlsEvent) -> None:
        with self._acting:
            self._take_typed()
            self._dragged = event.phase != "end"
            self._arm.aim(pose_from_quat(event.target.position, event.target.wxyz))

    def _show_target(self) -> None:
        target = self._arm.target
        self._gizmo.position, self._gizmo.wxyz = target[:3, 3], quat_from_rotation(target[:3, :3])
        self._fields.show(target)

    def _show(self, status: DriveStatus) -> None:
        self._ball.color = _FREE if status.free else _STOPPED
        self._notice.content = _notice(status)
        self._start.disabled = status.recording
        self._stop.disabled = self._discard.disabled = not status.recording
        self._gripper.label = "Close gripper" if status.gripper_open else "Open gripper"
        if self._magnet is not None:
            self._magnet.label = "Magnet off" if status.magnet else "Magnet on"
        whose = f"{status.arm} arm, " if status.arm else ""
        state = f"**recording {status.seconds:.1f} s**" if status.recording else "not recording"
        if self._arm.paused:
            state += ", paused"
        waiting = f", {status.waiting} being judged and rendered" if status.waiting else ""
        done = f"{counted(status.episodes, 'episode')}, {status.failures} failed{waiting}"
        told = "  \n".join(filter(None, (status.prompt and f"**{status.prompt}**", status.goal)))
        self._status.content = f"{told}\n\n" * bool(told) + f"{whose}{state}  \n{done}  \n{status.message}"


def _notice(status: DriveStatus) -> str:
    """HTML on what keeps the hand from its target, in red; or that it follows, in green."""
    reasons = []
    if status.blocked:
        reasons.append(f"{status.blocked} is in the way")
    if status.apart:
        reasons.append(f"the target is {status.apart * 100:.1f} cm out of reach")
    if status.at_limit:
        reasons.append(f"{', '.join(status.at_limit)} at its stop")
    held = ", and holds the object" if status.holds else ""
    text = "; ".join(reasons) or f"the hand follows{held}"
    red, green, blue = _STOPPED if reasons else _FREE
    style = f"color: rgb({red}, {green}, {blue}); padding: 0 1em 0.5em; font-size: 0.9em"
    return f'<div style="{style}">{html.escape(text)}</div>'
