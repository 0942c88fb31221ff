"""Nested includes of an MJCF are relative to the same folders as in MuJoCo."""

from __future__ import annotations

from pathlib import Path

import mujoco
import pytest

from yamsim_cli.core.files.untrusted.confined_folder import ConfinedFolder
from yamsim_cli.core.files.untrusted.refusals import RefusedError
from yamsim_cli.objects.readers.mjcf import read_mjcf

_MAIN = '<mujoco><include file="a/one.xml"/></mujoco>'
_BOX = '<mujoco><worldbody><body name="b"><geom type="box" size="{} 0.1 0.1" mass="1"/></body></worldbody></mujoco>'


def _files(root: Path, **files: str) -> Path:
    for name, text in ({"main.xml": _MAIN} | files).items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    return root / "main.xml"


@pytest.mark.parametrize(
    ("named", "there"),
    [
        ("a/b/two.xml", ["a/b/two.xml"]),  # Relative to the main file.
        ("b/two.xml", ["a/b/two.xml"]),  # Relative to the file that includes it.
        ("a/b/two.xml", ["a/b/two.xml", "a/a/b/two.xml"]),  # Both are there: the main file's counts.
        ("../two.xml", ["two.xml"]),
    ],
)
def test_a_nested_include_is_read_as_mujoco_reads_it(named: str, there: list[str], tmp_path: Path) -> None:
    files = {name: _BOX.format(0.1 + 0.1 * k) for k, name in enumerate(there)}
    main = _files(tmp_path, **{"a/one.xml": f'<mujoco><include file="{named}"/></mujoco>'}, **files)
    theirs = mujoco.MjModel.from_xml_path(str(main))
    thing = read_mjcf(main.read_bytes(), ConfinedFolder(tmp_path), tmp_path)
    widest = max(float(surface.vertices[:, 0].max()) for surface in thing.parts[0].looks)
    assert widest == pytest.approx(theirs.geom_size[0][0])


@pytest.mark.parametrize("named", ["../../outside.xml", "/etc/hostname", "a/one.xml"])
def test_a_nested_include_stays_in_the_folder(named: str, tmp_path: Path) -> None:
    (tmp_path / "outside.xml").write_text(_BOX.format(0.1))
    folder = tmp_path / "in"
    main = _files(folder, **{"a/one.xml": f'<mujoco><include file="{named}"/></mujoco>'})
    with pytest.raises(RefusedError) as caught:
        read_mjcf(main.read_bytes(), ConfinedFolder(folder), folder)
    assert caught.value.code == ("cycle" if named == "a/one.xml" else "outside")
