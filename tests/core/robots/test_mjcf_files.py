"""Which files an arm's or a gripper's MJCF may name."""

from __future__ import annotations

import pytest

from yamsim_cli.core.errors import ConfigError
from yamsim_cli.core.robots.mjcf import parse
from yamsim_cli.core.robots.models import Mjcf


@pytest.mark.parametrize(
    "inside",
    [
        '<include file="../../../etc/hostname"/>',
        '<worldbody><body><include file="other.xml"/></body></worldbody>',
        '<asset><mesh file="/etc/hostname"/></asset>',
        '<asset><mesh file="set/../../../hostname.stl"/></asset>',
        '<asset><mesh file="..\\\\set\\\\a.stl"/></asset>',
        '<asset><mesh file="a.stl"/></asset>',
        '<asset><texture file="/etc/hostname" type="2d"/></asset>',
        '<asset><texture type="cube" fileright="/etc/hostname"/></asset>',
        '<asset><hfield file="/etc/hostname"/></asset>',
        '<asset><model file="/etc/hostname"/></asset>',
        '<asset><skin file="/etc/hostname"/></asset>',
        '<extension><plugin plugin="mujoco.sdf.gear"/></extension>',
        '<compiler meshdir="/etc"/>',
    ],
)
def test_an_mjcf_that_names_other_files_is_refused(inside: str) -> None:
    with pytest.raises(ConfigError, match=r"^arm.xml: .*(valid|leave it out|write what)"):
        parse(Mjcf(file="arm.xml", text=f"<mujoco>{inside}</mujoco>"))


def test_meshes_of_a_set_are_read() -> None:
    parse(Mjcf(file="arm.xml", text='<mujoco><asset><mesh file="i2rt_yam/base.stl"/></asset></mujoco>'))
