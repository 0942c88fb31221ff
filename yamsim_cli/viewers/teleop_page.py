from __future__ import annotations

import html
import threading
import time
from collections.abc import Callable, Coroutine
from typing import Any

import numpy as np
import viser

from ..core.errors import count_noun
from ..core.geometry.se3 import Array, pose, pose_from_quat, quat_from_rotation, rotation_z
from .page_address import PageAddress
from .scene_page import ScenePage
from .teleop.teleop_scene import TeleopScene, TeleopStatus
from .viewpoint import Viewpoint

_GREEN, _RED = (46, 139, 87), (200, 40, 40)  # RGB, 0 to 255
_STEP = 0.01  # m, by one key press
_TURN_STEP = np.radians(5.0)  # rad, about the vertical, by one key press
_TYPING_PAUSE = 1.0  # s after the last key press; typing 0.15 must not move the target to 0

# Key, description, translation of the target in `world` (m), and rotation about the vertical (rad).
_KEY_MOVES = (
    ("I", "Target away from the base", (_STEP, 0, 0), 0.0),
    ("K", "Target towards the base", (-_STEP, 0, 0), 0.0),
    ("J", "Target to the left", (0, _STEP, 0), 0.0),
    ("L", "Target to the right", (0, -_STEP, 0), 0.0),
    ("Y", "Target up", (0, 0, _STEP), 0.0),
    ("H", "Target down", (0, 0, -_STEP), 0.0),
    ("U", "Turn the hand left", (0, 0, 0), _TURN_STEP),
    ("O", "Turn the hand right", (0, 0, 0), -_TURN_STEP),
)

_KEYS_HELP = (
    "Keys: **I K** away and back, **J L** left and right, **Y H** up and down, **U O** turn, "
    "**N** point down, **G** gripper, **R** start or stop, **X** discard"
)


class TeleopPage(ScenePage):
    """Page to teleoperate an arm: a 3D handle for the target, recording buttons, and notices of obstacles."""

    def __init__(self, arm: TeleopScene, viewpoint: Viewpoint, address: PageAddress) -> None:
        super().__init__(arm, viewpoint, address)
        self._arm = arm
        self._dragged = False
        # Most actions compute a new target from the current one, so actions must not run concurrently.
        self._acting = threading.Lock()
        self._notice = self._server.gui.add_html("")
        self._add_recording()
        self._add_hand()
        self._gizmo = self._server.scene.add_transform_controls("/target", scale=0.12, line_width=3.0, depth_test=False)
        self._ball = self._server.scene.add_icosphere("/target/ball", 0.008, color=_GREEN)
        self._gizmo.on_update(self._drag)
        self._server.on_client_disconnect(self._disconnect)
        status = arm.status
        magnet, other = "" if status.magnet is None else ", **M** magnet", ", **T** other arm" if status.arm else ""
        self._server.gui.add_markdown(_KEYS_HELP + magnet + other)
        for key, name, shift, turn in _KEY_MOVES:
            self._add_key(name, key, lambda shift=shift, turn=turn: self._move_target(shift, turn))  # type: ignore[misc]
        self.update()

    def update(self) -> None:
        """Send changes of scene, target and status to all browsers."""
        super().update()
        with self._acting:
            if self._fields.is_typing_done:
                self._apply_typed_target()
            if not self._dragged:
                self._show_target()
        self._show_status(self._arm.status)

    def _add_recording(self) -> None:
        icons = viser.Icon
        self._start = self._add_button(
            "Start recording", self._arm.start_recording, icon=icons.PLAYER_RECORD, color=_GREEN
        )
        self._stop = self._add_button("Stop and judge", self._arm.stop_recording, icon=icons.PLAYER_STOP, color=_RED)
        self._discard = self._add_button("Discard", self._arm.discard_recording, icon=icons.TRASH)
        self._add_key("Start or stop recording", "R", self._start_or_stop)
        self._add_key("Discard the recording", "X", self._arm.discard_recording)

    def _add_hand(self) -> None:
        if self._arm.status.arm:
            name = "Drive the other arm"
            self._add_button(name, self._arm.switch_arm, icon=viser.Icon.SWITCH_HORIZONTAL)
            self._add_key(name, "T", self._arm.switch_arm)
        self._gripper = self._add_button("Close gripper", self._arm.toggle_gripper)
        self._weld_button: viser.GuiButtonHandle | None = None
        if self._arm.status.magnet is not None:
            self._weld_button = self._add_button("Magnet on", self._toggle_weld)
            self._add_key("Magnet on or off", "M", self._toggle_weld)
        self._add_key("Open or close the gripper", "G", self._arm.toggle_gripper)
        self._add_button(
            "Point down", self._point_down, icon=viser.Icon.ARROW_DOWN, hint="Point the hand down at the table"
        )
        self._add_key("Point the hand down", "N", self._point_down)
        self._fields = TargetFields(self._server.gui)

    def _add_button(self, label: str, act: Callable[[], None], **looks: Any) -> viser.GuiButtonHandle:
        button = self._server.gui.add_button(label, **looks)
        button.on_click(self._queued_callback(act))
        return button

    def _add_key(self, name: str, key: Any, act: Callable[[], None]) -> None:
        self._server.gui.add_command(name, hotkey=key).on_trigger(self._queued_callback(act))

    def _queued_callback(self, act: Callable[[], None]) -> Callable[[Any], Coroutine[Any, Any, None]]:
        """Return a callback for a button or a key. Callbacks run in the order of the presses."""

        # A coroutine runs in the server's loop. In threads, quick key presses could change their order or get lost.
        async def act_queued(_: Any) -> None:
            with self._acting:
                self._apply_typed_target()
                act()

        return act_queued

    def _apply_typed_target(self) -> None:
        if self._fields.has_typed_numbers:
            self._arm.set_target_pose(self._fields.apply_typed(self._arm.target_pose))

    def _start_or_stop(self) -> None:
        if self._arm.status.recording:
            self._arm.stop_recording()
        else:
            self._arm.start_recording()

    # A coroutine runs in the server's loop, where a client that reconnects is counted first.
    async def _disconnect(self, _: viser.ClientHandle) -> None:
        if not self._server.get_clients():
            self._arm.pause_unattended()

    def _toggle_weld(self) -> None:
        self._arm.set_weld(not self._arm.status.magnet)

    def _move_target(self, shift: tuple[float, float, float], turn: float) -> None:
        target = self._arm.target_pose
        self._arm.set_target_pose(pose(target[:3, 3] + shift, rotation_z(turn) @ target[:3, :3]))

    def _point_down(self) -> None:
        target = self._arm.target_pose
        y = rotation_z(hand_heading(target))[:, 0]
        down = np.array([0.0, 0.0, -1.0])
        self._arm.set_target_pose(pose(target[:3, 3], np.column_stack([np.cross(y, down), y, down])))

    # A coroutine runs in the server's loop, so that the steps of a drag stay in order.
    async def _drag(self, event: viser.TransformControlsEvent) -> None:
        with self._acting:
            self._apply_typed_target()
            self._dragged = event.phase != "end"
            self._arm.set_target_pose(pose_from_quat(event.target.position, event.target.wxyz))

    def _show_target(self) -> None:
        target = self._arm.target_pose
        self._gizmo.position, self._gizmo.wxyz = target[:3, 3], quat_from_rotation(target[:3, :3])
        self._fields.show(target)

    def _show_status(self, status: TeleopStatus) -> None:
        self._ball.color = _GREEN if status.can_follow else _RED
        self._notice.content = _reach_notice(status)
        self._start.disabled = status.recording
        self._stop.disabled = self._discard.disabled = not status.recording
        self._gripper.label = "Close gripper" if status.gripper_open else "Open gripper"
        if self._weld_button is not None:
            self._weld_button.label = "Magnet off" if status.magnet else "Magnet on"
        whose = f"{status.arm} arm, " if status.arm else ""
        state = f"**recording {status.seconds:.1f} s**" if status.recording else "not recording"
        if self._arm.paused:
            state += ", paused"
        waiting = f", {status.waiting} being judged and rendered" if status.waiting else ""
        done = f"{count_noun(status.episodes, 'episode')}, {status.failures} failed{waiting}"
        task = "  \n".join(filter(None, (status.prompt and f"**{status.prompt}**", status.goal)))
        self._status.content = f"{task}\n\n" * bool(task) + f"{whose}{state}  \n{done}  \n{status.message}"


def _reach_notice(status: TeleopStatus) -> str:
    """Return HTML: in red why the hand cannot reach its target, or in green that the hand follows."""
    reasons = []
    if status.obstacle:
        reasons.append(f"{status.obstacle} is in the way")
    if status.target_distance:
        reasons.append(f"the target is {status.target_distance * 100:.1f} cm out of reach")
    if status.at_limit:
        reasons.append(f"{', '.join(status.at_limit)} at its joint limit")
    held = ", and holds the object" if status.is_weld_holding else ""
    text = "; ".join(reasons) or f"the hand follows{held}"
    red, green, blue = _RED if reasons else _GREEN
    style = f"color: rgb({red}, {green}, {blue}); padding: 0 1em 0.5em; font-size: 0.9em"
    return f'<div style="{style}">{html.escape(text)}</div>'


class TargetFields:
    """Input fields for position and heading of the hand's target.

    The fields follow the target until a user types, and then keep the typed numbers until `apply_typed`. Only `_type`
    runs in the server's thread.
    """

    def __init__(self, gui: viser.GuiApi) -> None:
        self._place = gui.add_vector3("target (m)", (0.0, 0.0, 0.0), step=0.001)
        self._heading = gui.add_number("heading (deg)", 0.0, min=-180.0, max=180.0, step=0.1)
        self._shown: tuple[tuple[float, ...], float] = ((0.0, 0.0, 0.0), 0.0)
        # Time of the last key press by `time.monotonic`, s; None without typed numbers.
        self._typed_at: float | None = None
        # Coroutines run in the server's loop, so that typing is registered before any later action.
        self._place.on_update(self._type)
        self._heading.on_update(self._type)

    @property
    def has_typed_numbers(self) -> bool:
        """Whether `apply_typed` has typed numbers to apply."""
        return self._typed_at is not None

    @property
    def is_typing_done(self) -> bool:
        """Whether `apply_typed` has typed numbers to apply, and the user has stopped typing."""
        typed_at = self._typed_at
        return typed_at is not None and time.monotonic() - typed_at >= _TYPING_PAUSE

    def apply_typed(self, target: Array) -> Array:
        """Return the pose (4, 4) in `world` with position and heading replaced by the typed numbers."""
        self._typed_at = None
        (x, y, z), heading = self._place.value, self._heading.value
        (shown_place, shown_heading), T = self._shown, target.copy()
        # Unchanged numbers keep the full precision of the target.
        for axis, (number, shown) in enumerate(zip((x, y, z), shown_place, strict=True)):
            if number != shown:
                T[axis, 3] = number
        if heading != shown_heading:
            T[:3, :3] = rotation_z(np.radians(heading) - hand_heading(target)) @ target[:3, :3]
        self._shown = ((x, y, z), heading)
        return T

    def show(self, target: Array) -> None:
        """Show the target, unless a user is typing."""
        x, y, z = (round(float(part), 3) for part in target[:3, 3])
        numbers = ((x, y, z), round(float(np.degrees(hand_heading(target))), 1))
        # Compare with the last shown numbers, since the fields may hold typed numbers that are not registered yet.
        if self.has_typed_numbers or numbers == self._shown:
            return
        self._shown = numbers
        # mypy cannot express that viser's setters take more types than their getters return.
        self._place.value, self._heading.value = numbers  # type: ignore[misc]

    async def _type(self, event: Any) -> None:
        # An event without a client comes from `show`, not from a user.
        if event.client is not None:
            self._typed_at = time.monotonic()


def hand_heading(T: Array) -> float:
    """Return the heading of the hand's y axis, along which the fingers close, in `world`, rad."""
    return float(np.arctan2(T[1, 1], T[0, 1]))
