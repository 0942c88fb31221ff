"""What every skill is: its arguments as a config, and the motions that it plans on its way."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from typing import ClassVar, Literal

from ..documents.base import Config
from ..geometry.se3 import Array
from ..goals.cast import Cast
from ..types import Cause
from .bench import Bench, Segment, SkillFailedError
from .hand import Hand

# Which arm a skill uses: by its side, or by its turn, see `RecordConfig.arm`.
Side = Literal["left", "right", "first", "second", "any"]


class Skill(Config):
    """Base of the skills. A subclass's fields are its arguments; those that name a role are listed in `ROLES`.

    A skill plans from the state that it finds: between two segments that it yields, whoever runs it lets them act, and
    brings the bench's world up to date.
    """

    ROLES: ClassVar[tuple[str, ...]]
    # Whether its thing has to be in a hand before, and whether it is in one afterwards; None leaves that as it is.
    NEEDS_HELD: ClassVar[bool | None] = None
    LEAVES_HELD: ClassVar[bool | None] = None
    # Whether it is done with cloth alone; others are with stiff things alone, but for the roles that may be either.
    OF_CLOTH: ClassVar[bool] = False
    ANY_MATERIAL: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def run(self, bench: Bench, cast: Cast, ahead: Sequence[Skill]) -> Iterator[Segment]:
        """Do it.

        Args:
            ahead: the skills that follow, the next one first, for choices that have to suit them.

        Raises:
            SkillFailedError: there is no way, or its effect did not come about.
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
        """Why this skill could not go on with a thing that a hand were to hold so; None if it could, as far as known.

        Args:
            T_thing_in_pinch: the thing's pose (4, 4) in the hand's pinch frame.
            joints: of the arm (dof,) where it would take the thing, rad.
            ahead: the skills after this one, which a skill that hands the thing on has to leave possible.
        """
        return None

    def relaxed(self, bench: Bench, cast: Cast) -> Skill:
        """The same skill with what it only prefers left open, for hands that cannot do what it prefers."""
        return self

    def places(self, bench: Bench, cast: Cast, thing: str) -> Sequence[Array]:
        """About where this skill would bring a thing (2,), in `world`, m; none if it brings it nowhere."""
        return ()

    def roles(self) -> tuple[tuple[str, str], ...]:
        """The arguments that name roles, and the roles."""
        return tuple((field, role) for field in self.ROLES if (role := getattr(self, field)) is not None)


def preferences(ahead: Sequence[Skill], bench: Bench, cast: Cast) -> Iterator[Sequence[Skill]]:
    """The skills that follow as they prefer it; and, where that is something else, with what they prefer left open."""
    yield ahead
    relaxed = [skill.relaxed(bench, cast) for skill in ahead]
    if any(one is not other for one, other in zip(relaxed, ahead, strict=True)):
        yield relaxed


def require_holder(bench: Bench, thing: str, done: str) -> Hand:
    """The hand that holds a thing which is to be `done`, such as "put down".

    Raises:
        SkillFailedError: none does any more.
    """
    hand = holder_of(bench, thing)
    if hand is None:
        raise SkillFailedError(Cause.DROPPED, f"no hand holds the {thing} that is to be {done}")
    return hand


def holder_of(bench: Bench, thing: str) -> Hand | None:
    """The hand that is to hold a thing, if one is."""
    return next((hand for hand in bench.hands if hand.held is not None and hand.held.thing == thing), None)
