from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from typing import ClassVar, Literal

from ...attempt_data import FailureCause
from ...config.goals.role_assignment import RoleAssignment
from ...config.program_task import ProgramTask
from ...files.documents.config_base import Config
from ...geometry.se3 import Array
from .hand import Hand
from .planning_context import MotionSegment, PlanningContext, SkillFailedError

# The arm that a skill uses: by its side, by its order in the task (see `RecordConfig.arm`), or any acting arm.
ArmSelector = Literal["left", "right", "first", "second", "any"]


class Skill(Config):
    """Base class of the skills. A subclass's fields are its arguments; `ROLES` lists the fields that name a role.

    A skill plans from the present state. Between two yielded segments, the caller executes the motion and updates the
    planning context's world.
    """

    ROLES: ClassVar[tuple[str, ...]]
    # Whether the skill needs its object in a hand, and whether it leaves the object in a hand. None: either state is
    # allowed before, and the skill does not change it.
    REQUIRES_HELD_OBJECT: ClassVar[bool | None] = None
    LEAVES_OBJECT_HELD: ClassVar[bool | None] = None
    HANDS: ClassVar[int] = 1  # that the skill needs
    ONE_HAND_ALTERNATIVE: ClassVar[str] = ""  # arguments that make one hand enough, for an error message
    HANDS_OVER: ClassVar[bool] = False  # whether the object goes from one hand to the other
    # Whether the skill manipulates cloth, else rigid objects; roles in `ROLES_OF_ANY_MATERIAL` may be either.
    HANDLES_CLOTH: ClassVar[bool] = False
    ROLES_OF_ANY_MATERIAL: ClassVar[tuple[str, ...]] = ()
    # Arguments that may name `table`, and arguments that may name a region of the task.
    TABLE_ARGUMENTS: ClassVar[tuple[str, ...]] = ()
    REGION_ARGUMENTS: ClassVar[tuple[str, ...]] = ()
    # Duration in a successful attempt, s, for estimates before a run. Source: means over the shipped tasks and, for the
    # skills of `kitchen_skills`, one episode each. No shipped task has `push`, `turn` or `regrasp`, whose values are
    # estimates.
    TYPICAL_SECONDS: ClassVar[float] = 5.0

    @abstractmethod
    def run(
        self, context: PlanningContext, roles: RoleAssignment, next_skills: Sequence[Skill]
    ) -> Iterator[MotionSegment]:
        """Yield the segments of motion that perform the skill, or raise SkillFailedError.

        Choices such as a grasp have to suit the next skills.
        """

    def infeasibility_reason(
        self,
        context: PlanningContext,
        roles: RoleAssignment,
        hand: Hand,
        thing: str,
        T_thing_in_pinch: Array,
        joints: Array,
        next_skills: Sequence[Skill] = (),
    ) -> str | None:
        """Return why this skill would fail with an object held in a given pose; None if nothing is known to prevent it.

        Args:
            joints: joints (dof,) at which the arm would grasp the object, rad.
            next_skills: the skills after this one. A skill that hands the object over has to leave them possible.
        """
        return None

    def without_preferences(self, context: PlanningContext, roles: RoleAssignment) -> Skill:
        """Return this skill without its preferences, for hands that cannot satisfy them."""
        return self

    def approximate_targets(self, context: PlanningContext, roles: RoleAssignment, thing: str) -> Sequence[Array]:
        """Return roughly where this skill would bring an object: points (2,) in `world`, m; empty if nowhere."""
        return ()

    def task_fault(self, task: ProgramTask) -> tuple[str, str] | None:
        """Check a task's objects before anything runs.

        Return an argument and the reason if an object does not suit it; else None.
        """
        return None

    def reason_to_be_last(self, task: ProgramTask) -> str | None:
        """Return why no step can follow this one, with a remedy; None if steps can follow."""
        return None

    def point_on_table(self) -> tuple[str, Array] | None:
        """Return the argument that gives a point of the table, and the point (2,) in `world`, m; None if none does."""
        return None

    @property
    def hand_count(self) -> int:
        """Number of hands that the skill needs with its arguments."""
        return self.HANDS

    def roles(self) -> tuple[tuple[str, str], ...]:
        """Return (argument, role) of all given arguments that name a role."""
        return tuple((field, role) for field in self.ROLES if (role := getattr(self, field)) is not None)


def preference_levels(
    next_skills: Sequence[Skill], context: PlanningContext, roles: RoleAssignment
) -> Iterator[Sequence[Skill]]:
    """Yield the next skills with their preferences, then without if that changes any of them."""
    yield next_skills
    relaxed = [skill.without_preferences(context, roles) for skill in next_skills]
    if any(one is not other for one, other in zip(relaxed, next_skills, strict=True)):
        yield relaxed


def require_holding_hand(context: PlanningContext, thing: str, action: str) -> Hand:
    """Return the hand that holds an object; `action` is a participle for the error message, such as "put down"."""
    hand = find_holding_hand(context, thing)
    if hand is None:
        raise SkillFailedError(FailureCause.DROPPED, f"no hand holds the {thing} that is to be {action}")
    return hand


def find_holding_hand(context: PlanningContext, thing: str) -> Hand | None:
    """Return the hand that holds an object, as of the last `PlanningContext.measure_held_object`."""
    return next(
        (hand for hand in context.hands if hand.held_object is not None and hand.held_object.thing == thing), None
    )
