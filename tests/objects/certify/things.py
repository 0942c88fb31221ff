"""Valid objects, and ways to damage one property."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from yamsim_cli.core.config.loader import parse_config
from yamsim_cli.core.config.objects.generated import generated_mesh_files, object_from_shape
from yamsim_cli.core.config.objects.object_config import ObjectConfig
from yamsim_cli.core.files.documents.yaml_document import dump_yaml, load_yaml
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.geometry.stl import Faces, decode_stl, encode_stl

SET = "own-thing-000000000000"


@dataclass
class SampleObject:
    """A kitchen object with its mesh in a folder, as an imported one: everything can be changed.

    Attributes:
        data: its config, as plain data.
        vertices, faces: of its body.
    """

    data: dict[str, Any]
    vertices: np.ndarray
    faces: Faces

    @classmethod
    def of(cls, name: str, locations: Locations) -> SampleObject:
        """A kitchen object of one material."""
        data = load_yaml(locations.config_file("objects", name)).data
        shape = ObjectConfig.read_document(locations.config_file("objects", name)).data
        config = parse_config(ObjectConfig, dump_yaml(shape), "test", locations)
        assert config.shape is not None
        files = generated_mesh_files(config.name, config.shape)
        vertices, faces = decode_stl(files[config.mesh.file])
        made = {"name": data["name"]} | object_from_shape(config.name, config.shape)
        made["mesh"] = {**made["mesh"], "set": SET, "file": "body.stl"}
        made.pop("meshes", None)
        made.pop("grasp", None)
        return cls(made, vertices, faces)

    def written(self, folder: Path, locations: Locations) -> tuple[ObjectConfig, Mapping[str, Path | None]]:
        """Return its config and its mesh's folder."""
        (folder / "body.stl").write_bytes(encode_stl(self.vertices, self.faces))
        return parse_config(ObjectConfig, dump_yaml(self.data), "test", locations), {SET: folder}


def flap(jams: bool) -> dict[str, Any]:
    """A link: a lid that turns up from a block's top; with a finger behind its hinge it hits a `pin`."""
    return {
        "name": "flap",
        "position": [-0.035, 0.0, 0.083],
        "joint": {"type": "hinge", "axis": [0, -1, 0], "range": [0, 100], "damping": 0.005, "friction": 0.004},
        "inertia": {"mass_g": 40, "centre": [0.035, 0, 0.002], "diagonal": [2e-5, 2e-5, 4e-5], "quat": [1, 0, 0, 0]},
        "collision": [
            {"type": "box", "centre": [0.035, 0.0, 0.002], "half_size": [0.033, 0.033, 0.002]},
            # A finger that sticks out behind the hinge.
            *([{"type": "box", "centre": [-0.03, 0.0, 0.002], "half_size": [0.02, 0.005, 0.002]}] if jams else []),
        ],
    }


def pin() -> dict[str, Any]:
    """A link behind the block that moves by 4 mm: the finger of a flap hits it."""
    return {
        "name": "pin",
        "position": [-0.075, 0.0, 0.06],
        "joint": {"type": "slide", "axis": [0, 0, 1], "range": [-0.002, 0.002], "damping": 2.0, "friction": 1.0},
        "inertia": {"mass_g": 20, "diagonal": [5e-6, 5e-6, 5e-6], "quat": [1, 0, 0, 0]},
        "collision": [{"type": "box", "centre": [0, 0, 0], "half_size": [0.03, 0.006, 0.016]}],
    }
