"""Every check of a certificate: a stable code, what is wrong where it fails, what to do, and what it builds on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from . import holding, hollow, joints, looks, matching, settling, weight
from .outcome import Outcome
from .subject import Subject


@dataclass(frozen=True)
class Check:
    """One check.

    Attributes:
        code: `<what>.<fault>`, stable across versions.
        title: what is wrong where it fails, as a clause.
        advice: what to do about it.
        needs: codes without which its figures mean nothing: where one of these fails, it is not made.
    """

    code: str
    title: str
    advice: str
    make: Callable[[Subject], Outcome]
    needs: tuple[str, ...] = ()


_HEAVY = ("size.implausible", "mass.density", "mass.centre", "inertia.impossible")

_ALL = (
    Check("size.implausible", "it is not as large as things are", "give the unit that its file is in", looks.size),
    Check("mesh.open", "a surface has holes", "close it in the program that made it", looks.closed,
          ("size.implausible",)),
    Check("mesh.inverted", "a surface is inside out", "turn its faces round where it was made", looks.normals,
          ("size.implausible", "mesh.open")),
    Check("mass.density", "nothing is so heavy, or so light", "give its mass in kg", weight.density,
          ("size.implausible", "mesh.open", "mesh.inverted")),
    Check("mass.centre", "its centre of mass is outside of it", "mend `inertia.centre`, m", weight.centre,
          ("size.implausible",)),
    Check("inertia.impossible", "no body has such moments of inertia", "leave them out when it is imported, or mend "
          "`inertia.diagonal`, kg m2", weight.inertia, ("size.implausible", "mass.density", "mass.centre")),
    Check("collision.differs", "what touches is not what is seen", "import it with another `--collision`",
          matching.collision, ("size.implausible", "mesh.open", "mesh.inverted")),
    Check("rest.moves", "it does not lie still", "flatten what it stands on, or give it rolling friction",
          settling.rest, _HEAVY),
    Check("drop.breaks", "it goes through the ground, or blows up", "thicken its collision parts", settling.drop,
          _HEAVY),
    Check("hollow.filled", "a ball dropped into it does not stay in", "import it with `--collision decompose`",
          hollow.ball, (*_HEAVY, "mesh.open", "mesh.inverted")),
    Check("joint.jams", "a joint does not move from stop to stop", "look what its parts touch on their way",
          joints.articulation, _HEAVY),
    Check("grasp.slips", "a hand does not take it from a table and hold it", "mend `grasp`, or leave it out",
          holding.grasp, _HEAVY),
)  # fmt: skip

CHECKS: Mapping[str, Check] = {check.code: check for check in _ALL}
