"""Objects with moving parts: drawers, lids, screw caps, ridges that hold them, and fixed bases."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np
import pytest
from pydantic import ValidationError

from yamsim_cli.core.config.objects.object_config import ObjectConfig
from yamsim_cli.core.scene.objects.object_joints import joint_transform
from yamsim_cli.core.scene.objects.scene_object import add_object
from yamsim_cli.viewers.show.scene_files import mujoco_3_3_xml

INERTIA = {"mass_g": 100, "diagonal": [1e-4, 1e-4, 1e-4], "quat": [1, 0, 0, 0]}
MESH = {"set": "none", "file": "a.stl", "origin": [0, 0, 0], "rgba": [1, 1, 1, 1]}


def thing(joint: dict[str, Any], *, base: str = "fixed", **link: Any) -> ObjectConfig:
    moving = {
        "name": "part",
        "position": [0.2, 0, 0.1],
        "joint": joint,
        "inertia": INERTIA,
        "collision": [{"type": "sphere", "centre": [0, 0, 0], "radius": 0.02}],
        **link,
    }
    return ObjectConfig.model_validate(
        {
            "name": "thing",
            "mesh": MESH,
            "inertia": {**INERTIA, "mass_g": 1000},
            "collision": [{"type": "box", "centre": [0, 0, 0], "half_size": [0.05, 0.05, 0.05]}],
            "rest_height": 0.05,
            "base": base,
            "links": [moving],
        }
    )


def world(item: ObjectConfig, *, floor: bool = False) -> tuple[mujoco.MjSpec, mujoco.MjModel, mujoco.MjData]:
    spec = mujoco.MjSpec()
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    if floor:
        spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1])
    add_object(spec, item, {})
    model = spec.compile()
    return spec, model, mujoco.MjData(model)


def pushed(model: mujoco.MjModel, data: mujoco.MjData, force: float, seconds: float) -> float:
    """Return the part's joint position after a force or torque along it."""
    joint = model.joint("thing_part")
    for _ in range(round(seconds / model.opt.timestep)):
        data.qfrc_applied[joint.dofadr[0]] = force
        mujoco.mj_step(model, data)
    return float(data.qpos[joint.qposadr[0]])


SLIDE = {"type": "slide", "axis": [1, 0, 0], "range": [0, 0.1], "damping": 2.0, "friction": 0.5}


def test_a_drawer_moves_between_its_stops_and_its_friction_holds_it() -> None:
    _, model, data = world(thing(SLIDE))
    assert pushed(model, data, 0.4, 0.5) == pytest.approx(0, abs=1e-3)
    assert pushed(model, data, 2.0, 2.0) == pytest.approx(0.1, abs=2e-3)
    assert pushed(model, data, -2.0, 2.0) == pytest.approx(0.0, abs=2e-3)


def test_a_fixed_base_stays_and_can_still_be_placed() -> None:
    _, model, data = world(thing(SLIDE), floor=True)
    data.qpos[:3] = 0.3, 0.1, 0.05
    pushed(model, data, 20.0, 5.0)
    assert data.qpos[:3] == pytest.approx([0.3, 0.1, 0.05], abs=1e-4)
    _, model, data = world(thing(SLIDE, base="free"))
    pushed(model, data, 0.0, 0.5)
    assert data.qpos[2] < -0.5  # nothing holds a free one


def test_a_hinge_is_told_in_degrees_and_starts_where_it_is_told() -> None:
    joint = {"type": "hinge", "axis": [0, 0, 2], "range": [-10, 90], "start": 30, "position": [-0.05, 0, 0]}
    item = thing(joint)
    _, model, data = world(item)
    assert model.joint("thing_part").range == pytest.approx(np.radians([-10, 90]))
    assert data.qpos[7] == pytest.approx(math.radians(30))
    mujoco.mj_forward(model, data)
    expected = item.links[0].T_in_parent @ joint_transform(item.links[0].joint, math.radians(30))
    assert data.body("thing_part").xpos - data.body("thing").xpos == pytest.approx(expected[:3, 3], abs=1e-9)


def test_a_screw_cap_rises_as_it_turns() -> None:
    _, model, data = world(thing({"type": "screw", "axis": [0, 0, 1], "range": [0, 1080], "pitch": 0.004,
                                  "damping": 0.001, "friction": 0.001}))  # fmt: skip
    mujoco.mj_forward(model, data)
    start = data.body("thing_part").xpos[2]
    turned = pushed(model, data, 0.02, 4.0)
    assert turned == pytest.approx(math.radians(1080), rel=0.05)
    assert data.body("thing_part").xpos[2] - start == pytest.approx(0.012, abs=1.5e-3)


def test_stiff_friction_holds_a_lid_that_would_creep() -> None:
    cap = {"type": "screw", "axis": [0, 0, 1], "range": [0, 1080], "pitch": 0.004, "friction": 0.5,
           "damping": 0.02, "armature": 2e-4}  # fmt: skip
    turned = {}
    for stiff in (False, True):
        _, model, data = world(thing({**cap, "stiff_friction": stiff}))
        model.opt.timestep = 1 / 480
        turned[stiff] = pushed(model, data, 0.4, 2.0)
    assert turned[True] < 0.02 and turned[False] > 10 * turned[True]
    assert "stiff_friction" not in thing(cap).model_dump_json()  # files of earlier versions stay the same
    with pytest.raises(ValidationError, match="`stiff_friction` needs `friction`"):
        thing({**cap, "friction": 0.0, "stiff_friction": True})


@pytest.mark.parametrize("kind", ["slide", "hinge"])
def test_a_ridge_gives_way_to_its_effort_and_no_less(kind: str) -> None:
    if kind == "slide":
        joint = {**SLIDE, "damping": 60.0, "friction": 0.0, "detents": [{"at": 0.02, "width": 0.01, "effort": 3.0}]}
    else:
        joint = {"type": "hinge", "axis": [0, 0, 1], "range": [0, 90], "damping": 0.05,
                 "detents": [{"at": 20, "width": 10, "effort": 0.3}]}  # fmt: skip
    effort = joint["detents"][0]["effort"]
    _, model, data = world(thing(joint))
    at, end = (0.02, 0.1) if kind == "slide" else (math.radians(20), math.radians(90))
    held = pushed(model, data, 0.85 * effort, 3.0)
    assert 0.7 * at < held < at
    assert pushed(model, data, 1.2 * effort, 4.0) > 0.97 * end
    assert pushed(model, data, -0.85 * effort, 4.0) > at  # it holds from the other side too


def test_handles_are_sites_with_z_into_them() -> None:
    handle = {"name": "bar", "position": [0.01, 0, 0], "approach": [2, 0, 0], "axis": [0.5, 0, 1], "opening": 0.01}
    item = thing(SLIDE, handles=[handle])
    _, model, data = world(item)
    mujoco.mj_forward(model, data)
    R = data.site("thing_part_bar").xmat.reshape(3, 3)
    assert R[:, 2] == pytest.approx([1, 0, 0], abs=1e-12) and R[:, 1] == pytest.approx([0, 0, 1], abs=1e-12)


@pytest.mark.parametrize(
    ("joint", "said"),
    [
        ({**SLIDE, "range": [0.1, 0.1]}, "must differ"),
        ({**SLIDE, "range": [0, 100]}, "is it in mm"),
        ({**SLIDE, "start": 0.2}, "lies outside its range"),
        ({**SLIDE, "pitch": 0.01}, "a screw joint needs `pitch`"),
        ({**SLIDE, "axis": [0, 0, 0]}, "length 0"),
        ({**SLIDE, "detents": [{"at": 0.2, "width": 0.01, "effort": 1}]}, "outside the range"),
    ],
)
def test_a_joint_that_cannot_be_is_refused(joint: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError, match=said):
        thing(joint)


def test_parts_name_parents_that_come_before() -> None:
    with pytest.raises(ValidationError, match="not a link listed before it"):
        thing(SLIDE, parent="door")


def test_older_mujoco_versions_read_joints_with_the_same_physics() -> None:
    joint = {**SLIDE, "detents": [{"at": 0.02, "width": 0.01, "effort": 1.0}]}
    spec, model, data = world(thing(joint))
    again = mujoco.MjModel.from_xml_string(mujoco_3_3_xml(spec, model))
    other = mujoco.MjData(again)
    assert pushed(model, data, 1.5, 1.0) == pushed(again, other, 1.5, 1.0)
    assert np.array_equal(data.qpos, other.qpos)
