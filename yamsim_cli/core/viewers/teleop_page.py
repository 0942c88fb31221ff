"""A browser page from which a person drives an arm and records what it does."""

from __future__ import annotations

import html
from collections.abc import Callable
from typing import Any

import numpy as np
import viser

from ..geometry.se3 import Array, pose, pose_from_quat, quat_from_rotation, rotation_z
from .address import PageAddress
from .bodies_page import BodiesPage
from .driven import Driven, DriveStatus
from .viewpoint import Viewpoint

_FREE, _STOPPED, _RECORDING = (46, 139, 87), (200, 40, 40), (200, 40, 40)

# What a key moves the target by: m, and rad about the vertical.
_STEP, _TURN = 0.01, np.radians(5.0)

# Key, what it does, and how it moves the target: along the world's axes, and about the vertical.
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
    "**N** point down, **G** gripper, **M** magnet, **R** start or stop, **X** discard"
)


class TeleopPage(BodiesPage):
    """The page of one driven arm: a gizmo for its hand's target, the recording's buttons, what is in the way."""

    def __init__(self, arm: Driven, viewpoint: Viewpoint, address: PageAddress) -> None:
        super().__init__(arm, viewpoint, address)
        self._arm = arm
        self._dragged = False
        self._notice = self._server.gui.add_html("")
        self._add_recording()
        self._add_hand()
        self._gizmo = self._server.scene.add_transform_controls("/target", scale=0.12, line_width=3.0, depth_test=False)
        self._ball = self._server.scene.add_icosphere("/target/ball", 0.008, color=_FREE)
        self._gizmo.on_update(self._drag)
        self._server.gui.add_markdown(_KEYS)
        for key, name, shift, turn in _MOVES:
            self._add_key(name, key, lambda shift=shift, turn=turn: self._move(shift, turn))  # type: ignore[misc]
        self.update()

    def update(self) -> None:
        """Send what has changed since the last call to whoever watches."""
        super().update()
        status = self._arm.status
        if not self._dragged:
            self._show_target()
        self._show(status)

    def _add_recording(self) -> None:
        gui = self._server.gui
        self._start = gui.add_button("Start recording", icon=viser.Icon.PLAYER_RECORD, color=_FREE)
        self._start.on_click(lambda _: self._arm.start())
        self._stop = gui.add_button("Stop and judge", icon=viser.Icon.PLAYER_STOP, color=_RECORDING)
        self._stop.on_click(lambda _: self._arm.stop())
        self._discard = gui.add_button("Discard", icon=viser.Icon.TRASH)
        self._discard.on_click(lambda _: self._arm.discard())
        self._add_key("Start or stop recording", "R", self._start_or_stop)
        self._add_key("Discard the recording", "X", self._arm.discard)

    def _add_hand(self) -> None:
        gui = self._server.gui
        self._gripper = gui.add_button("Close gripper")
        self._gripper.on_click(lambda _: self._arm.toggle_gripper())
        self._magnet = gui.add_button("Magnet on")
        self._magnet.on_click(lambda _: self._switch_magnet())
        self._add_key("Open or close the gripper", "G", self._arm.toggle_gripper)
        self._add_key("Magnet on or off", "M", self._switch_magnet)
        down = gui.add_button("Point down", icon=viser.Icon.ARROW_DOWN, hint="The hand upright over the table")
        down.on_click(lambda _: self._point_down())
        self._add_key("Point the hand down", "N", self._point_down)
        self.place = gui.add_vector3("target (m)", (0.0, 0.0, 0.0), step=0.001)
        self.place.on_update(self._type_place)
        self.heading = gui.add_number("heading (deg)", 0.0, min=-180.0, max=180.0, step=0.1)
        self.heading.on_update(self._type_heading)

    def _add_key(self, name: str, key: Any, act: Callable[[], None]) -> None:
        self._server.gui.add_command(name, hotkey=key).on_trigger(lambda _: act())

    def _start_or_stop(self) -> None:
        if self._arm.status.recording:
            self._arm.stop()
        else:
            self._arm.start()

    def _switch_magnet(self) -> None:
        self._arm.set_magnet(not self._arm.status.magnet)

    def _move(self, shift: tuple[float, float, float], turn: float) -> None:
        target = self._arm.target
        self._arm.aim(pose(target[:3, 3] + shift, rotation_z(turn) @ target[:3, :3]))

    def _point_down(self) -> None:
        target = self._arm.target
        y = rotation_z(_heading(target))[:, 0]
        down = np.array([0.0, 0.0, -1.0])
        self._arm.aim(pose(target[:3, 3], np.column_stack([np.cross(y, down), y, down])))

    # In the server's own loop, so that a drag's steps stay in order.
    async def _drag(self, event: viser.TransformControlsEvent) -> None:
        self._dragged = event.phase != "end"
        self._arm.aim(pose_from_quat(event.target.position, event.target.wxyz))

    def _type_place(self, event: Any) -> None:
        # Moved by nobody's hand, the numbers only say where the target is.
        if event.client is not None:
            self._arm.aim(pose(self.place.value, self._arm.target[:3, :3]))

    def _type_heading(self, event: Any) -> None:
        if event.client is not None:
            target = self._arm.target
            turn = rotation_z(np.radians(self.heading.value) - _heading(target))
            self._arm.aim(pose(target[:3, 3], turn @ target[:3, :3]))

    def _show_target(self) -> None:
        target = self._arm.target
        self._gizmo.position, self._gizmo.wxyz = target[:3, 3], quat_from_rotation(target[:3, :3])
        x, y, z = (round(float(part), 3) for part in target[:3, 3])
        # viser's setters take more types than their getters give, which mypy has no words for.
        self.place.value = (x, y, z)  # type: ignore[misc]
        self.heading.value = round(float(np.degrees(_heading(target))), 1)  # type: ignore[misc]

    def _show(self, status: DriveStatus) -> None:
        self._ball.color = _FREE if status.free else _STOPPED
        self._notice.content = _notice(status)
        self._start.disabled = status.recording
        self._stop.disabled = self._discard.disabled = not status.recording
        self._gripper.label = "Close gripper" if status.gripper_open else "Open gripper"
        self._magnet.label = "Magnet off" if status.magnet else "Magnet on"
        state = f"**recording {status.seconds:.1f} s**" if status.recording else "not recording"
        if self._arm.paused:
            state += ", paused"
        waiting = f", {status.waiting} being judged and drawn" if status.waiting else ""
        self._status.content = (
            f"{state}  \n{status.episodes} episodes, {status.failures} failed{waiting}  \n{status.message}"
        )


def _heading(T: Array) -> float:
    """The direction of the hand's y axis, along which the fingers close, in the world's xy plane, rad."""
    return float(np.arctan2(T[1, 1], T[0, 1]))


def _notice(status: DriveStatus) -> str:
    """What keeps the hand from where it is told to be, in red; else, in green, that it follows."""
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
