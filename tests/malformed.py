"""Malformed files: more than 60, made from good ones of every format."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tests.drawers import MJCF, URDF, cabinet_sdf
from tests.mugs import write_mugs

BOMB = """<?xml version="1.0"?>
<!DOCTYPE b [<!ENTITY a "aaaaaaaaaa">{}]><{root}>&z;</{root}>"""
_LEVELS = "".join(f'<!ENTITY {b} "{f"&{a};" * 10}">' for a, b in zip("abcdefghi", "bcdefghiz", strict=True))
EXTERNAL = '<?xml version="1.0"?><!DOCTYPE b [<!ENTITY z SYSTEM "file:///etc/passwd">]><{root}>&z;</{root}>'


def malformed(folder: Path) -> Iterator[tuple[Path, str | None]]:
    """Files in a folder, each with its expected refusal code, or None for any."""
    good = {kind: path.read_bytes() for kind, path in write_mugs(folder, segments=16).items()}
    (folder / "mug.mtl").write_text("newmtl a\nmap_Kd ../../../../etc/passwd\n")
    yield from _cut(folder, good)
    yield from _counts(folder)
    yield from _xml(folder)
    yield from _references(folder)
    yield from _numbers(folder)
    yield from _flipped(folder, good)


def _put(folder: Path, name: str, data: bytes | str) -> Path:
    path = folder / name
    path.write_bytes(data if isinstance(data, bytes) else data.encode())
    return path


def _cut(folder: Path, good: dict[str, bytes]) -> Iterator[tuple[Path, str | None]]:
    texts = {"sdf": cabinet_sdf().encode(), "urdf": URDF.encode(), "xml": MJCF.encode()}
    for kind, data in {**good, **texts}.items():
        yield _put(folder, f"empty.{kind}", b""), None
        if kind != "obj":  # half an OBJ is an OBJ
            yield _put(folder, f"half.{kind}", data[: len(data) // 2]), "damaged"
        yield _put(folder, f"noise.{kind}", np.random.default_rng(1).bytes(5000)), None


def _counts(folder: Path) -> Iterator[tuple[Path, str | None]]:
    yield _put(folder, "huge_count.stl", bytes(80) + struct.pack("<I", 2**31) + bytes(500)), "damaged"
    header = "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\n"
    header += "property float z\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n"
    yield _put(folder, "huge_vertices.ply", header.format(10**11, 1) + "x" * 100), "damaged"
    yield _put(folder, "huge_faces.ply", header.format(3, 10**10) + "x" * 100), "too-many-faces"
    yield _put(folder, "negative.ply", header.format(-3, 1) + "x" * 100), "damaged"
    yield _put(folder, "lists.ply", header.format(1, 1) + "\0" * 12 + "\xff" * 3), None
    faces = "v 0 0 0\nv 1 0 0\nv 0 1 0\n" + "f 1 2 3\n" * 2_100_000
    yield _put(folder, "many_faces.obj", faces), "too-many-faces"
    yield _put(folder, "beyond.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 30\n"), None
    yield _put(folder, "points.obj", "v 0 0 0\nv 1 0 0\n"), None
    for name, change in {
        "accessor.gltf": {"accessors": [{"count": 10**12, "type": "VEC3", "componentType": 5126}]},
        "view.gltf": {"bufferViews": [{"buffer": 0, "byteLength": 10**9}]},
        "circle.gltf": {"nodes": [{"children": [1]}, {"children": [0], "mesh": 0}]},
        "buffer.gltf": {"buffers": [{"byteLength": 36, "uri": "../../../etc/passwd"}]},
        "remote.gltf": {"buffers": [{"byteLength": 36, "uri": "http://127.0.0.1:1/a.bin"}]},
        "types.gltf": {"accessors": {"count": "many"}},
        "mesh.gltf": {"meshes": [{"primitives": [{"attributes": {"POSITION": 77}}]}]},
    }.items():
        tree = {
            "asset": {"version": "2.0"},
            "scenes": [{"nodes": [0]}],
            "scene": 0,
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "accessors": [{"bufferView": 0, "count": 3, "type": "VEC3", "componentType": 5126}],
            "bufferViews": [{"buffer": 0, "byteLength": 36}],
            "buffers": [{"byteLength": 36, "uri": "data:application/octet-stream;base64," + "A" * 48}],
            **change,
        }
        yield _put(folder, name, json.dumps(tree)), None
    chunk = b'{"asset": {"version": "2.0"}}   '
    start = b"glTF" + struct.pack("<III", 2, 2**32 - 1, len(chunk))
    yield _put(folder, "length.glb", start + b"JSON" + chunk), "damaged"
    yield _put(folder, "deep.glb", _glb(b"[" * 200_000)), "damaged"


def _glb(text: bytes) -> bytes:
    return b"glTF" + struct.pack("<III", 2, 20 + len(text), len(text)) + b"JSON" + text


def _xml(folder: Path) -> Iterator[tuple[Path, str | None]]:
    for suffix, root in (("sdf", "sdf"), ("urdf", "robot"), ("xml", "mujoco"), ("dae", "COLLADA")):
        yield _put(folder, f"bomb.{suffix}", BOMB.format(_LEVELS, root=root)), "xml-entities"
        yield _put(folder, f"external.{suffix}", EXTERNAL.format(root=root)), "xml-entities"
    yield _put(folder, "deep.sdf", "<sdf>" * 5000 + "</sdf>" * 5000), None
    yield _put(folder, "other.sdf", "<html/>"), "damaged"


def _references(folder: Path) -> Iterator[tuple[Path, str | None]]:
    def model(uri: str) -> str:
        link = f'<link name="a"><visual name="v"><geometry><mesh><uri>{uri}</uri></mesh></geometry></visual></link>'
        return f'<sdf version="1.9"><model name="m">{link}</model></sdf>'

    (folder / "link_to_zero.obj").symlink_to("/dev/zero")
    for name, uri, code in (
        ("up", "../../../../etc/passwd", "outside"),
        ("absolute", "/etc/hostname", "outside"),
        ("scheme", "file:///etc/passwd", "outside"),
        ("web", "http://127.0.0.1:1/mug.obj", "outside"),
        ("gone", "no.obj", "missing"),
        ("itself", "ref_itself.sdf", "unknown-kind"),
        ("device", "link_to_zero.obj", "outside"),
    ):
        yield _put(folder, f"ref_{name}.sdf", model(uri)), code
    yield _put(folder, "includes.sdf", '<sdf version="1.9"><include><uri>includes.sdf</uri></include></sdf>'), "cycle"
    yield _put(folder, "includes.xml", '<mujoco><include file="includes.xml"/></mujoco>'), "cycle"
    passwd = '<asset><mesh name="a" file="/etc/passwd"/></asset>'
    yield _put(folder, "passwd.xml", f"<mujoco>{passwd}<worldbody/></mujoco>"), "outside"
    yield _put(folder, "plugin.xml", '<mujoco><extension><plugin plugin="a"/></extension></mujoco>'), "damaged"
    copies = '<worldbody><replicate count="100000000"><geom size="1"/></replicate></worldbody>'
    yield _put(folder, "copies.xml", f"<mujoco>{copies}</mujoco>"), "damaged"
    picture = '<asset><texture name="a" type="2d" builtin="flat" width="60000" height="60000"/></asset>'
    yield _put(folder, "picture.xml", f"<mujoco>{picture}<worldbody/></mujoco>"), "texture-too-large"
    (folder / "huge.png").write_bytes(huge_png())
    (folder / "huge.mtl").write_text("newmtl a\nmap_Kd huge.png\n")
    obj = "mtllib huge.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n"
    yield _put(folder, "huge_picture.obj", obj), "texture-too-large"
    yield _put(folder, "outside.obj", obj.replace("huge.mtl", "mug.mtl")), "outside"


def huge_png() -> bytes:
    """A picture of 60,000 x 60,000 pixels in a few hundred bytes."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", 60_000, 60_000, 8, 2, 0, 0, 0)
    data = zlib.compress(bytes(100_000))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", data) + chunk(b"IEND", b"")


def _numbers(folder: Path) -> Iterator[tuple[Path, str | None]]:
    corner = struct.pack("<3f", float("nan"), 0, 0) * 4 + b"\0\0"
    yield _put(folder, "nan.stl", bytes(80) + struct.pack("<I", 2) + corner * 2), "no-numbers"
    yield _put(folder, "nan.obj", "v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"), "no-numbers"
    text = cabinet_sdf()
    yield _put(folder, "nan.sdf", text.replace("0 0 0.012 0 0 0", "nan 0 0.012 0 0 0")), "no-numbers"
    yield _put(folder, "word.sdf", text.replace("0 0 0.012 0 0 0", "left 0 0.012 0 0 0")), "damaged"
    yield _put(folder, "heavy.sdf", text.replace("<mass>3<", "<mass>3e9<")), "impossible"
    yield _put(folder, "negative.sdf", text.replace("<mass>3<", "<mass>-3<")), "impossible"
    yield _put(folder, "ball.sdf", text.replace('type="prismatic"', 'type="ball"')), "joint-kind"
    yield _put(folder, "jammed.sdf", text.replace("<upper>0.1<", "<upper>-0.1<")), "impossible"
    apart = text.replace('<joint name="slide" type="prismatic">', "<a>").replace("</joint>", "</a>")
    yield _put(folder, "apart.sdf", apart), "several-things"
    loop = URDF.replace(
        "</robot>", '<joint name="b" type="fixed"><parent link="lid"/><child link="jar"/></joint></robot>'
    )
    yield _put(folder, "loop.urdf", loop), "cycle"


def _flipped(folder: Path, good: dict[str, bytes]) -> Iterator[tuple[Path, str | None]]:
    """Good files with some changed bytes: read or refused, but never worse."""
    rng = np.random.default_rng(2)
    for kind, data in good.items():
        for number in range(3):
            spoilt = np.frombuffer(data, np.uint8).copy()
            places = rng.integers(0, min(len(spoilt), 4000), 12)
            spoilt[places] = rng.integers(0, 256, 12)
            yield _put(folder, f"flipped_{number}.{kind}", spoilt.tobytes()), None
