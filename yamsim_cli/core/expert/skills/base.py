"""The base class of skills: arguments as a config, and motions that are planned while the skill runs."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from typing import ClassVar, Literal

from ...config.goals.cast import Cast
from ...files.documents.base import Config
from ...geometry.se3 import Array
from ...types import Cause
from .bench import Bench, Segment, SkillFailedError
from .hand import Hand

# The arm that a skill uses: by its side, or by its turn, which follows from `RecordConfig.arm`.
Side = Literal["left", "right", "first", "second", "any"]


class Skill(Config):
    """Base class of the skills. A subclass's fields are its arguments; `ROLES` lists the fields that name a role.

    A skill plans from the present state. Between two yielded segments, the caller executes the motion and updates
    the bench's world.
    """

    ROLES: ClassVar[tuple[str, ...]]
    # Whether the skill's thing has to be in a hand before, and whether it is in a hand afterwards. None: either before,
    # and unchanged afterwards.
    NEEDS_HELD: ClassVar[bool | None] = None
    LEAVES_HELD: ClassVar[bool | None] = None
    # Whether the skill manipulates cloth. Other skills manipulate rigid things; roles in `ANY_MATERIAL` may be either.
    OF_CLOTH: ClassVar[bool] = False
    ANY_MATERIAL: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def run(self, bench: Bench, cast: Cast, ahead: Sequence[Skill]) -> Iterator[Segment]:
        """Yield the segments of motion that perform the skill.

        Args:
            ahead: the skills that follow, the next first. Choices such as a grip have to suit them.

        Raises:
            SkillFailedError: no motion was found, or the skill did not have its effect.
        """

    def fault(
        self,
        bench: Bench,
        cast: Cast,
        hand: Hand,
        thing: str,
        T_thing_in_pinch: Array,
        joints: Array,
        ahead: Sequence[Skill] = (),
    ) -> str | None:
        """Return why this skill would fail with a thing held in a given pose; None if nothing is known to prevent it.

        Args:
            T_thing_in_pinch: the thing's pose (4, 4) in the hand's pinch frame.
            joints: joints (dof,) at which the arm would grasp the thing, rad.
            ahead: the skills after this one. A skill that hands the thing over has to leave them possible.
        """
        return None

    def relaxed(self, bench: Bench, cast: Cast) -> Skill:
        """Return this skill without its preferences, for hands that cannot satisfy them; itself if there are none."""
        return self

    def places(self, bench: Bench, cast: Cast, thing: str) -> Sequence[Array]:
        """Return roughly where this skill would bring a thing: points (2,) in `world`, m; none if nowhere."""
        return ()

    def roles(self) -> tuple[tuple[str, str], ...]:
        """Return each argument that names a role, with the role."""
        return tuple((field, role) for field in self.ROLES if (role := getattr(self, field)) is not None)


def preferences(ahead: Sequence[Skill], bench: Bench, cast: Cast) -> Iterator[Sequence[Skill]]:
    """Yield the skills that follow with their preferences; then without, if that changes any of them."""
    yield ahead
    relaxed = [skill.relaxed(bench, cast) for skill in ahead]
    if any(one is not other for one, other in zip(relaxed, ahead, strict=True)):
        yield relaxed


def require_holder(bench: Bench, thing: str, done: str) -> Hand:
    """Return the hand that holds a thing.

    Args:
        done: for the message, what is to be done with the thing, such as "put down".

    Raises:
        SkillFailedError: no hand holds the thing.
    """
    hand = holder_of(bench, thing)
    if hand is None:
        raise SkillFailedError(Cause.DROPPED, f"no hand holds the {thing} that is to be {done}")
    return hand


def holder_of(bench: Bench, thing: str) -> Hand | None:
    """Return the hand that holds a thing, as of its last `Bench.update_held`; None if no hand does."""
    return next((hand for hand in bench.hands if hand.held is not None and hand.held.thing == thing), None)
