"""Tasks as data: things by role, where they start, what is said, when it is done, and an expert made of skills."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, FiniteFloat, ValidationInfo, model_validator

from ..documents.base import Config, ConflictError, Name, Reference
from ..documents.units import (
    Distance,
    Heading,
    HeadingRange,
    JointAngle,
    OffsetPoint,
    Place,
    ReachRange,
    Share,
    Within,
    as_recorded,
)
from ..errors import suggest
from ..goals.cast import Cast
from ..goals.goal import Goal
from ..goals.predicates import On
from ..goals.world import TABLE
from .things.scaled import scaled
from .things.thing import ObjectConfig

#: What tasks say as their `kind`.
PROGRAM = "program"

# How a hand holds a thing: by a constraint, by friction, or cloth by a constraint and everything else by friction.
GraspKind = Literal["weld", "contact", "cloth_constraint"]

# An arm by its turn: the one that `RecordConfig.arm` names begins, the other one is second.
Turn = Literal["first", "second"]

# How a thing can lie at the start: as it stands, on its side, or on its head.
Attitude = Literal["upright", "lying", "upside_down"]

# A placeholder in what is said.
_PLACEHOLDER = re.compile(r"\{([^{}]*)\}")


# How high a crumpled cloth is lifted, as a share of its half diagonal.
_Lift = Annotated[FiniteFloat, Field(ge=0.1, le=0.8)]


class Role(Config):
    """What plays a role: so many things, each drawn from a list.

    No object is drawn twice while others are left, so a count as long as the list takes each of them, in random order.

    Attributes:
        of: the objects to draw from.
        count: how many things play the role.
        sizes: factors of their lengths, of which each thing gets one; only of objects with a `shape`.
        named: after what a thing is called in the scene and in records: its role, or its object. Everything in a task
            names roles either way.
    """

    of: Annotated[tuple[ObjectConfig, ...], Reference("objects"), Field(min_length=1)]
    count: Annotated[int, Field(ge=1, le=20)] = 1
    sizes: Annotated[
        tuple[Annotated[FiniteFloat, Within("times", 0.1, 10)], ...], Field(exclude_if=lambda sizes: not sizes)
    ] = ()
    named: Annotated[Literal["role", "object"], Field(exclude_if=lambda named: named == "role")] = "role"

    @model_validator(mode="after")
    def _one_has_the_objects_name(self) -> Role:
        if self.named == "object" and self.count > 1:
            raise ConflictError(
                f"`named: object` is for a role that one thing plays, and {self.count} play this one; leave it out",
                ("named",),
                ("count",),
            )
        return self

    @model_validator(mode="after")
    def _come_in_all_sizes(self, info: ValidationInfo) -> Role:
        if as_recorded(info):
            return self
        for k, factor in enumerate(self.sizes):
            for item in self.of:
                try:
                    scaled(item, factor)
                except ValueError as error:
                    raise ConflictError(str(error), ("sizes", k)) from None
        return self

    @model_validator(mode="before")
    @classmethod
    def _one_alone(cls, given: Any) -> Any:
        """`of: plate` says the same as `of: [plate]`."""
        one = isinstance(given, Mapping) and isinstance(given.get("of"), Mapping)
        return {**given, "of": [given["of"]]} if one else given


class Start(Config):
    """Where the things of a role start, and how they lie there.

    Attributes:
        on: what they start on: `table`, or a role whose first thing they start on.
        x, y: where the middle of a thing's outline may lie, m: in `world` on the table (x ahead of the arms, y to the
            left of the middle between them), else in the frame of what it starts on.
        from_arm: rather, of which arm's place the region is given: y is to the left of it. Of a lone arm in any case.
        yaw_deg: its heading.
        attitudes: how it may lie; each is as likely.
        apart: the smallest gap between its outline, seen from above, and that of any thing that stands already, m.
        open: of articulated things, part -> how far it is open, as a range of shares; others are closed.
        crumpled: of cloth, how high it is lifted at a point before it is dropped, as a range of shares of its half
            diagonal: 0.3 is light, 0.6 moderate. Without, it lies flat.
    """

    on: Name = TABLE
    from_arm: Annotated[Turn | None, Field(exclude_if=lambda arm: arm is None)] = None
    x: ReachRange
    y: ReachRange
    yaw_deg: HeadingRange = (-180, 180)
    attitudes: Annotated[tuple[Attitude, ...], Field(min_length=1)] = ("upright",)
    apart: Distance = 0.02
    open: Mapping[Name, tuple[Share, Share]] = Field(default_factory=dict)
    crumpled: Annotated[tuple[_Lift, _Lift] | None, Field(exclude_if=lambda lifts: lifts is None)] = None

    @model_validator(mode="after")
    def _crumpled_is_a_range(self) -> Start:
        if self.crumpled is not None and self.crumpled[0] > self.crumpled[1]:
            low, high = self.crumpled
            raise ConflictError(f"a range is [low, high], so {low} must not be above {high}", ("crumpled",))
        return self

    @model_validator(mode="after")
    def _from_an_arm_on_the_table(self) -> Start:
        if self.from_arm is not None and self.on != TABLE:
            raise ConflictError(
                f"a region on the {self.on} is given in its frame, and not from an arm; leave this out", ("from_arm",)
            )
        return self

    def moved(self, y: float) -> Start:
        """The same start in `world`, its region moved along y from an arm's place, m."""
        return self.model_copy(update={"from_arm": None, "y": (self.y[0] + y, self.y[1] + y)})


class Arrangement(Config):
    """Where everything starts in an attempt, where that is not drawn from regions.

    Attributes:
        seed: of what the places come from, so that they can be found again there.
        places: thing, called by its role -> where its origin lies in `world`, x and y in m, and its heading in
            degrees. Things are let down in this order.
    """

    seed: Annotated[int, Field(ge=0)]
    places: Mapping[Name, tuple[Place, Place, Heading]]


class Phrasings(Config):
    """What a person might say to have it done.

    Attributes:
        training: recordings say one of these, drawn for each episode.
        held_out: no recording says these; they are for judging what was learned.
    """

    training: Annotated[tuple[str, ...], Field(min_length=1)]
    held_out: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _apart(self) -> Phrasings:
        if shared := sorted(set(self.training) & set(self.held_out)):
            raise ConflictError(f"{shared[0]!r} is said in training too, so it is not held out", ("held_out",))
        return self

    def filled(self, fill: Callable[[str], str]) -> Phrasings:
        """The same phrasings, their placeholders filled in."""
        return Phrasings.model_construct(
            training=tuple(map(fill, self.training)), held_out=tuple(map(fill, self.held_out))
        )


class NearMiss(Config):
    """How a success may be spoilt so that it is none any more: a thing that is put off from where it ended.

    Attributes:
        thing: a role; each of its things is tried by itself.
        what: said of it in messages, such as "30 mm beside its place".
        move: along the axes of `world`, m.
        tilt_deg: about the x axis of `world`.
    """

    thing: str
    what: str
    move: OffsetPoint = (0.0, 0.0, 0.0)
    tilt_deg: Heading = 0.0


class ProgramTiming(Config):
    """How time passes.

    Attributes:
        settle_ticks: control ticks after the program, in which everything comes to rest.
        physics_steps_per_tick: physics steps in a control tick, in which commands do not change.
        timestep: length of a physics step, s.
        ticks_per_frame: control ticks in a recorded frame.
    """

    settle_ticks: int = Field(default=15, ge=0, le=10_000)
    physics_steps_per_tick: int = Field(default=16, ge=1, le=1000)
    timestep: Annotated[FiniteFloat, Within("s", 1e-5, 0.01)] = 0.002
    ticks_per_frame: int = Field(default=2, ge=1, le=100)

    @property
    def tick(self) -> float:
        """Length of a control tick, s."""
        return self.physics_steps_per_tick * self.timestep


class ProgramTask(Config):
    """A task: things, starts, a goal, and an expert made of skills.

    Attributes:
        rig: what it is done on where nobody says otherwise.
        things: role -> what plays it.
        starts: role -> where its things start. They are placed in this order.
        arrangements: rather, all starts that there are. Of a seed, attempts take them in random order, none twice while
            others are left; `starts` then only says in which regions they are.
        phrasings: what a person might say; the first one stands for the task. `{ROLE}` is the name of the object that
            plays a role, `{ROLE.preposition}` what leads to it, such as "onto"; `{first_arm}` and `{second_arm}` are
            "right" or "left".
        language_task: the task's name in the data, with the same placeholders; if left out, `name`.
        goal: when it is done.
        near_misses: what does not count, for `yamsim tasks check` to try.
        expert: a list of skills that does it, each step of one key; see `core.skills.program`.
        time_limit_s: how long an attempt may take, s of simulated time.
        start_joints: of the arms when it starts, rad; if left out, those of their robot model.
        arms: which of two arms do it: all, or only one, which is the one that `RecordConfig.arm` names.
        grasps: by what its hands may hold things; the first one where nobody says otherwise.
        held_at_the_end: whether hands hold long things far from their middle: contacts are then ten times as stiff
            along surfaces, so that things do not droop.
    """

    name: Name
    kind: Literal["program"]
    rig: str
    arms: Annotated[Literal["all", "one"], Field(exclude_if=lambda arms: arms == "all")] = "all"
    grasps: Annotated[
        tuple[Literal["weld", "contact"], ...],
        Field(min_length=1, exclude_if=lambda grasps: grasps == ("contact",)),
    ] = ("contact",)
    held_at_the_end: Annotated[bool, Field(exclude_if=lambda held: not held)] = False
    things: Annotated[Mapping[Name, Role], Field(min_length=1)]
    starts: Mapping[Name, Start]
    arrangements: Annotated[tuple[Arrangement, ...], Field(exclude_if=lambda given: not given)] = ()
    phrasings: Phrasings
    language_task: Annotated[str, Field(exclude_if=lambda text: not text)] = ""
    goal: Goal
    near_misses: tuple[NearMiss, ...] = ()
    expert: Annotated[tuple[Mapping[str, Any], ...], Field(min_length=1)]
    timing: ProgramTiming = ProgramTiming()
    time_limit_s: Annotated[FiniteFloat, Within("s", 0.1, 3600)] = 120.0
    start_joints: tuple[JointAngle, ...] | None = None

    @model_validator(mode="after")
    def _roles_are_there(self) -> ProgramTask:
        if TABLE in self.things:
            raise ConflictError(f"no role may be called {TABLE!r}, which is what stands there", ("things", TABLE))
        for role in self.starts:
            if role not in self.things:
                raise ConflictError(f"unknown role {role!r}; {suggest(role, self.things)}", ("starts", role))
        for role in self.things:
            if role not in self.starts:
                raise ConflictError(f"nothing says where the {role} starts; add it to `starts`", ("starts",))
        placed = {TABLE}
        for role, start in self.starts.items():
            if start.on not in placed:
                known = suggest(start.on, placed)
                raise ConflictError(
                    f"{start.on!r} is nothing that is placed before the {role}; {known}", ("starts", role, "on")
                )
            placed.add(role)
        known_names = {*self.things, *(name for role in self.things for name in self._numbered(role)), TABLE}
        for k, miss in enumerate(self.near_misses):
            if miss.thing not in known_names - {TABLE}:
                raise ConflictError(
                    f"unknown role {miss.thing!r}; {suggest(miss.thing, self.things)}", ("near_misses", k, "thing")
                )
        for path, predicate in self.goal.predicates():
            for argument, role in predicate.roles():
                if role not in known_names:
                    raise ConflictError(
                        f"unknown role {role!r}; {suggest(role, known_names)}", ("goal", *path, *argument.split("."))
                    )
        return self

    @model_validator(mode="after")
    def _arrangements_are_whole(self) -> ProgramTask:
        names = {name for role in self.things for name in self._numbered(role)}
        for k, one in enumerate(self.arrangements):
            if others := names ^ set(one.places):
                raise ConflictError(
                    f"has to give a place to each of {', '.join(sorted(names))}, and differs in {sorted(others)[0]!r}",
                    ("arrangements", k, "places"),
                )
        return self

    @model_validator(mode="after")
    def _cloth_can_be_so(self) -> ProgramTask:
        for role, start in self.starts.items():
            if self.of_cloth(role) and set(start.attitudes) != {"upright"}:
                raise ConflictError(
                    f"the {role} is cloth, which starts flat or `crumpled`; leave this out",
                    ("starts", role, "attitudes"),
                )
            if start.crumpled is not None and not self.of_cloth(role):
                raise ConflictError(
                    f"the {role} is no cloth, so it does not crumple; leave this out", ("starts", role, "crumpled")
                )
            if self.of_cloth(start.on):
                raise ConflictError(f"nothing starts on cloth, and the {start.on} is some", ("starts", role, "on"))
        for path, predicate in self.goal.predicates():
            for argument, role in predicate.roles():
                if predicate.OF_CLOTH and not self.of_cloth(role):
                    raise ConflictError(
                        f"the {role} is no cloth; give a role that cloth plays", ("goal", *path, *argument.split("."))
                    )
        return self

    @model_validator(mode="after")
    def _names_mean_one_thing(self) -> ProgramTask:
        known: dict[str, ObjectConfig] = {}
        for role, played in self.things.items():
            for k, item in enumerate(played.of):
                if known.setdefault(item.name, item) != item:
                    raise ConflictError(f"two different objects are called {item.name!r}", ("things", role, "of", k))
        taken = {
            name: role for role, one in self.things.items() if one.named == "role" for name in self._numbered(role)
        } | {TABLE: TABLE}
        for role, played in self.things.items():
            if played.named == "role":
                continue
            for k, item in enumerate(played.of):
                if (other := taken.setdefault(item.name, role)) != role:
                    raise ConflictError(
                        f"the {role} may be called {item.name!r}, as the {other} is; give the two different "
                        "objects, or leave `named` out",
                        ("things", role, "named"),
                        ("things", role, "of", k),
                        ("things", other, "of"),
                    )
        return self

    @model_validator(mode="after")
    def _words_are_known(self, info: ValidationInfo) -> ProgramTask:
        known = self._words(self.typical_cast)
        texts: dict[tuple[str | int, ...], str] = {("language_task",): self.language_task}
        for key in ("training", "held_out"):
            texts |= {("phrasings", key, k): text for k, text in enumerate(getattr(self.phrasings, key))}
        for path, text in () if as_recorded(info) else texts.items():
            for word in _PLACEHOLDER.findall(text):
                if word not in known:
                    raise ConflictError(
                        f"unknown placeholder {{{word}}}; valid: {', '.join(f'{{{name}}}' for name in sorted(known))}",
                        path,
                    )
        return self

    @model_validator(mode="after")
    def _parts_are_there(self) -> ProgramTask:
        for role, start in self.starts.items():
            for item in self.things[role].of:
                names = [link.name for link in item.links]
                for part, (low, high) in start.open.items():
                    if part not in names:
                        raise ConflictError(
                            f"the {item.name} has no part {part!r}; {suggest(part, names)}",
                            ("starts", role, "open", part),
                        )
                    if low > high:
                        raise ConflictError(
                            f"a range is [low, high], so {low} must not be above {high}", ("starts", role, "open", part)
                        )
        return self

    def of_cloth(self, name: str) -> bool:
        """Whether cloth may play a role, or the thing of a role."""
        names = {thing: role for role in self.things for thing in (role, *self.possible_names(role))}
        return name in names and any(item.cloth is not None for item in self.things[names[name]].of)

    @property
    def objects(self) -> tuple[ObjectConfig, ...]:
        """All that may play a role, each object once, in the order in which records name it."""
        return tuple({item.name: item for role in self.things.values() for item in role.of}.values())

    @property
    def language_prompt(self) -> str:
        """What is said where no phrasing was drawn, of its typical cast."""
        return _filled(self.phrasings.training[0], _spoken(self._words(self.typical_cast)))

    @property
    def valid_grasps(self) -> tuple[GraspKind, ...]:
        """The grasps that it can be done with, the one first that it is done with where nobody says otherwise."""
        return ("cloth_constraint",) if any(item.cloth for item in self.objects) else self.grasps

    @property
    def target_predicate(self) -> On | None:
        """What tells how far off its target a thing is: the goal's first `on` that has a radius."""
        found = self._target()
        return None if found is None else found[1]

    def with_radius(self, radius: float) -> ProgramTask:
        """The same task, its thing as near to its target as `radius`, m.

        Raises:
            ConflictError: its goal has no `on` with a radius.
        """
        goal = self.goal.model_dump()
        here: Any = goal
        *path, last = self.radius_path[1:]
        for key in path:
            here = here[key]
        here[last] = radius
        return self.model_copy(update={"goal": Goal.model_validate(goal)})

    @property
    def radius_path(self) -> tuple[str | int, ...]:
        """Where the radius of `target_predicate` is, from the task.

        Raises:
            ConflictError: its goal has no `on` with a radius.
        """
        if (found := self._target()) is None:
            raise ConflictError(
                f"task {self.name!r} has no `on` with a `radius` in its goal, so no distance counts", ("goal",)
            )
        return ("goal", *found[0], "radius")

    def _target(self) -> tuple[tuple[str | int, ...], On] | None:
        scored = ((path, one) for path, one in self.goal.predicates() if isinstance(one, On) and one.radius is not None)
        return next(scored, None)

    @property
    def most_ticks(self) -> int:
        """How many control ticks an attempt may take."""
        return math.ceil(self.time_limit_s / self.timing.tick)

    @property
    def hold_ticks(self) -> int:
        """For how many control ticks at the end the goal has to hold."""
        return math.ceil(self.goal.for_s / self.timing.tick)

    @property
    def typical_cast(self) -> Cast:
        """Who plays which role if each list is played from its beginning: what no draw changes follows from it."""
        return self.cast_of(
            {role: tuple(k % len(one.of) for k in range(one.count)) for role, one in self.things.items()}
        )

    def cast_of(self, drawn: Mapping[str, tuple[int, ...]], sizes: Mapping[str, float] | None = None) -> Cast:
        """The cast, by the numbers in `of` of the objects that play each role.

        Args:
            sizes: thing -> factor of its lengths.
        """
        kinds = {
            name: self.things[role].of[k].name
            for role, numbers in drawn.items()
            for name, k in zip(self.names_of(role, numbers), numbers, strict=True)
        }
        return Cast({role: self.names_of(role, numbers) for role, numbers in drawn.items()}, kinds, sizes or {})

    def names_of(self, role: str, drawn: tuple[int, ...]) -> tuple[str, ...]:
        """What the things of a role are called, by the numbers in `of` of their objects: as the object, or as the role,
        and then numbered from 1 where several play it.
        """
        one = self.things[role]
        return self._numbered(role) if one.named == "role" else tuple(one.of[k].name for k in drawn)

    def possible_names(self, role: str) -> tuple[str, ...]:
        """All that things of a role are ever called."""
        one = self.things[role]
        return self._numbered(role) if one.named == "role" else tuple(item.name for item in one.of)

    def _numbered(self, role: str) -> tuple[str, ...]:
        count = self.things[role].count
        return (role,) if count == 1 else tuple(f"{role}_{k + 1}" for k in range(count))

    def _words(self, cast: Cast) -> dict[str, str]:
        """Placeholder -> what is put there."""
        words = {"first_arm": "right", "second_arm": "left"}
        for role, one in self.things.items():
            if one.count == 1:
                kind = cast.kinds[cast.one(role)]
                words[role] = kind
                words[f"{role}.preposition"] = next(item.preposition for item in one.of if item.name == kind)
        return words

    def done_by(self, first: str, second: str) -> ProgramTask:
        """The same task with the sides of its arms, "left" and "right", in what is said."""
        words = {"first_arm": first, "second_arm": second}
        return self._said(lambda text: _filled(text, words), lambda text: _filled(text, words))

    def _said(self, prompt: Callable[[str], str], name: Callable[[str], str]) -> ProgramTask:
        changes = {"phrasings": self.phrasings.filled(prompt), "language_task": name(self.language_task)}
        return self.model_copy(update=changes)

    def played_by(self, cast: Cast) -> ProgramTask:
        """The same task in which each role has the things of a cast, called by their names in it."""
        words = self._words(cast)
        spoken = _spoken(words)
        things = {}
        for role, one in self.things.items():
            kinds = {item.name: item for item in one.of}
            items = tuple(
                scaled(kinds[cast.kinds[name]], cast.sizes.get(name, 1.0)).called(name) for name in cast.of(role)
            )
            things[role] = one.model_copy(update={"of": items})
        said = self._said(lambda text: _filled(text, spoken), lambda text: _filled(text, words))
        return said.model_copy(update={"things": things})


def _filled(text: str, words: Mapping[str, str]) -> str:
    """A text with the placeholders filled in that have a word."""
    return _PLACEHOLDER.sub(lambda found: words.get(found[1], found[0]), text)


def _spoken(words: Mapping[str, str]) -> dict[str, str]:
    """The same words as they are said: a name may be of several."""
    return {name: word.replace("_", " ") for name, word in words.items()}
