"""The robot as raiden's policy server has it: arms that go from one action to the next, and stop where one is too far.

Source of all figures: `raiden/server.py` and `raiden/robot/controller.py` of TRI-ML/raiden 2353b10.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..geometry.se3 import Array
from ..images.fit import fitted
from .chiral_wire import Observed, View
from .follower import Follower
from .hands import Hand, pose_of_rows
from .pictures import PictureProcess, Shot
from .plant import Plant

# Between two actions, and to its home after a reset, commands go evenly, at this rate.
_ACTION_S, _HOME_S, _COMMAND_S = 0.1, 2.0, 0.01
# An action may ask of no joint to go farther than this from where it is, rad.
_LARGEST_STEP = 0.2
# Actions that wait; of more, the newest are thrown away.
_MOST_WAITING = 32
# Side of the pictures that it serves, px: whatever a camera's shape, they are stretched to squares.
_SIDE = 384


@dataclass
class _Motion:
    """Commands from one row of all arms' joints to another, from a time on, for so long, s."""

    start: Array
    goal: Array
    began: float
    lasts: float


class PolicyRobot:
    """Arms that a policy drives, by joints or by its hands' poses, and what it sees meanwhile.

    Rows have each arm's joints in rad and its gripper from 0, closed, to 1, wide open, the left arm's first.

    Attributes:
        stopped: why the arms stand still until the next reset; "" while they take actions.
        thrown_away: actions for which there was no room.

    Args:
        sides, followers, hands: of each arm, the left one first.
        names: camera -> its name for the policy.
    """

    def __init__(
        self,
        plant: Plant,
        sides: Sequence[str],
        followers: Sequence[Follower],
        hands: Sequence[Hand],
        source: PictureProcess,
        names: Mapping[str, str],
    ) -> None:
        self._plant, self._sides, self._followers = plant, tuple(sides), tuple(followers)
        self._hands, self._source, self._names = tuple(hands), source, dict(names)
        self._widths = [follower.num_dofs() for follower in followers]
        self._joint_numbers, self._pose_numbers = sum(self._widths), 10 * len(self._widths)
        self._commanded: Array | None = None
        self._actions: deque[Array] = deque()
        self._motion: _Motion | None = None
        self._next_command = 0.0
        self._views: tuple[int, dict[str, View]] = -1, {}
        self.stopped = ""
        self.thrown_away = 0

    @property
    def metadata(self) -> dict[str, Any]:
        """What the robot says it is: cameras, arrays, and what an action has."""
        parts = (("xyz", 3), ("rot6d", 6), ("grip", 1))
        return {
            "cameras": [self._names[camera] for camera in self._source.cameras],
            "action_type": "ee_pose",
            "action_shape": [self._pose_numbers],
            "action_layout": "+".join(f"{side}_{part}({n})" for part, n in parts for side in self._sides),
            "joint_action_shape": [self._joint_numbers],
            "joint_action_layout": "+".join(
                f"{side}_joints({n})" for side, n in zip(self._sides, self._widths, strict=True)
            ),
            "proprio_names": [name for side in self._sides for name in _proprio_names(side)],
        }

    @property
    def is_going_home(self) -> bool:
        """Whether a reset is under way."""
        return self._motion is not None and self._motion.lasts == _HOME_S

    @property
    def seen(self) -> float:
        """When the newest pictures were taken, in the simulation, s; -1 if there are none."""
        return -1.0 if self._source.shot is None else self._source.shot.sim_time

    @property
    def now(self) -> float:
        """Time in the simulation, s."""
        return self._plant.now

    def reset(self) -> None:
        """Take actions again, and send the arms home: joints at 0, grippers open."""
        goal = np.concatenate([np.append(np.zeros(width - 1), 1.0) for width in self._widths])
        self._actions.clear()
        self.stopped = ""
        self._commanded = None
        self._motion = _Motion(self._row(), goal, self._plant.now, _HOME_S)

    def stop(self, why: str) -> None:
        """Hold the arms where they are, and take no action until the next reset."""
        self.stopped = why
        self._actions.clear()
        self._motion = None
        self._tell(self._row())

    def act(self, numbers: Array) -> None:
        """Go to an action next: as many joints as a row has, or 10 numbers an arm, see `metadata`.

        Raises:
            ValueError: it is neither, or not finite.
        """
        if not np.isfinite(numbers).all():
            raise ValueError("an action has numbers that are not finite")
        if numbers.shape not in ((self._joint_numbers,), (self._pose_numbers,)):
            raise ValueError(f"an action has {self._pose_numbers} or {self._joint_numbers} numbers")
        if self.stopped or self.is_going_home:
            return
        row = numbers if len(numbers) == self._joint_numbers else self._by_hands(numbers)
        if fault := self._too_far(row):
            self.stop(fault)
            return
        self._commanded = row
        if len(self._actions) >= _MOST_WAITING:
            self.thrown_away += 1
            return
        self._actions.append(row)

    def tick(self) -> None:
        """Tell the arms what to do until the next physics step."""
        now = self._plant.now
        if self._motion is None and self._actions:
            start = self._told if self._told is not None else self._row()
            self._motion = _Motion(start, self._actions.popleft(), now, _ACTION_S)
        motion = self._motion
        if motion is None or now < self._next_command:
            return
        self._next_command = now + _COMMAND_S
        share = min((now - motion.began) / motion.lasts, 1.0)
        self._tell((1 - share) * motion.start + share * motion.goal)
        if share == 1.0:
            self._motion = None

    def observed(self, shot: Shot) -> Observed:
        """What a policy is told of a shot."""
        proprios: dict[str, Array] = {}
        for side, hand, joints in zip(self._sides, self._hands, shot.joints, strict=True):
            T = hand.T_in_base(joints[:-1])
            values = joints, T[:3, 3], T[:2, :3].ravel(), joints[-1:]
            proprios |= dict(zip(_proprio_names(side), values, strict=True))
        if self._views[0] != shot.number:
            self._views = shot.number, {self._names[camera]: self._view(shot, camera) for camera in shot.pictures}
        extra = {"sim_time": shot.sim_time, "stopped": self.stopped}
        return Observed(self._views[1], proprios, shot.time_ns * 1e-9, extra)

    @property
    def shot(self) -> Shot | None:
        """The newest pictures."""
        return self._source.shot

    def _view(self, shot: Shot, camera: str) -> View:
        width, height = self._source.size
        K = np.diag([_SIDE / width, _SIDE / height, 1.0]) @ self._source.K[camera]
        picture = fitted(shot.pictures[camera], (_SIDE, _SIDE), pad=False)
        return View(picture, K, shot.T_cam_in_base[camera], shot.time_ns)

    def _by_hands(self, numbers: Array) -> Array:
        """The row that brings hands to poses: all positions (3), then all rotations' first rows (6), then grippers."""
        arms = len(self._widths)
        positions, rows, grips = np.split(numbers, [3 * arms, 9 * arms])
        near = np.split(self._commanded if self._commanded is not None else self._row(), np.cumsum(self._widths)[:-1])
        found = []
        for hand, start, position, row, grip in zip(
            self._hands, near, positions.reshape(arms, 3), rows.reshape(arms, 6), grips, strict=True
        ):
            found.append(np.append(hand.joints(pose_of_rows(position, row), start[:-1]), grip))
        return np.concatenate(found)

    def _too_far(self, row: Array) -> str:
        """Which joint a row asks too much of; "" for none."""
        off = np.abs(row - self._row())
        ends = np.cumsum(self._widths)
        off[ends - 1] = 0.0  # Grippers may go all their way.
        if off.max() <= _LARGEST_STEP:
            return ""
        worst = int(off.argmax())
        arm = int(np.searchsorted(ends, worst, side="right"))
        joint = worst - (ends[arm] - self._widths[arm]) + 1
        return (
            f"an action asked joint {joint} of the {self._sides[arm]} arm to go {off[worst]:.2f} rad at once, "
            f"more than {_LARGEST_STEP} rad; reset to go on"
        )

    @property
    def _told(self) -> Array | None:
        rows = [follower.told for follower in self._followers]
        return None if any(row is None for row in rows) else np.concatenate([row for row in rows if row is not None])

    def _row(self) -> Array:
        return np.concatenate([follower.joint_pos() for follower in self._followers])

    def _tell(self, row: Array) -> None:
        for follower, joints in zip(self._followers, np.split(row, np.cumsum(self._widths)[:-1]), strict=True):
            follower.command_joint_pos(joints)


def _proprio_names(side: str) -> tuple[str, str, str, str]:
    return (
        f"follower_{side[0]}_joint_pos",
        f"robot__actual__poses__{side}::yam__xyz",
        f"robot__actual__poses__{side}::yam__rot_6d",
        f"robot__actual__grippers__{side}::yam_hand",
    )
