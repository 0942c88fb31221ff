"""Check that each lowdim frame is readable and has the expected keys, shapes and types."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ....correction_record import WHO
from ...errors import DatasetError
from ..lowdim import GRASP, SIMULATION_KEYS, flatten_frame, frame_array_shapes, load_frame, simulation_faults
from ..records import EpisodeRecord
from ..safe_unpickle import ForbiddenPickleError
from .problem import ProblemCollector

# Optional frame key -> example value with the required dtype and shape.
_OPTIONAL_FRAME_KEYS = {"K_wrist": np.zeros((3, 3), np.float32), WHO: 0}


@dataclass(frozen=True)
class ValueSpec:
    """Dtype and shape of an array, or the name of another Python type and ()."""

    kind: str
    shape: tuple[int, ...] = ()

    @classmethod
    def from_value(cls, value: Any) -> ValueSpec:
        """Return the spec of `value`."""
        if isinstance(value, np.ndarray):
            return cls(str(value.dtype), value.shape)
        return cls(type(value).__name__)

    def __str__(self) -> str:
        return f"{self.kind} {self.shape}" if self.shape else self.kind


def expected_specs(
    objects: Iterable[str],
    cameras: Iterable[str],
    arms: int,
    drives: int,
    joints: Mapping[str, Sequence[str]] | None = None,
    *,
    joint_actions: bool = False,
    cloths: Mapping[str, tuple[int, int]] | None = None,
) -> dict[str, ValueSpec]:
    """Return flat key, such as `intrinsics[camera]`, -> required spec in a frame that yamsim records.

    The arguments are fields of an `EpisodeRecord`.
    """
    float32 = str(np.dtype(np.float32))
    rows = frame_array_shapes(arms, drives, joint_actions=joint_actions)
    forms = {key: ValueSpec(float32, shape) for key, shape in rows.items()}
    forms |= {f"{name}_pose": ValueSpec(float32, (4, 4)) for name in objects}
    forms |= {f"{name}_joints": ValueSpec(float32, (len(names),)) for name, names in (joints or {}).items()}
    forms |= {f"{name}_points": ValueSpec(float32, (x * y, 3)) for name, (x, y) in (cloths or {}).items()}
    for camera in cameras:
        forms |= {
            f"intrinsics[{camera}]": ValueSpec(float32, (3, 3)),
            f"extrinsics[{camera}]": ValueSpec(float32, (4, 4)),
        }
    plain = {"timestamp": float, "magnet": bool, "language_task": str, "language_prompt": str}
    if cloths:
        plain[GRASP] = str
    forms.update((key, ValueSpec(kind.__name__)) for key, kind in plain.items())
    return forms if arms == 1 else forms | {"magnet": ValueSpec(str(np.dtype(np.bool_)), (arms,))}


def recorded_specs(record: EpisodeRecord) -> dict[str, ValueSpec]:
    """Return flat key -> spec of the frames of a recorded episode."""
    return expected_specs(
        record.objects,
        record.cameras,
        record.arms,
        record.drives,
        record.joints,
        joint_actions=record.joint_actions,
        cloths=record.cloths,
    )


def frame_faults(frame: Mapping[str, Any], forms: Mapping[str, ValueSpec]) -> list[str]:
    """Compare a decoded frame with `forms` (flat key -> required spec), and return one text per fault."""
    problems = ProblemCollector()
    LowdimChecks(forms, problems).check_frame_values(0, "", frame)
    return [problem.text for problem in problems.all_problems()]


class LowdimChecks:
    """Checks the lowdim frames of an episode one by one.

    Args:
        forms: flat key -> required spec; None requires the specs of the first frame.

    Attributes:
        frames: frame number -> frame, for readable frames.
        values: frame number -> flat key -> value, for values that match their spec and are finite.
    """

    def __init__(self, forms: Mapping[str, ValueSpec] | None, problems: ProblemCollector) -> None:
        self._forms = forms
        self._source = "" if forms is not None else ", as in the first frame"
        self._problems = problems
        self.frames: dict[int, dict[str, Any]] = {}
        self.values: dict[int, dict[str, Any]] = {}

    def check_file(self, number: int, name: str, data: bytes) -> bool:
        """Check the content `data` of a frame file `name`, and return whether the frame is readable."""
        try:
            frame = load_frame(data)
        except ForbiddenPickleError as error:
            self._problems.add("lowdim.forbidden", name, str(error))
            return False
        except DatasetError as error:
            self._problems.add("lowdim.damaged", name, str(error).removeprefix("not a valid pickle: "))
            return False
        self.check_frame_values(number, name, frame)
        return True

    def check_frame_values(self, number: int, name: str, frame: Mapping[str, Any]) -> None:
        """Check a decoded frame, and store its valid values in `values`."""
        # `SIMULATION_KEYS` are checked separately: their shapes differ in the last frame, and a frame may lack them.
        for fault in simulation_faults(frame):
            self._problems.add("lowdim.simulation", name, fault, about=fault.split()[0])
        entries = {key: value for key, value in flatten_frame(frame).items() if key not in SIMULATION_KEYS}
        forms = self._forms
        if forms is None:
            forms = self._forms = {key: ValueSpec.from_value(value) for key, value in entries.items()}
        self.frames[number] = dict(frame)
        self.values[number] = {
            key: value for key, value in entries.items() if self._is_valid(name, key, value, forms.get(key))
        }
        for key in forms.keys() - entries.keys():
            self._problems.add("lowdim.missing", name, key, ", ".join(forms), about=key)

    def _is_valid(self, name: str, key: str, value: Any, wanted: ValueSpec | None) -> bool:
        def add(code: str, found: object, valid: object) -> bool:
            self._problems.add(code, name, f"{key} is {found}", f"{valid}{self._source}" if valid else "", about=key)
            return False

        form = ValueSpec.from_value(value)
        if wanted is None:
            if key not in _OPTIONAL_FRAME_KEYS:
                self._problems.add("lowdim.unexpected", name, key, about=key)
                return False
            wanted = ValueSpec.from_value(_OPTIONAL_FRAME_KEYS[key])
        if form.kind != wanted.kind:
            return add("lowdim.type", form, wanted)
        if form.shape != wanted.shape:
            return add("lowdim.shape", form, wanted)
        if isinstance(value, np.ndarray | float) and not _is_finite(value):
            return add("lowdim.finite", np.array2string(np.asarray(value).ravel()[:8], precision=4), "finite numbers")
        return True


def _is_finite(value: Any) -> bool:
    array = np.asarray(value)
    return array.dtype.kind not in "fc" or bool(np.isfinite(array).all())
