"""A small lock whose one archive is a real wheel of a few hundred bytes, so that no test needs the network."""

import hashlib
import io
import json
import zipfile
from dataclasses import dataclass
from pathlib import Path

import pytest

from yamsim_cli.core.files.resources import Locations
from yamsim_cli.core.scene.assets import AssetLock, AssetStore, load_lock

CONTENTS = {"part.stl": b"solid part", "tip.stl": b"solid tip"}


def sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def build_wheel(members: dict[str, bytes]) -> bytes:
    info = "tiny_meshes-1.0.dist-info"
    metadata = {
        f"{info}/METADATA": b"Metadata-Version: 2.1\nName: tiny-meshes\nVersion: 1.0\nRequires-Python: <3\n",
        f"{info}/WHEEL": b"Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
        f"{info}/RECORD": b"",
    }
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as wheel:
        for name, data in (members | metadata).items():
            wheel.writestr(zipfile.ZipInfo(name), data)
    return stream.getvalue()


@dataclass(frozen=True)
class AssetFixture:
    """A data root with a lock, an empty store, and a folder that pip can use as its package index."""

    locations: Locations
    index: Path
    raw: dict

    @property
    def lock(self) -> AssetLock:
        return load_lock(self.locations)

    @property
    def store(self) -> AssetStore:
        return AssetStore(self.locations.assets)

    def write_lock(self, raw: dict) -> None:
        (self.locations.data[0] / "assets/assets.lock.json").write_text(json.dumps(raw))


@pytest.fixture
def contents() -> dict[str, bytes]:
    return dict(CONTENTS)


@pytest.fixture
def world(tmp_path: Path) -> AssetFixture:
    wheel = build_wheel({f"tiny/{name}": data for name, data in CONTENTS.items()})
    file = "tiny_meshes-1.0-py3-none-any.whl"
    notices = tmp_path / "data/assets/notices"
    notices.mkdir(parents=True)
    (notices / "tiny.txt").write_text("do as you like\n")
    index = tmp_path / "index"
    index.mkdir()
    (index / file).write_bytes(wheel)
    tiny = {
        "name": "tiny",
        "license": "MIT",
        "attribution": "nobody",
        "notice": "tiny.txt",
        "archive": "tiny-meshes",
        "menagerie": "i2rt_yam",
        "files": {
            name: {"sha256": sha256(data), "size": len(data), "member": f"tiny/{name}"}
            for name, data in CONTENTS.items()
        },
    }
    archive = {"name": "tiny-meshes", "version": "1.0", "file": file, "sha256": sha256(wheel), "size": len(wheel)}
    raw = {"version": 1, "archives": {"tiny-meshes": archive}, "sets": {"tiny": tiny}}
    made = AssetFixture(Locations(data=(tmp_path / "data",), assets=tmp_path / "store"), index, raw)
    made.write_lock(raw)
    return made


@pytest.fixture
def local_pip(world: AssetFixture, monkeypatch: pytest.MonkeyPatch) -> None:
    """Point pip at the folder with the small wheel only."""
    for name in ("PIP_EXTRA_INDEX_URL", "PIP_INDEX_URL"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("PIP_CONFIG_FILE", "/dev/null")
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(world.index))
