"""Certify an object by all checks in order."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from yamsim_cli.core.config.objects.object_config import ObjectConfig
from yamsim_cli.core.files.resources import Locations

from . import grasp_check as grasp
from . import physics_checks as physics
from . import static_checks as static
from .check_outcome import CheckOutcome, skipped_outcome
from .static_checks import collision_kinds
from .tested_object import TestedObject, read_tested_object

# Called with the completed checks, their total, and the next check's code.
CheckProgress = Callable[[int, int, str], None]


@dataclass(frozen=True)
class ObjectCheck:
    """One check of a certificate.

    Attributes:
        code: `<subject>.<fault>`, stable across versions.
        title: the fault, as a clause.
        advice: how to correct the fault.
        needs: earlier checks; if one failed, this check is skipped.
    """

    code: str
    title: str
    advice: str
    run_check: Callable[[TestedObject], CheckOutcome]
    needed_checks: tuple[str, ...] = ()


_SURFACE_CHECKS = ("size.implausible", "mesh.open", "mesh.inverted")
_MASS_CHECKS = ("size.implausible", "mass.density", "mass.centre", "inertia.impossible")

_ALL_CHECKS = (
    ObjectCheck("size.implausible", "its size is not plausible for an object", "give the unit of its file",
               static.check_size),
    ObjectCheck("mesh.open", "a surface has holes", "close the holes in the program that made it", static.check_closed,
               _SURFACE_CHECKS[:1]),
    ObjectCheck("mesh.inverted", "a surface is inside out", "flip its faces in the program that made it",
               static.check_normals, _SURFACE_CHECKS[:2]),
    ObjectCheck("mass.density", "its density is not plausible", "give its mass in kg", static.check_density,
               _SURFACE_CHECKS),
    ObjectCheck("mass.centre", "its centre of mass is outside its surface", "correct `inertia.centre`, m",
               static.check_centre_of_mass, _SURFACE_CHECKS[:1]),
    ObjectCheck("inertia.impossible", "its moments of inertia are impossible", "import it without them, or correct "
               "`inertia.diagonal`, kg m2", static.check_inertia,
               ("size.implausible", "mass.density", "mass.centre")),
    ObjectCheck("collision.differs", "its collision parts differ from its visible surface",
               "import it with another `--collision`",
               static.check_collision_geometry, _SURFACE_CHECKS),
    ObjectCheck("rest.moves", "it does not come to rest", "flatten its underside, or give it rolling friction",
               physics.check_rest, _MASS_CHECKS),
    ObjectCheck("drop.breaks", "it falls through the ground, or physics breaks down", "thicken its collision parts",
               physics.check_drop, _MASS_CHECKS),
    ObjectCheck("hollow.filled", "a ball dropped into it does not stay in", "import it with `--collision decompose`",
               physics.check_hollow, (*_MASS_CHECKS, "mesh.open", "mesh.inverted")),
    ObjectCheck("joint.jams", "a joint does not move from limit to limit", "check what its parts touch on their way",
               physics.check_articulation, _MASS_CHECKS),
    ObjectCheck("grasp.slips", "a gripper cannot pick it up and hold it", "correct `grasp`, or leave it out",
               grasp.check_grasp, _MASS_CHECKS),
)  # fmt: skip

CHECKS: Mapping[str, ObjectCheck] = {check.code: check for check in _ALL_CHECKS}


@dataclass(frozen=True)
class CertificationResult:
    """The tested object, and each check's outcome by code."""

    subject: TestedObject
    outcomes: Mapping[str, CheckOutcome]

    @property
    def ok(self) -> bool:
        """Whether no check failed; some may have been skipped."""
        return not self.failed_codes

    @property
    def failed_codes(self) -> tuple[str, ...]:
        """Codes of the failed checks."""
        return tuple(code for code, outcome in self.outcomes.items() if outcome.ok is False)

    def to_json_data(self) -> dict[str, Any]:
        """Return JSON data, the same for the same object."""
        item = self.subject.item
        return {
            "ok": self.ok,
            "thing": item.name,
            "checks": [
                {"code": code, "ok": outcome.ok, "figures": dict(outcome.figures), "note": outcome.note}
                for code, outcome in self.outcomes.items()
            ],
            "mass_kg": round(item.inertia.mass + sum(link.inertia.mass for link in item.links), 6),
            "collision": {
                "kind": collision_kinds(item.collision),
                "parts": len(item.collision) + sum(len(link.collision) for link in item.links),
            },
        }


def run_object_checks(
    item: ObjectConfig,
    meshes: Mapping[str, Path | None],
    locations: Locations,
    progress: CheckProgress = lambda done, total, code: None,
) -> CertificationResult:
    """Run every check of an object.

    Args:
        meshes: mesh set -> folder; None skips the checks of visual surfaces.
        locations: config folders, with the rig that tests the grasp.
        progress: called before each check.

    Raises:
        ResourceError: the object cannot be read.
        UsageError: the object is cloth.
    """
    subject = read_tested_object(item, meshes, locations)
    outcomes: dict[str, CheckOutcome] = {}
    for number, (code, check) in enumerate(CHECKS.items()):
        progress(number, len(CHECKS), code)
        failed = [other for other in check.needed_checks if outcomes[other].ok is False]
        if failed:
            outcomes[code] = skipped_outcome(f"needs {', '.join(failed)} to pass first")
        else:
            outcomes[code] = check.run_check(subject)
    return CertificationResult(subject, outcomes)
