"""Programs: loops over a role's objects, and repeated and noted failures."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib.metadata import EntryPoint
from typing import Any, ClassVar, cast

import pytest

from yamsim_cli.core.attempt_data import FailureCause
from yamsim_cli.core.config.goals.role_assignment import RoleAssignment
from yamsim_cli.core.expert.skills import program
from yamsim_cli.core.expert.skills.hand import Hand
from yamsim_cli.core.expert.skills.operate import Operate
from yamsim_cli.core.expert.skills.pick import Pick
from yamsim_cli.core.expert.skills.place import Place
from yamsim_cli.core.expert.skills.planning_context import MotionSegment, PlanningContext, SkillFailedError
from yamsim_cli.core.expert.skills.program import RecoveryLog, SkillRetry, parse_program, run_program
from yamsim_cli.core.expert.skills.skill import Skill
from yamsim_cli.core.files.documents.config_base import ConflictError

CAST = RoleAssignment(
    {"cube": ("cube_1", "cube_2", "cube_3"), "plate": ("plate",)},
    {"cube_1": "blue", "cube_2": "red", "cube_3": "blue", "plate": "plate"},
)


class Failing(Skill):
    """Fails a given number of times."""

    ROLES: ClassVar[tuple[str, ...]] = ()
    times: int
    tried: ClassVar[int] = 0

    def run(self, bench: PlanningContext, cast: RoleAssignment, ahead: Sequence[Skill]) -> Iterator[MotionSegment]:
        Failing.tried += 1
        if Failing.tried <= self.times:
            raise SkillFailedError(FailureCause.SLIPPED, f"try {Failing.tried}")
        yield MotionSegment(())


class NoHands:
    """A planning context without hands to park."""

    hands = ()

    def free_hands(self, arm: str) -> list[Hand]:
        return []


@pytest.fixture(autouse=True)
def _failing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Failing, "tried", 0)
    monkeypatch.setattr(program, "SKILLS", {**program.SKILLS, "failing": Failing})


def _run(times: int) -> RecoveryLog:
    log = RecoveryLog()
    for _ in run_program([Failing(times=times)], cast(PlanningContext, NoHands()), CAST, log):
        pass
    return log


def test_a_failed_skill_is_tried_again_and_recorded() -> None:
    assert _run(2).recoveries == [SkillRetry(0, "failing", "try 1"), SkillRetry(0, "failing", "try 2")]


def test_a_successful_skill_is_not_tried_again() -> None:
    assert _run(0).recoveries == [] and Failing.tried == 1


def test_a_third_failure_of_a_skill_ends_the_program() -> None:
    with pytest.raises(SkillFailedError, match="try 3") as caught:
        _run(3)
    assert caught.value.cause is FailureCause.SLIPPED


class HandlessPick(Pick):
    """Takes without a hand."""

    def run(self, bench: PlanningContext, cast: RoleAssignment, ahead: Sequence[Skill]) -> Iterator[MotionSegment]:
        yield MotionSegment(())


class FailingPlace(Place):
    """Fails a given number of times, with its object in a hand."""

    tried: ClassVar[list[str]] = []

    def run(self, bench: PlanningContext, cast: RoleAssignment, ahead: Sequence[Skill]) -> Iterator[MotionSegment]:
        FailingPlace.tried.append(self.thing)
        if len(FailingPlace.tried) <= self.number:
            raise SkillFailedError(FailureCause.UNREACHABLE, "not there with it")
        yield MotionSegment(())


def _put_back(monkeypatch: pytest.MonkeyPatch, taken: str, times: int) -> list[str]:
    """Count how often an object is put down to be grasped in another way, after failures of placing the plate."""
    put: list[str] = []

    def put_back(bench: PlanningContext, cast: RoleAssignment, role: str) -> Iterator[MotionSegment]:
        put.append(role)
        yield MotionSegment(())

    monkeypatch.setattr(FailingPlace, "tried", [])
    monkeypatch.setattr(program, "put_down_failed_object", put_back)
    steps = [HandlessPick(thing=taken), FailingPlace(thing="plate", on="table", at=(0.0, 0.0), number=times)]
    list(run_program(steps, cast(PlanningContext, NoHands()), CAST, RecoveryLog()))
    return put


class Closing(Operate):
    """Fails once, as when a hand slips off a drawer."""

    def run(self, bench: PlanningContext, cast: RoleAssignment, ahead: Sequence[Skill]) -> Iterator[MotionSegment]:
        ran.append("operate")
        if ran.count("operate") == 1:
            raise SkillFailedError(FailureCause.SLIPPED, "the hand slipped off")
        yield MotionSegment(())


class RecordingPick(HandlessPick):
    """Notes what it takes."""

    def run(self, bench: PlanningContext, cast: RoleAssignment, ahead: Sequence[Skill]) -> Iterator[MotionSegment]:
        ran.append(f"pick {self.thing}")
        yield MotionSegment(())


class Dropping(Place):
    """Drops its object the first time."""

    def run(self, bench: PlanningContext, cast: RoleAssignment, ahead: Sequence[Skill]) -> Iterator[MotionSegment]:
        ran.append(f"place {self.thing}")
        if ran.count(f"place {self.thing}") == 1 and self.thing == "cube_1":
            raise SkillFailedError(FailureCause.DROPPED, "it fell")
        yield MotionSegment(())


ran: list[str] = []


def _ran(*steps: Skill) -> list[str]:
    ran.clear()
    list(run_program(steps, cast(PlanningContext, NoHands()), CAST, RecoveryLog()))
    return list(ran)


def test_a_step_that_needs_nothing_in_a_hand_is_tried_again_by_itself() -> None:
    steps = (
        RecordingPick(thing="cube_1"),
        Dropping(thing="cube_1", on="plate"),
        Closing(thing="plate", joint="lid", to=0),
    )
    assert _ran(*steps)[-2:] == ["operate", "operate"]
    assert _ran(*steps).count("pick cube_1") == 2


def test_the_steps_since_the_pick_of_a_dropped_object_are_repeated() -> None:
    steps = RecordingPick(thing="cube_1"), RecordingPick(thing="cube_2"), Dropping(thing="cube_1", on="plate")
    again = ["pick cube_1", "pick cube_2", "place cube_1"]
    assert _ran(*steps) == again + again
    first = RecordingPick(thing="cube_2"), Dropping(thing="cube_2", on="plate"), RecordingPick(thing="cube_1")
    last = ["pick cube_1", "place cube_1"]
    assert _ran(*first, Dropping(thing="cube_1", on="cube_2")) == ["pick cube_2", "place cube_2", *last, *last]


def test_an_object_that_cannot_be_placed_twice_is_grasped_in_another_way(monkeypatch: pytest.MonkeyPatch) -> None:
    assert _put_back(monkeypatch, "plate", 1) == []
    assert _put_back(monkeypatch, "plate", 2) == ["plate"]


def test_an_object_that_was_not_picked_is_not_put_back(monkeypatch: pytest.MonkeyPatch) -> None:
    assert _put_back(monkeypatch, "cube_1", 2) == []


def test_each_goes_through_the_things_of_a_role() -> None:
    steps: list[dict[str, Any]] = [
        {
            "each": {
                "of": "cube",
                "skip": 1,
                "do": [{"pick": {"thing": "it"}}, {"place": {"thing": "it", "on": "previous"}}],
            }
        }
    ]
    assert parse_program(steps, CAST) == [
        Pick(thing="cube_2"),
        Place(thing="cube_2", on="cube_1"),
        Pick(thing="cube_3"),
        Place(thing="cube_3", on="cube_2"),
    ]


def test_each_may_go_by_kinds_and_count() -> None:
    step = {"place": {"thing": "it", "on": "table", "at": [0.4, 0.0], "step": [0, 0.1], "number": "number"}}
    placed = parse_program([{"each": {"of": "cube", "order": ["red", "blue"], "do": [step]}}], CAST)
    assert [(skill.thing, skill.number) for skill in placed if isinstance(skill, Place)] == [
        ("cube_2", 0),
        ("cube_1", 1),
        ("cube_3", 2),
    ]


@pytest.mark.parametrize(
    ("step", "path", "said"),
    [
        ({"pick": {"thing": "cube"}, "place": {}}, (0,), "has one key"),
        ({"each": {"of": "cap", "do": []}}, (0, "each", "of"), "unknown role 'cap'"),
        ({"each": {"of": "cube", "do": []}}, (0, "each", "do"), "a list of steps"),
        ({"each": {"of": "cube", "skip": -1, "do": [{}]}}, (0, "each", "skip"), "`skip` -1 is not valid"),
        ({"place": {"thing": "cube", "on": "table"}}, (0, "place"), "give `at` or `start_of`"),
    ],
)
def test_an_invalid_step_is_refused_with_its_key_path(step: dict[str, Any], path: tuple[Any, ...], said: str) -> None:
    with pytest.raises(ConflictError, match=said) as caught:
        parse_program([step], CAST)
    assert caught.value.paths[0] == path


class FailingElsewhere(Failing):
    """A skill of another package."""

    ROLES: ClassVar[tuple[str, ...]] = ("thing",)
    thing: str = "cube"


def _entry_points(**places: str) -> dict[str, tuple[EntryPoint, ...]]:
    return {name: (EntryPoint(name, place, program.SKILL_GROUP),) for name, place in places.items()}


def test_skills_of_other_packages_are_found_by_their_entry_points(monkeypatch: pytest.MonkeyPatch) -> None:
    points = _entry_points(
        fail=f"{__name__}:FailingElsewhere",
        lost="yamsim_cli.no_such_module:Lost",
        gone=f"{__name__}:NoSuchClass",
        other=f"{__name__}:CAST",
        empty=f"{__name__}:Failing",
    )
    points["twice"] = points["fail"] + points["lost"]
    monkeypatch.setattr(program, "_skill_entry_points", lambda: points)
    assert program.skill_names()[-6:] == ("fail", "lost", "gone", "other", "empty", "twice")
    (skill,) = parse_program([{"fail": {"times": 2}}], CAST)
    assert skill == FailingElsewhere(times=2) and program.skill_name(skill) == "fail"
    for name, said in (
        (
            "lost",
            r"the skill 'lost' \(yamsim_cli.no_such_module:Lost\) cannot be loaded: .*; correct its package",
        ),
        ("gone", r"the skill 'gone' \(.*:NoSuchClass\) cannot be loaded"),
        ("other", r"the skill 'other' \(.*:CAST\) is not a subclass of Skill"),
        ("empty", r"the skill 'empty' \(.*:Failing\) names no role"),
        ("twice", "several packages have a skill 'twice' .*; rename the one"),
        ("fial", "unknown skill 'fial'; did you mean 'fail'"),
    ):
        with pytest.raises(ConflictError, match=said):
            parse_program([{name: {}}], CAST)


def test_yamsims_own_entry_points_are_found() -> None:
    assert set(program.skill_names()) - set(program.SKILLS) == {
        "fold_small",
        "open_lid",
        "pour",
        "press_level",
        "scoop",
        "sort",
    }
    assert all(issubclass(program.skill_class(name), Skill) for name in program.skill_names())
