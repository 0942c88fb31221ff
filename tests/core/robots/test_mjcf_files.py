"""Files that the MJCF of an arm or gripper includes or names."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from tests.cli.run_cli import yamsim
from tests.made_up_robot import ARM, RIG, write_robot
from yamsim_cli.core.config.loader import load_config
from yamsim_cli.core.config.rig import RigConfig
from yamsim_cli.core.errors import ConfigError
from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.robots.mjcf import parse_mjcf
from yamsim_cli.core.robots.models import Mjcf


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The arm's folder, in data that the environment names."""
    write_robot(tmp_path / "data")
    monkeypatch.setenv("YAMSIM_DATA_DIR", str(tmp_path / "data"))
    return tmp_path / "data" / "robot_models" / ARM


def taken_out(folder: Path, start: str, end: str, file: str) -> None:
    """Move a part of the arm's MJCF into a separate file, and include it."""
    path = folder / "arm.xml"
    text = path.read_text()
    first, last = text.index(start), text.index(end) + len(end)
    path.write_text(f'{text[:first]}<include file="{file}"/>{text[last:]}')
    (folder / file).parent.mkdir(exist_ok=True)
    (folder / file).write_text(f"<mujocoinclude>{text[first:last]}</mujocoinclude>")


def checked(said: str, path: Path) -> None:
    done = yamsim("robots", "check", ARM)
    assert done.code == 3, done.err
    assert str(path) in done.err and said in done.err
    assert len(done.err.splitlines()) == 1
    # Lines of the expanded text are not lines of a file; invalid XML is reported with its own file.
    assert " line " not in done.err or "not valid XML" in said


def test_an_arm_with_includes_is_the_arm_in_one_file(folder: Path) -> None:
    whole = load_config(RigConfig, "rigs", RIG, Locations.from_environment(os.environ)).arms[0].robot
    taken_out(folder, "<default>\n    <default", "</default>\n  </default>", "classes.xml")
    taken_out(folder, "<actuator>", "</actuator>", "parts/drives.xml")
    taken_out(folder, '<body name="wrist_roll"', "</body>", "parts/wrist.xml")
    main, wrist = folder / "arm.xml", folder / "parts" / "wrist.xml"
    # Some drives stay in the main file, and the last body comes from another file.
    main.write_text(main.read_text().replace("</mujoco>", "<actuator/></mujoco>"))
    wrist.rename(folder / "parts" / "roll.xml")
    wrist.write_text('<mujoco><include file="roll.xml"/></mujoco>')
    found = load_config(RigConfig, "rigs", RIG, Locations.from_environment(os.environ)).arms[0].robot
    assert (found.joint_drives, found.joints, found.home) == (whole.joint_drives, whole.joints, whole.home)
    done = yamsim("robots", "check", ARM)
    assert done.code == 0, done.err


def test_repeated_sections_count_as_one(folder: Path) -> None:
    path = folder / "arm.xml"
    path.write_text(path.read_text().replace("<worldbody>", '<worldbody><site name="mark"/></worldbody><worldbody>'))
    path.write_text(path.read_text().replace("<actuator>", "<actuator/><actuator>"))
    done = yamsim("robots", "check", ARM)
    assert done.code == 0, done.err


def include(folder: Path, name: str) -> Path:
    path = folder / "arm.xml"
    path.write_text(path.read_text().replace("</mujoco>", f'<include file="{name}"/></mujoco>'))
    return path


@pytest.mark.parametrize("name", ["../beside.xml", "../../../../../../../../etc/hostname", "/etc/hostname", "link.xml"])
def test_an_include_that_leaves_the_folder_is_refused(folder: Path, name: str) -> None:
    (folder.parent / "beside.xml").write_text("<mujoco/>")
    (folder / "link.xml").symlink_to(folder.parent / "beside.xml")
    path = include(folder, name)
    checked(f"it names {name!r}, which is outside of its folder; an <include> names an MJCF below {folder}", path)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "'more.xml' is not in its folder"),
        ('<mujoco><include file="more.xml"/></mujoco>', "more.xml includes itself"),
        ('<mujoco><include file="arm.xml"/></mujoco>', "more.xml includes itself"),
        ('<mujoco><include file="../beside.xml"/></mujoco>', "'../beside.xml', which is outside of its folder"),
        ('<mujoco><asset><mesh file="/etc/hostname"/></asset></mujoco>', "a mesh names the file '/etc/hostname'"),
        ("<mujoco>", "more.xml: not valid XML"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><mujoco/>', "more.xml: declares a document type"),
        ('<mujoco><worldbody><geom class="nope"/></worldbody></mujoco>', "unknown default class name 'nope'"),
    ],
)
def test_a_faulty_include_is_refused_in_one_line(folder: Path, content: str | None, said: str) -> None:
    path = include(folder, "more.xml")
    (folder.parent / "beside.xml").write_text("<mujoco/>")
    if content is not None:
        (folder / "more.xml").write_text(content)
    checked(said, path)


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
    with pytest.raises(ConfigError, match=r"^arm.xml: .*(valid|leave it out|write its content)"):
        parse_mjcf(Mjcf(file="arm.xml", text=f"<mujoco>{inside}</mujoco>"))


def test_meshes_of_a_set_are_read() -> None:
    parse_mjcf(Mjcf(file="arm.xml", text='<mujoco><asset><mesh file="i2rt_yam/base.stl"/></asset></mujoco>'))
