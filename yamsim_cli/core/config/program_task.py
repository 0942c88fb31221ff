"""Configs of tasks: their objects, instructions, a goal, the skills that reach it, and their rates."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable, Iterator, Mapping
from typing import Annotated, Any, ClassVar, Literal, Protocol

from pydantic import Field, FiniteFloat, ValidationInfo, model_validator

from ..errors import suggest_similar
from ..files.documents.config_base import Config, ConflictError, Name
from ..files.documents.units import Heading, JointAngle, OffsetPoint, QuantityBounds, is_recorded_config
from .goals.goal import Goal
from .goals.predicates import Contains, On
from .goals.role_assignment import RoleAssignment
from .goals.world import TABLE
from .objects.object_config import ObjectConfig
from .task_objects import Arrangement, ObjectStartRanges, Region, Role, TableArea

PROGRAM_KIND = "program"  # the `kind` of tasks

# A weld constraint; friction; or a constraint for cloth and friction for all other objects.
GraspKind = Literal["weld", "contact", "cloth_constraint"]

_PLACEHOLDER = re.compile(r"\{([^{}]*)\}")
_MAX_TICK_CHANGE = 0.07  # largest relative change of a control tick for a frame rate, as skills count waits in ticks


class ArgumentOwner(Protocol):
    """A predicate or a skill: the arguments that may name the table, and those that may name a region."""

    TABLE_ARGUMENTS: ClassVar[tuple[str, ...]]
    REGION_ARGUMENTS: ClassVar[tuple[str, ...]]


class Phrasings(Config):
    """Instructions of a task.

    Attributes:
        training: instructions of recorded episodes; each episode has a random one.
        held_out: instructions that are never recorded, for the evaluation of policies on unseen ones.
    """

    training: Annotated[tuple[str, ...], Field(min_length=1)]
    held_out: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _check_splits_are_disjoint(self) -> Phrasings:
        if shared := sorted(set(self.training) & set(self.held_out)):
            raise ConflictError(f"{shared[0]!r} is also in `training`; remove it from one of the two", ("held_out",))
        return self

    def map_instructions(self, fill: Callable[[str], str]) -> Phrasings:
        """Return the phrasings with every instruction replaced by `map_instructions(instruction)`."""
        return Phrasings.model_construct(
            training=tuple(map(fill, self.training)), held_out=tuple(map(fill, self.held_out))
        )


class NearMiss(Config):
    """A displacement of an object from its final pose that must turn a success into a failure.

    Attributes:
        thing: a role; each of its objects is displaced alone.
        what: description of the displacement in messages, such as "30 mm beside its place".
        move: translation along the axes of `world`, m.
        tilt_deg: rotation about the x axis of `world`.
    """

    thing: str
    what: str
    move: OffsetPoint = (0.0, 0.0, 0.0)
    tilt_deg: Heading = 0.0


class ProgramTiming(Config):
    """Rates of physics, control and recorded frames.

    Attributes:
        settle_ticks: control ticks after the program, in which objects come to rest.
        physics_steps_per_tick: physics steps per control tick; commands are constant during a tick.
        timestep: length of a physics step, s.
        ticks_per_frame: control ticks per recorded frame.
    """

    settle_ticks: int = Field(default=15, ge=0, le=10_000)
    physics_steps_per_tick: int = Field(default=16, ge=1, le=1000)
    timestep: Annotated[FiniteFloat, QuantityBounds("s", 1e-5, 0.01)] = 0.002
    ticks_per_frame: int = Field(default=2, ge=1, le=100)

    @property
    def tick_seconds(self) -> float:
        """Length of a control tick, s."""
        return self.physics_steps_per_tick * self.timestep

    def at_rate(self, fps: float) -> dict[str, float | int]:
        """Return the `timestep` (s) and `ticks_per_frame` for `fps` frames per second with about the same control tick.

        Raises ValueError if no whole number of ticks of about this length gives the rate.
        """
        ticks = max(1, round(1 / (fps * self.tick_seconds)))
        tick = 1 / (fps * ticks)
        if abs(tick / self.tick_seconds - 1) > _MAX_TICK_CHANGE:
            low, high = (1 / (self.tick_seconds * (1 + sign * _MAX_TICK_CHANGE)) for sign in (1, -1))
            valid = ", ".join(f"{low / n:.1f} to {high / n:.1f}" for n in (1, 2, 3, 4))
            raise ValueError(
                f"at {fps:g} frames a second, a frame is not a whole number of control ticks of "
                f"{self.tick_seconds * 1000:.0f} ms; valid: {valid}, and so on"
            )
        return {"timestep": tick / self.physics_steps_per_tick, "ticks_per_frame": ticks}


class ProgramTask(Config):
    """A task: objects, their initial poses, a goal, and the skills that reach it.

    Attributes:
        rig: the default rig.
        things: role -> its objects.
        regions: name -> region of an object.
        table_area: the area that the table covers at least; if left out, the scene's table is large enough.
        starts: role -> ranges of its objects' initial poses. Roles are placed in this order.
        arrangements: lists of initial poses, used instead of samples from `starts`. The attempts of a seed use them in
            random order, each again only after all others. `starts` still gives the regions that contain them.
        phrasings: instructions; the first one represents the task. `{ROLE}` is the name of a role's object,
            `{ROLE.preposition}` the object's preposition, "on" or "in". `{first_arm}` and `{second_arm}` are "right"
            or "left".
        language_task: the task's name in the data, with the same placeholders; if left out, `name`.
        goal: the condition for success.
        near_misses: displacements that must not count as success, for `yamsim tasks check`.
        expert: list of skills that perform the task, each a mapping with one key; see `core.expert.skills.program`.
        time_limit_s: largest duration of an attempt, s of simulated time.
        start_joints: joints of the arms at the start, rad; if left out, the robot model's start joints.
        arms: the arms that act: all, or only `RecordConfig.arm`.
        grasps: possible grasps, the default first.
        held_at_the_end: whether hands hold long objects far from the middle. Contacts are then ten times as stiff along
            surfaces, so that the objects do not droop.
    """

    name: Name
    kind: Literal["program"]
    rig: str
    arms: Literal["all", "one"] = "all"
    grasps: Annotated[tuple[Literal["weld", "contact"], ...], Field(min_length=1)] = ("contact",)
    held_at_the_end: bool = False
    things: Annotated[Mapping[Name, Role], Field(min_length=1)]
    regions: Annotated[Mapping[Name, Region], Field(exclude_if=lambda regions: not regions)] = Field(
        default_factory=dict
    )
    table_area: Annotated[TableArea | None, Field(exclude_if=lambda area: area is None)] = None
    starts: Mapping[Name, ObjectStartRanges]
    arrangements: tuple[Arrangement, ...] = ()
    phrasings: Phrasings
    language_task: str = ""
    goal: Goal
    near_misses: tuple[NearMiss, ...] = ()
    expert: Annotated[tuple[Mapping[str, Any], ...], Field(min_length=1)]
    timing: ProgramTiming = ProgramTiming()
    time_limit_s: Annotated[FiniteFloat, QuantityBounds("s", 0.1, 3600)] = 120.0
    start_joints: tuple[JointAngle, ...] | None = None

    @model_validator(mode="after")
    def _roles_are_there(self, info: ValidationInfo) -> ProgramTask:
        if TABLE in self.things:
            raise ConflictError(f"a role cannot have the name {TABLE!r} of the work surface", ("things", TABLE))
        for role in self.starts:
            if role not in self.things:
                raise ConflictError(f"unknown role {role!r}; {suggest_similar(role, self.things)}", ("starts", role))
        for role in self.things:
            if role not in self.starts:
                raise ConflictError(f"the {role} has no start region; add it to `starts`", ("starts",))
        placed = {TABLE}
        for role, start in self.starts.items():
            if start.on not in placed:
                valid = suggest_similar(start.on, placed)
                raise ConflictError(f"{start.on!r} is not listed before the {role}; {valid}", ("starts", role, "on"))
            placed.add(role)
        things = {*self.things, *(name for role in self.things for name in self._numbered_names(role))}
        for k, miss in enumerate(self.near_misses):
            if miss.thing not in things:
                raise ConflictError(
                    f"unknown role {miss.thing!r}; {suggest_similar(miss.thing, self.things)}",
                    ("near_misses", k, "thing"),
                )
        for path, predicate in self.goal.predicates():
            for argument, role in predicate.roles():
                where = ("goal", *path, *argument.split("."))
                if role not in (known := {*things, *self.regions, TABLE}):
                    raise ConflictError(f"unknown role {role!r}; {suggest_similar(role, known)}", where)
                # Earlier versions recorded goals that name the table where it has no effect.
                if isinstance(predicate, Contains) or not is_recorded_config(info):
                    self.check_argument(predicate, argument, role, where)
                if predicate.JUDGES_CLOTH and not self.may_be_cloth(role):
                    raise ConflictError(f"the {role} is not cloth; give a role of cloth", where)
        return self

    def check_argument(self, owner: ArgumentOwner, argument: str, role: str, where: tuple[str | int, ...]) -> None:
        """Raise ConflictError with the path `where` if `role` is the table or a region, and the argument cannot be."""
        first = argument.partition(".")[0]
        if role == TABLE and first not in owner.TABLE_ARGUMENTS:
            raise ConflictError(f"`{argument}` cannot be the table; give a role of objects", where)
        if role in self.regions and first not in owner.REGION_ARGUMENTS:
            raise ConflictError(f"`{argument}` cannot be the region {role}; give a role of objects", where)

    @model_validator(mode="after")
    def _regions_are_parts_of_objects(self) -> ProgramTask:
        things = {*self.things, *itertools.chain.from_iterable(map(self._numbered_names, self.things))}
        names = {TABLE, *things, *itertools.chain.from_iterable(map(self.possible_names, self.things))}
        for name, region in self.regions.items():
            where = ("regions", name, "of")
            if name in names:
                raise ConflictError(f"{name!r} is the name of an object too; rename the region", ("regions", name))
            if region.of not in things:
                raise ConflictError(f"unknown role {region.of!r}; {suggest_similar(region.of, things)}", where)
            if len(self.typical_roles.objects_of(region.of)) > 1:
                some = ", ".join(self._numbered_names(region.of))
                raise ConflictError(f"several objects have the role {region.of}; give one of {some}", where)
            if self.things[self.role_of(region.of)].sizes:
                fault = f"the {region.of} has `sizes`, but a region has one size; remove one of the two"
                raise ConflictError(fault, where)
        return self

    @model_validator(mode="after")
    def _weighed_pieces_are_there(self) -> ProgramTask:
        for path, predicate in self.goal.predicates():
            if isinstance(predicate, Contains):
                where, role = ("goal", *path), self.things[self.role_of(predicate.pieces_of)]
                if role.filled is None:
                    raise ConflictError(
                        f"the {predicate.pieces_of} has no loose pieces; add `filled` to the role, or give another one",
                        (*where, "pieces_of"),
                    )
                count = len(self.typical_roles.objects_of(predicate.pieces_of))
                if predicate.least_g > (total := role.filled.grams * count):
                    raise ConflictError(
                        f"{predicate.least_g:g} g are more than the {total:g} g of pieces; give less",
                        (*where, "least_g"),
                    )
        return self

    @model_validator(mode="after")
    def _arrangements_are_complete(self) -> ProgramTask:
        names = {name for role in self.things for name in self._numbered_names(role)}
        for k, arrangement in enumerate(self.arrangements):
            if others := names ^ set(arrangement.places):
                raise ConflictError(
                    f"must have a place for each of {', '.join(sorted(names))}; wrong: {sorted(others)[0]!r}",
                    ("arrangements", k, "places"),
                )
        return self

    @model_validator(mode="after")
    def _cloth_starts_as_cloth_can(self) -> ProgramTask:
        for role, start in self.starts.items():
            if self.may_be_cloth(role) and set(start.attitudes) != {"upright"}:
                raise ConflictError(
                    f"the {role} is cloth, which starts flat or `crumpled`; remove `attitudes`",
                    ("starts", role, "attitudes"),
                )
            if start.crumpled is not None and not self.may_be_cloth(role):
                raise ConflictError(
                    f"the {role} is not cloth and cannot crumple; remove `crumpled`", ("starts", role, "crumpled")
                )
            if self.may_be_cloth(start.on):
                raise ConflictError(f"the {role} cannot start on cloth, the {start.on}", ("starts", role, "on"))
        return self

    @model_validator(mode="after")
    def _names_are_unique(self) -> ProgramTask:
        known: dict[str, ObjectConfig] = {}
        for role, played in self.things.items():
            for k, item in enumerate(played.of):
                if known.setdefault(item.name, item) != item:
                    raise ConflictError(f"two different objects have the name {item.name!r}", ("things", role, "of", k))
        by_role = [role for role, played in self.things.items() if played.named == "role"]
        used = {name: role for role in by_role for name in self._numbered_names(role)} | {TABLE: TABLE}
        for role, played in self.things.items():
            for k, item in enumerate(() if role in by_role else played.of):
                if (other := used.setdefault(item.name, role)) != role:
                    raise ConflictError(
                        f"the {role} and the {other} can both have the name {item.name!r}; give the two different "
                        "objects, or leave `named` out",
                        ("things", role, "named"),
                        ("things", role, "of", k),
                        ("things", other, "of"),
                    )
        return self

    @model_validator(mode="after")
    def _placeholders_are_known(self, info: ValidationInfo) -> ProgramTask:
        known = self._placeholder_texts(self.typical_roles)
        texts: dict[tuple[str | int, ...], str] = {("language_task",): self.language_task}
        for key in ("training", "held_out"):
            texts |= {("phrasings", key, k): text for k, text in enumerate(getattr(self.phrasings, key))}
        for path, text in () if is_recorded_config(info) else texts.items():
            for word in _PLACEHOLDER.findall(text):
                if word not in known:
                    raise ConflictError(
                        f"unknown placeholder {{{word}}}; valid: {', '.join(f'{{{name}}}' for name in sorted(known))}",
                        path,
                    )
        return self

    @model_validator(mode="after")
    def _open_parts_exist(self) -> ProgramTask:
        for role, start in self.starts.items():
            for item in self.things[role].of:
                names = [link.name for link in item.links]
                for part, (low, high) in start.open.items():
                    if part not in names:
                        raise ConflictError(
                            f"the {item.name} has no part {part!r}; {suggest_similar(part, names)}",
                            ("starts", role, "open", part),
                        )
                    if low > high:
                        raise ConflictError(
                            f"a range is [low, high], so {low} must not be above {high}", ("starts", role, "open", part)
                        )
        return self

    def may_be_cloth(self, name: str) -> bool:
        """Return whether the role or the object called `name` may be cloth."""
        names = {thing: role for role in self.things for thing in (role, *self.possible_names(role))}
        return name in names and any(item.cloth is not None for item in self.things[names[name]].of)

    @property
    def objects(self) -> tuple[ObjectConfig, ...]:
        """All object configs of all roles in the order of `things`, each once."""
        return tuple({item.name: item for role in self.things.values() for item in role.of}.values())

    @property
    def language_prompt(self) -> str:
        """The first training instruction, with the first object config of each role as its placeholders' values."""
        return _replace_placeholders(
            self.phrasings.training[0], _without_underscores(self._placeholder_texts(self.typical_roles))
        )

    @property
    def valid_grasps(self) -> tuple[GraspKind, ...]:
        """The grasps that the task supports, the default first."""
        return ("cloth_constraint",) if any(item.cloth for item in self.objects) else self.grasps

    @property
    def target_predicate(self) -> On | None:
        """The goal's first predicate `on` with a radius, which measures the distance from the target; None if none."""
        return next((on for _, on in self._on_predicates_with_radius()), None)

    @property
    def radius_path(self) -> tuple[str | int, ...]:
        """Key path of the radius of `target_predicate`, relative to the task.

        Raises ConflictError if the goal has no `on` with a radius.
        """
        for path, _ in self._on_predicates_with_radius():
            return ("goal", *path, "radius")
        raise ConflictError(
            f"task {self.name!r} has no `on` with a `radius` in its goal, so it has no threshold", ("goal",)
        )

    def _on_predicates_with_radius(self) -> Iterator[tuple[tuple[str | int, ...], On]]:
        for path, predicate in self.goal.predicates():
            if isinstance(predicate, On) and predicate.radius is not None:
                yield path, predicate

    @property
    def max_ticks(self) -> int:
        """The time limit in control ticks."""
        return math.ceil(self.time_limit_s / self.timing.tick_seconds)

    @property
    def hold_ticks(self) -> int:
        """The hold time of the goal in control ticks."""
        return math.ceil(self.goal.for_s / self.timing.tick_seconds)

    @property
    def typical_roles(self) -> RoleAssignment:
        """The role assignment with the first object configs of each role, for uses before any sampling."""
        return self.assign_roles(
            {role: tuple(k % len(one.of) for k in range(one.count)) for role, one in self.things.items()}
        )

    def assign_roles(
        self, drawn: Mapping[str, tuple[int, ...]], sizes: Mapping[str, float] | None = None
    ) -> RoleAssignment:
        """Return the role assignment of sampled object configs.

        Args:
            drawn: role -> indices in `of` of its objects' configs.
            sizes: object -> scale factor of its lengths.
        """
        kinds = {
            name: self.things[role].of[k].name
            for role, numbers in drawn.items()
            for name, k in zip(self.object_names_of(role, numbers), numbers, strict=True)
        }
        return RoleAssignment(
            {role: self.object_names_of(role, numbers) for role, numbers in drawn.items()}, kinds, sizes or {}
        )

    def object_names_of(self, role: str, drawn: tuple[int, ...]) -> tuple[str, ...]:
        """Return the names of a role's objects, given the indices in `of` of their configs.

        An object has the name of its config or its role; several objects of a role are numbered from 1.
        """
        one = self.things[role]
        return self._numbered_names(role) if one.named == "role" else tuple(one.of[k].name for k in drawn)

    def possible_names(self, role: str) -> tuple[str, ...]:
        """Return all possible names of a role's objects."""
        one = self.things[role]
        return self._numbered_names(role) if one.named == "role" else tuple(item.name for item in one.of)

    def role_of(self, name: str) -> str:
        """Return the role of an object called `name`; for a role, the role. Raise KeyError if unknown."""
        for role in self.things:
            if name in (role, *self.possible_names(role)):
                return role
        raise KeyError(name)

    def possible_objects(self, name: str) -> tuple[ObjectConfig, ...]:
        """Return the object configs of a role, or of an object's role. Raise KeyError if unknown."""
        return self.things[self.role_of(name)].of

    def _numbered_names(self, role: str) -> tuple[str, ...]:
        count = self.things[role].count
        return (role,) if count == 1 else tuple(f"{role}_{k + 1}" for k in range(count))

    def _placeholder_texts(self, roles: RoleAssignment) -> dict[str, str]:
        words = {"first_arm": "right", "second_arm": "left"}
        for role, one in self.things.items():
            if one.count == 1:
                kind = roles.config_names[roles.object_of(role)]
                words[role] = kind
                words[f"{role}.preposition"] = next(item.preposition for item in one.of if item.name == kind)
        return words

    def with_side_words(self, first: str, second: str) -> ProgramTask:
        """Return the task with the sides of its arms, "left" or "right", in its phrasings and its name."""
        words = {"first_arm": first, "second_arm": second}
        return self._fill_placeholders(words, words)

    def _fill_placeholders(self, prompt_words: Mapping[str, str], name_words: Mapping[str, str]) -> ProgramTask:
        phrasings = self.phrasings.map_instructions(lambda text: _replace_placeholders(text, prompt_words))
        return self.model_copy(
            update={"phrasings": phrasings, "language_task": _replace_placeholders(self.language_task, name_words)}
        )

    def with_objects_of(self, roles: RoleAssignment) -> ProgramTask:
        """Return the task with only the objects of a role assignment, scaled and named as assigned."""
        words = self._placeholder_texts(roles)
        things = {}
        for role, one in self.things.items():
            kinds = {item.name: item for item in one.of}
            items = tuple(
                kinds[roles.config_names[name]].scaled(roles.scale_factors.get(name, 1.0)).with_name(name)
                for name in roles.objects_of(role)
            )
            things[role] = one.model_copy(update={"of": items})
        return self._fill_placeholders(_without_underscores(words), words).model_copy(update={"things": things})


def _replace_placeholders(text: str, words: Mapping[str, str]) -> str:
    return _PLACEHOLDER.sub(lambda found: words.get(found[1], found[0]), text)


def _without_underscores(words: Mapping[str, str]) -> dict[str, str]:
    return {name: word.replace("_", " ") for name, word in words.items()}
