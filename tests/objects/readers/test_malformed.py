"""Malformed object files are refused with a code and a sentence, and nothing worse."""

from __future__ import annotations

import os
import re
import time
from pathlib import Path

import pytest

from tests.malformed import malformed
from tests.mugs import has_import_extra
from yamsim_cli.core.errors import ResourceError, YamsimError
from yamsim_cli.core.files.untrusted.confined_folder import ConfinedFolder
from yamsim_cli.core.files.untrusted.refusals import REFUSAL_CODES, RefusedError
from yamsim_cli.objects.readers.object_reader import UnitOptions, read_object
from yamsim_cli.objects.readers.reader_process import read_file

pytestmark = pytest.mark.skipif(not has_import_extra(), reason="needs the extra: pip install 'yamsim[import]'")

# s, longest time for any of them. The reader gives up earlier by itself; a busy machine may add to that.
LIMIT = 120


@pytest.mark.long
@pytest.mark.slow
def test_no_malformed_file_hangs_crashes_or_shows_a_traceback(tmp_path: Path) -> None:
    seen = 0
    for path, code in malformed(tmp_path):
        start = time.monotonic()
        try:
            read_object(path, UnitOptions("m", "z"))
            found = None
        except YamsimError as error:
            said = str(error)
            found = re.search(r"\[([a-z-]+)\]$", said)
            assert found is not None, f"{path.name}: {said}"
            assert found[1] in REFUSAL_CODES and "\n" not in said, f"{path.name}: {said}"
            assert found[1] not in ("crashed", "too-slow"), f"{path.name}: {said}"
        assert time.monotonic() - start < LIMIT, path.name
        if code is not None:
            assert found is not None and found[1] == code, f"{path.name}: {found and found[1]}, not {code}"
        seen += 1
    assert seen >= 60


@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("bomb.sdf", "xml-entities"),
        ("external.xml", "xml-entities"),
        ("ref_up.sdf", "outside"),
        ("ref_device.sdf", "outside"),
        ("includes.sdf", "cycle"),
        ("includes.xml", "cycle"),
        ("passwd.xml", "outside"),
        ("huge_picture.obj", "texture-too-large"),
        ("huge_count.stl", "damaged"),
        ("huge_faces.ply", "too-many-faces"),
        ("nan.obj", "no-numbers"),
        ("jammed.sdf", "impossible"),
        ("loop.urdf", "cycle"),
        ("apart.sdf", "several-things"),
    ],
)
def test_each_kind_of_trap_has_its_code(name: str, code: str, traps: dict[str, Path]) -> None:
    with pytest.raises(RefusedError) as caught:
        read_file(traps[name], traps[name].parent)
    assert caught.value.code == code


@pytest.fixture(scope="module")
def traps(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return {path.name: path for path, _ in malformed(tmp_path_factory.mktemp("traps"))}


def test_a_pipe_is_never_opened(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.obj")
    with pytest.raises(ResourceError, match=r"not a regular file \[not-a-file\]"):
        read_object(tmp_path / "pipe.obj", UnitOptions("m", "z"))
    with pytest.raises(RefusedError) as caught:
        ConfinedFolder(tmp_path).read("pipe.obj")
    assert caught.value.code == "not-a-file"


def test_a_folder_gives_out_what_lies_in_it(tmp_path: Path) -> None:
    inside = tmp_path / "mug"
    (inside / "meshes").mkdir(parents=True)
    (inside / "meshes" / "a b.obj").write_text("x")
    (tmp_path / "secret").write_text("s")
    (inside / "way_out").symlink_to(tmp_path / "secret")
    folder = ConfinedFolder(inside)
    for name in ("meshes/a b.obj", "meshes/a%20b.obj", "model://mug/meshes/a b.obj", "package://any/meshes/a b.obj"):
        assert folder.read(name) == b"x"
    for name in ("../secret", "way_out", str(tmp_path / "secret"), "file:///etc/passwd", "http://a/b", "a\0b"):
        with pytest.raises(RefusedError) as caught:
            folder.read(name)
        assert caught.value.code == "outside"
