"""The geoms of a scene on a page."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

pytest.importorskip("viser", reason="yamsim[view] is not installed")

from yamsim_cli.viewers.page_address import PageAddress
from yamsim_cli.viewers.scene_nodes import add_bodies
from yamsim_cli.viewers.scene_page import serve_page

GEOMS = {
    "sphere": "0.1",
    "ellipsoid": "0.1 0.2 0.3",
    "capsule": "0.1 0.2",
    "cylinder": "0.1 0.2",
    "box": "0.1 0.2 0.3",
    "plane": "1 1 0.1",
}


def test_every_type_of_geom_is_shown() -> None:
    geoms = "".join(f'<geom name="{kind}" type="{kind}" size="{size}"/>' for kind, size in GEOMS.items())
    meshes = "".join(f'<geom name="{kind}" type="{kind}" mesh="cube"/>' for kind in ("mesh", "sdf"))
    corners = " ".join(f"{x} {y} {z}" for x in (0, 1) for y in (0, 1) for z in (0, 1))
    cube = f'<asset><mesh name="cube" vertex="{corners}"/></asset>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco>{cube}<worldbody>{geoms}{meshes}</worldbody></mujoco>")
    server = serve_page(PageAddress(), "test")
    try:
        nodes = add_bodies(server.scene, model)
        assert (list(nodes.frames), nodes.colliders) == ([0], ())
        shown = [server.scene.get_handle_by_name(f"/world/look/{model.geom(k).name}") for k in range(model.ngeom)]
        assert None not in shown
        ball: Any = server.scene.get_handle_by_name("/world/look/ellipsoid")
        assert np.allclose(np.abs(ball.vertices).max(axis=0), (0.1, 0.2, 0.3), atol=1e-3)
    finally:
        server.stop()
