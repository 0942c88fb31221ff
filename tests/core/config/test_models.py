import math
from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, TypeAdapter, ValidationError

from yamsim_cli.core.config.objects.object_config import Grasp, ObjectConfig
from yamsim_cli.core.config.program_task import ProgramTask
from yamsim_cli.core.config.recording import RecordConfig
from yamsim_cli.core.config.scene import FixedCamera, Table
from yamsim_cli.core.files.documents.config_base import Name, Quaternion, Range, Rgba


def models_in(model: BaseModel):
    yield model
    for _, value in model:
        for part in value if isinstance(value, tuple) else (value,):
            if isinstance(part, BaseModel):
                yield from models_in(part)


def changed(config: BaseModel, **changes) -> dict:
    return config.model_dump() | changes


def played(task: ProgramTask, role: str) -> ObjectConfig:
    """The first object that may play a role."""
    return task.things[role].of[0]


def test_nothing_in_a_config_can_be_changed(config):
    for model in models_in(config):
        for name in type(model).model_fields:
            with pytest.raises(ValidationError, match="frozen"):
                setattr(model, name, getattr(model, name))


def test_every_part_of_a_config_refuses_unknown_keys(config):
    for model in models_in(config):
        with pytest.raises(ValidationError, match="Extra inputs"):
            type(model).model_validate(model.model_dump() | {"unheard_of": 1})


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_no_number_of_a_config_may_be_infinite_or_none_at_all(config, bad):
    checked = 0
    for model in models_in(config):
        for name, value in model:
            if type(value) is float:
                with pytest.raises(ValidationError):
                    type(model).model_validate(model.model_dump() | {name: bad})
                checked += 1
    assert checked > 20


@pytest.mark.parametrize(
    "changes",
    [
        *({"seed": -1}, {"seed": 2**63}, {"episodes": 0}, {"episodes": 1_000_001}, {"workers": 0}, {"workers": 1025}),
        *({"grasp": "magic"}, {"wrist": "maybe"}, {"image": {"size_px": [15, 16], "jpeg_quality": 85}}),
        *({"image": {"size_px": [16, 4097], "jpeg_quality": 85}}, {"image": {"size_px": [16, 16], "jpeg_quality": 0}}),
        *({"render": {"multisamples": 3, "shadow_map_px": 0}}, {"render": {"multisamples": 4, "shadow_map_px": -1}}),
    ],
)
def test_values_out_of_range_are_refused(config, changes):
    with pytest.raises(ValidationError):
        RecordConfig.model_validate(changed(config, **changes))


@pytest.mark.parametrize(
    ("kind", "good", "bad"),
    [
        (Range, (1.0, 1.0), (1.0, 0.9)),
        (Rgba, (0.0, 1.0, 0.5, 1.0), (0.0, 1.0, 1.1, 1.0)),
        (Rgba, (0.0, 0.0, 0.0, 0.0), (-0.1, 0.0, 0.0, 0.0)),
        (Quaternion, (0.0, 0.0, 0.0, 2.0), (0.0, 0.0, 0.0, 0.0)),
        (Name, "right_2", "2right"),
        (Name, "A", ""),
        (Name, "a", "a/b"),
        (Name, "a", "a\n"),
    ],
)
def test_small_types_accept_and_refuse(kind, good, bad):
    adapter = TypeAdapter(kind)
    assert adapter.validate_python(good) == good
    with pytest.raises(ValidationError):
        adapter.validate_python(bad)


def test_settings_that_determine_the_data_exclude_counts_and_workers(config):
    data = config.data_config()
    assert set(data) == set(RecordConfig.model_fields) - {"episodes", "workers"}
    assert config.model_copy(update={"arm": "left"}).data_config() == data | {"arm": "left"}
    noted = {"meshes": {"ycb": "primitives"}}
    assert config.model_copy(update=noted).data_config() == data | noted
    other = RecordConfig.model_validate(changed(config, episodes=3, workers=7))
    assert other.data_config() == data
    assert RecordConfig.model_validate(changed(config, seed=config.seed + 1)).data_config() != data


def test_a_table_grows_only_where_it_does_not_cover():
    table = Table(position=(0.45, 0.0, -0.011), half_size=(0.30, 0.35, 0.01), rgba=(1, 1, 1, 1))
    assert table.covering((0.2, 0.7), (-0.3, 0.3)) == table
    grown = table.covering((0.2, 0.95), (-0.3, 0.3))
    assert grown.position == pytest.approx((0.55, 0.0, -0.011)) and grown.half_size == pytest.approx((0.4, 0.35, 0.01))


def test_a_camera_cannot_look_at_itself():
    with pytest.raises(ValidationError, match="same point"):
        FixedCamera(position=(1, 2, 3), look_at=(1, 2, 3), fovy_deg=50)


@given(
    st.tuples(*[st.floats(-1, 1)] * 3),
    st.floats(-360, 360),
    st.booleans(),
)
def test_the_pinch_frame_points_down_and_closes_along_the_axis(position, axis_deg, flipped):
    T = Grasp(position=position, axis_deg=axis_deg, opening=0.01).T_pinch_in_object(flipped)
    R = T[:3, :3]
    assert np.allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1)
    assert np.allclose(R[:, 2], [0, 0, -1])
    axis = [math.cos(math.radians(axis_deg)), math.sin(math.radians(axis_deg)), 0]
    assert np.allclose(R[:, 1], np.array(axis) * (-1 if flipped else 1), atol=1e-12)
    assert np.array_equal(T[:3, 3], position)


def covered(discs, points) -> bool:
    return all(any(math.dist(point, (x, y)) <= radius + 1e-9 for x, y, radius in discs) for point in points)


def around(centre, radius):
    turns = np.linspace(0, 2 * math.pi, 16)
    return [(centre[0] + radius * math.cos(turn), centre[1] + radius * math.sin(turn)) for turn in turns]


def test_the_footprint_knows_every_primitive(config):
    plain = played(config.task, "target").model_dump()
    parts = {
        "capsule": {"type": "capsule", "start": (0.1, 0, 0), "end": (0.1, 0.01, 0), "radius": 0.01},
        "cylinder": {"type": "cylinder", "centre": (0.2, 0.3, 0), "radius": 0.02, "half_height": 0.01},
        "ring": {"type": "ring", "inner": (0.01, 0.0), "outer": (0.03, 0.01), "thickness": 0.001, "segments": 8},
        "sphere": {"type": "sphere", "centre": (0.5, 0.5, 0), "radius": 0.02},
        "box": {"type": "box", "centre": (0.7, 0.7, 0), "half_size": (0.01, 0.035, 0.01), "yaw_deg": 30},
        "hull": {"type": "hull", "file": "a.stl", "low": (0.1, 0.1, 0), "high": (0.12, 0.14, 0.02)},
        "sdf": {"type": "sdf", "file": "a.stl", "low": (-0.1, 0.1, 0), "high": (-0.08, 0.14, 0.02)},
    }
    annotation = ObjectConfig.model_fields["collision"].annotation
    branches = get_args(get_args(get_args(annotation)[0])[0])
    assert {get_args(branch.model_fields["type"].annotation)[0] for branch in branches} == set(parts)
    for part in parts.values():
        assert ObjectConfig.model_validate(plain | {"collision": [part]}).footprint_discs
    whole = ObjectConfig.model_validate(plain | {"collision": list(parts.values())})
    assert covered(whole.footprint_discs, around((0.1, 0.01), 0.01) + around((0.2, 0.3), 0.02) + around((0, 0), 0.03))
    # The box's corners, rotated by 30 degrees.
    c, s = math.cos(math.radians(30)), math.sin(math.radians(30))
    corners = [(0.7 + c * x - s * y, 0.7 + s * x + c * y) for x in (-0.01, 0.01) for y in (-0.035, 0.035)]
    assert covered(whole.footprint_discs, corners)
