"""A composed scene as files that any MuJoCo program reads: `scene.xml`, and all the files that it names."""

from __future__ import annotations

import io
import zipfile
from typing import Literal

import mujoco

from .classic import classic_xml

SCENE_FILE = "scene.xml"

# The oldest MuJoCo that can read a scene; all newer ones read it too.
Reader = Literal["3.3", "4"]

# The earliest date that a zip file can hold. A constant date makes the same scene give the same bytes.
_ZIP_DATE = (1980, 1, 1, 0, 0, 0)


def scene_files(spec: mujoco.MjSpec, model: mujoco.MjModel, reader: Reader = "3.3") -> dict[str, bytes]:
    """Relative path -> content of a scene's files; the same spec always gives the same bytes.

    Args:
        model: the compiled `spec`.

    Raises:
        UsageError: the scene holds something that `reader` does not know.
    """
    named = {mesh.file for mesh in spec.meshes} | {texture.file for texture in spec.textures}
    files = {name: data for name, data in sorted(spec.assets.items()) if name in named}
    text = classic_xml(spec, model) if reader == "3.3" else spec.to_xml()
    return {SCENE_FILE: text.encode(), **files}


def zip_bytes(files: dict[str, bytes], folder: str) -> bytes:
    """A zip file of `files` inside `folder`; the same files always give the same bytes."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            entry = zipfile.ZipInfo(f"{folder}/{name}", _ZIP_DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, data)
    return stream.getvalue()
