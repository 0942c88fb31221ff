"""Every code has its damage: one thing is spoiled in a whole dataset, and exactly that is reported."""

from __future__ import annotations

import builtins
import json
import os
import pickle
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.core.dataset.checks.sample import CAMERA, HEIGHT, OUTCOME, WIDTH, Episode, Sample, black, encode, picture
from yamsim_cli.core.dataset.checks.problem import CODES, Severity
from yamsim_cli.core.dataset.lowdim import dump_frame
from yamsim_cli.core.dataset.records import to_json
from yamsim_cli.core.files import sha256_bytes

IMAGE = f"rgb/{CAMERA}/000002.jpg"
FRAME = "lowdim/000002.pkl"
EP = "ep_000001"


@dataclass(frozen=True)
class Damage:
    """One thing spoiled: before the dataset is written, or after; and where and how it must be told."""

    code: str
    before: Callable[[Sample], object] | None = None
    after: Callable[[Path], object] | None = None
    episode: str = EP
    file: str = ""
    text: str = ""

    def __str__(self) -> str:
        return f"{self.code}-{self.text}"


def value(key: str, change: Callable[[Any], Any], k: int = 2) -> Callable[[Sample], None]:
    """Change what a frame of episode 1 holds under `key`, everything else fitting it."""

    def apply(sample: Sample) -> None:
        frame = sample.episodes[1].frames[k]
        outer, _, inner = key.removesuffix("]").partition("[")
        if inner:
            frame[outer] = frame[outer] | {inner: change(frame[outer][inner])}
        else:
            frame[outer] = change(frame[outer])

    return apply


def entry(row: int, column: int, number: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(matrix: np.ndarray) -> np.ndarray:
        matrix = matrix.copy()
        matrix[row, column] = number
        return matrix

    return change


def one(sample: Sample) -> Episode:
    return sample.episodes[1]


def joints(amount: float, joint: int, k: int = 2) -> Callable[[Sample], None]:
    """Move a joint of episode 1 in one frame, or set it where `amount` is beyond any stop."""

    def change(q: np.ndarray) -> np.ndarray:
        q = q.copy()
        q[joint] += amount
        return q

    return value("joints", change, k)


def image(data: bytes, k: int = 2) -> Callable[[Sample], None]:
    return lambda sample: one(sample).images[CAMERA].__setitem__(k, data)


def over(**changes: Any) -> Callable[[Sample], None]:
    return lambda sample: one(sample).over.update(changes)


def write(name: str, data: bytes) -> Callable[[Path], None]:
    def apply(path: Path) -> None:
        (path / name).parent.mkdir(parents=True, exist_ok=True)
        (path / name).write_bytes(data)

    return apply


def remove(name: str) -> Callable[[Path], None]:
    return lambda path: shutil.rmtree(path / name) if (path / name).is_dir() else (path / name).unlink()


def cut(name: str, keep: int) -> Callable[[Path], None]:
    return lambda path: (path / name).write_bytes((path / name).read_bytes()[:keep])


def flip(name: str, position: int) -> Callable[[Path], None]:
    def apply(path: Path) -> None:
        data = bytearray((path / name).read_bytes())
        data[position] ^= 0x01
        (path / name).write_bytes(data)

    return apply


def lines(change: Callable[[list[bytes]], list[bytes]]) -> Callable[[Path], None]:
    def apply(path: Path) -> None:
        file = path / "attempts.jsonl"
        file.write_bytes(b"".join(change(file.read_bytes().splitlines(keepends=True))))

    return apply


def manifest(change: Callable[[dict[str, Any]], object]) -> Callable[[Path], None]:
    def apply(path: Path) -> None:
        data = json.loads((path / "manifest.json").read_text())
        change(data)
        (path / "manifest.json").write_text(json.dumps(data))

    return apply


def rehash(name: str, data: bytes) -> Callable[[Path], None]:
    """Put a file into episode 1 and make every hash fit, as one who means harm would."""

    def apply(path: Path) -> None:
        (path / EP / name).write_bytes(data)
        record = json.loads((path / EP / "episode.json").read_text())
        record["files"][name] = sha256_bytes(data)
        text = json.dumps(record).encode()
        (path / EP / "episode.json").write_bytes(text)
        manifest(lambda m: m["episodes"][1].update(sha256=sha256_bytes(text)))(path)

    return apply


class Harm:
    def __reduce__(self) -> tuple[Any, ...]:
        return builtins.open, ("pwned", "w")


def copy_of_the_first(sample: Sample) -> None:
    sample.episodes[1].frames = sample.episodes[0].frames


def start_of_the_first(sample: Sample) -> None:
    sample.episodes[1].layout = sample.episodes[0].layout


def frozen(sample: Sample) -> None:
    one(sample).images[CAMERA][1:4] = [picture(1, 1)] * 3


def lists_more(sample: Sample) -> None:
    one(sample).over["files"] = {**one(sample).record.files, "depth/000000.png": "0" * 64}


def looks_away(sample: Sample) -> None:
    for frame in one(sample).frames:
        frame["extrinsics"] = {CAMERA: np.linalg.inv(frame["extrinsics"][CAMERA]).astype(np.float32)}


def another_size(sample: Sample) -> None:
    for frame in one(sample).frames:
        K = frame["intrinsics"][CAMERA].copy()
        K[:2] *= 2
        frame["intrinsics"] = {CAMERA: K}


def fewer(stream: str) -> Callable[[Path], None]:
    return remove(f"{EP}/{stream}/00000{5}.{'pkl' if stream == 'lowdim' else 'jpg'}")


def some_meshes(sample: Sample) -> None:
    """All episodes say what they show, and one shows something else."""
    for made in sample.episodes:
        made.over["meshes"] = {"i2rt_yam_crank": "full " + "0" * 64, "ycb": "reduced " + "0123456789" * 6 + "0123"}
    one(sample).over["meshes"]["ycb"] = "primitives"


PX = f"rgb/{CAMERA}"
DAMAGES = [
    Damage("config.missing", after=remove("config.yaml"), episode=""),
    Damage("config.damaged", after=write("config.yaml", b"rig: ["), episode="", file="config.yaml"),
    Damage(
        "config.damaged", after=write("config.yaml", b"rig: single\n"), episode="", file="config.yaml", text="missing"
    ),
    Damage("dataset.mixed", over(versions={"numpy": "2.1"}), episode="", text="numpy: 2 x 2.0; 1 x 2.1"),
    Damage(
        "dataset.mixed", over(meshes={"ycb": "primitives"}), episode="", text="meshes ycb: 2 x not told; 1 x primitives"
    ),
    Damage("dataset.mixed", some_meshes, episode="", text="meshes ycb: 2 x reduced 012345678901; 1 x primitives"),
    Damage("dataset.mixed", over(rig="mine"), episode="", text="rig: 2 x single; 1 x mine"),
    Damage("manifest.missing", after=remove("manifest.json"), episode="", file="manifest.json"),
    Damage("manifest.damaged", after=write("manifest.json", b'{"format":'), episode="", file="manifest.json"),
    Damage("manifest.damaged", after=write("manifest.json", b"[]"), episode="", file="manifest.json"),
    Damage(
        "manifest.differs",
        after=manifest(lambda m: m["episodes"][1].update(sha256="0" * 64)),
        file="episode.json",
        text="sha256",
    ),
    Damage(
        "manifest.differs",
        after=manifest(lambda m: m["episodes"][1].update(attempt=9)),
        file="episode.json",
        text="attempt 1; valid: 9, as in manifest.json",
    ),
    Damage(
        "manifest.differs", after=manifest(lambda m: m.update(frames=99)), episode="", file="manifest.json", text="99"
    ),
    Damage(
        "manifest.stale",
        after=manifest(
            lambda m: (m["episodes"].pop(), m.update(frames=12, bytes=sum(e["bytes"] for e in m["episodes"])))
        ),
        episode="",
        file="manifest.json",
        text="1, first ep_000002",
    ),
    Damage("ledger.missing", after=remove("attempts.jsonl"), episode="", file="attempts.jsonl"),
    Damage(
        "ledger.damaged", after=lines(lambda x: [x[0], b"{\n", x[2]]), episode="", file="attempts.jsonl", text="line 2"
    ),
    Damage(
        "ledger.damaged", after=lines(lambda x: [*x[:2], b"\xff\n"]), episode="", file="attempts.jsonl", text="line 3"
    ),
    Damage("ledger.cut", after=lines(lambda x: [*x[:2], x[2][:40]]), episode="", file="attempts.jsonl", text="line 3"),
    Damage(
        "ledger.gap",
        after=lines(lambda x: [x[0], x[2]]),
        episode="",
        file="attempts.jsonl",
        text="line 2 is attempt 2; valid: 1",
    ),
    Damage("ledger.unlogged", after=lines(lambda x: x[:2]), episode="", file="attempts.jsonl", text="ep_000002"),
    Damage(
        "ledger.differs",
        after=lines(lambda x: [x[0], x[1].replace(b'"seed": 7', b'"seed": 8'), x[2]]),
        file="episode.json",
        text="seed 7; valid: 8, as in attempts.jsonl",
    ),
    Damage(
        "ledger.differs",
        after=lines(lambda x: [x[0], x[1].replace(b'"dz_m": 0.02', b'"dz_m": 0.03'), x[2]]),
        file="episode.json",
        text="outcome dz_m 0.02; valid: dz_m 0.03",
    ),
    Damage("leftover.staging", after=write(".staging/ep_000003.ab/x", b""), episode="", file=".staging/ep_000003.ab"),
    Damage("leftover.staging", after=write(".manifest.json.1f.part", b""), episode="", file=".manifest.json.1f.part"),
    Damage("leftover.directory", after=write("ep_0000003/x", b""), episode="", file="ep_0000003"),
    Damage("leftover.directory", after=write("new/lowdim/000000.pkl", b""), episode="", file="new"),
    Damage("episode.missing", after=remove(EP), text="the episode is missing"),
    Damage("episode.missing", after=remove("ep_000002"), episode="ep_000002"),
    Damage(
        "episode.missing",
        after=lambda p: (remove("ep_000000")(p), remove(EP)(p)),
        episode="ep_000000",
        text="2 episodes",
    ),
    Damage("episode.duplicate", copy_of_the_first, text="every value is that of ep_000000"),
    Damage("episode.layout", start_of_the_first, text="all objects lie as in ep_000000"),
    Damage(
        "episode.failed",
        over(outcome=OUTCOME.model_copy(update={"success": False, "dxy_m": 0.002})),
        file="episode.json",
    ),
    Damage(
        "episode.outcome",
        over(outcome=OUTCOME.model_copy(update={"dxy_m": 0.04})),
        file="episode.json",
        text="40.0 mm from the target's centre; valid: 2.0 mm",
    ),
    Damage("record.missing", after=remove(f"{EP}/episode.json"), file="episode.json"),
    Damage("record.damaged", after=write(f"{EP}/episode.json", b"{"), file="episode.json", text="Invalid JSON"),
    Damage(
        "record.damaged", after=write(f"{EP}/episode.json", b"{}"), file="episode.json", text="episode: Field required"
    ),
    Damage("frames.count", after=fewer("lowdim"), file="lowdim", text="5 in lowdim; valid: 6, as in episode.json"),
    Damage("frames.count", after=fewer(PX), file=PX, text=f"5 in {PX}; valid: 6"),
    Damage("frames.count", after=remove(f"{EP}/rgb"), file=PX, text="0 in"),
    Damage("frames.count", after=remove(f"{EP}/lowdim"), file="lowdim", text="0 in"),
    Damage("frames.gap", after=remove(f"{EP}/{FRAME}"), file=FRAME, text=": 2; valid: 0 to 5"),
    Damage("frames.gap", after=remove(f"{EP}/{IMAGE}"), file=IMAGE),
    Damage(
        "frames.gap",
        after=lambda p: [remove(f"{EP}/lowdim/00000{k}.pkl")(p) for k in (0, 1)],
        file="lowdim/000000.pkl",
        text="0 to 1",
    ),
    Damage("file.missing", lists_more, file="depth/000000.png"),
    Damage("file.unreadable", after=lambda p: os.truncate(p / EP / FRAME, 2**21), file=FRAME, text="at most"),
    Damage("file.hash", after=flip(f"{EP}/{IMAGE}", 40), file=IMAGE, text="sha256"),
    Damage("file.unexpected", after=write(f"{EP}/notes.txt", b"hello"), file="notes.txt"),
    Damage(
        "file.unexpected", after=write(f"{EP}/rgb/other/000000.jpg", b""), file="rgb/other", text="valid: scene_camera"
    ),
    Damage("file.unexpected", after=write(f"{EP}/lowdim/2.pkl", b""), file="lowdim/2.pkl"),
    Damage("image.decode", after=cut(f"{EP}/{IMAGE}", 100), file=IMAGE, text="100 bytes"),
    Damage("image.decode", after=cut(f"{EP}/{IMAGE}", 0), file=IMAGE),
    Damage("image.decode", after=cut(f"{EP}/{IMAGE}", -1), file=IMAGE),
    Damage("image.size", image(picture(2, 1, (32, 24))), file=IMAGE, text="32x24; valid: 64x48"),
    Damage(
        "image.colour", image(encode(np.tile(np.arange(64, dtype=np.uint8) * 3, (48, 1)))), file=IMAGE, text="1 channel"
    ),
    Damage("image.black", image(black()), file=IMAGE, text="brightness 0"),
    Damage("image.black", image(black(noise=4)), file=IMAGE),
    Damage("image.uniform", image(black(noise=4, level=120)), file=IMAGE, text="brightness 119"),
    Damage(
        "image.frozen",
        frozen,
        file=f"{PX}/000001.jpg",
        text="frames 1 to 3 are the same image while a joint moves 0.10",
    ),
    Damage("lowdim.damaged", after=cut(f"{EP}/{FRAME}", 100), file=FRAME, text="not a whole frame"),
    Damage("lowdim.damaged", after=rehash(FRAME, pickle.dumps([1])), file=FRAME, text="must be a dictionary, not list"),
    Damage(
        "lowdim.forbidden",
        after=rehash(FRAME, pickle.dumps({"joints": Harm()})),
        file=FRAME,
        text="io.open, which no frame may",
    ),
    Damage("lowdim.missing", lambda s: one(s).frames[2].pop("ctrl"), file=FRAME, text="ctrl"),
    Damage(
        "lowdim.missing", lambda s: one(s).frames[2].update(extrinsics={}), file=FRAME, text=f"extrinsics[{CAMERA}]"
    ),
    Damage(
        "lowdim.simulation",
        lambda s: (
            one(s).frames[2].update(sim_qpos=np.zeros(22), sim_ctrl=np.zeros((2, 7)), sim_magnet=np.zeros(1, bool))
        ),
        file=FRAME,
        text="sim_ctrl has 2 ticks and sim_magnet 1",
    ),
    Damage(
        "lowdim.unexpected",
        lambda s: [f.update(wind=1.0) for f in one(s).frames],
        file="lowdim/000000.pkl",
        text="wind (in 6 frames)",
    ),
    Damage(
        "lowdim.shape", value("ctrl", lambda q: q[:6]), file=FRAME, text="ctrl is float32 (6,); valid: float32 (7,)"
    ),
    Damage(
        "lowdim.type", value("ctrl", lambda q: q.astype(float)), file=FRAME, text="ctrl is float64 (7,); valid: float32"
    ),
    Damage("lowdim.type", value("magnet", int), file=FRAME, text="magnet is int; valid: bool"),
    Damage("lowdim.finite", value("ctrl", lambda q: q * np.float32(np.nan)), file=FRAME, text="ctrl is [nan"),
    Damage("lowdim.finite", value("timestamp", lambda t: float("inf")), file=FRAME, text="timestamp is [inf]"),
    Damage("lowdim.content", over(content_sha256="0" * 64), file="episode.json", text="content_sha256"),
    Damage("time.order", value("timestamp", lambda t: 0.064), file=FRAME, text="0.064 s after 0.064 s"),
    Damage(
        "time.spacing",
        value("timestamp", lambda t: t + 0.001),
        file=FRAME,
        text="65.0 ms after the frame before; valid: 64.0 ms",
    ),
    Damage(
        "joints.limit",
        value("joints", lambda q: np.array([*q[:3], -1.65, *q[4:]], np.float32)),
        file=FRAME,
        text="joint4 at -1.650 rad",
    ),
    Damage(
        "joints.limit",
        value("joints", lambda q: np.array([*q[:6], 0.06], np.float32)),
        file=FRAME,
        text="finger opened 60.0 mm",
    ),
    Damage("joints.fast", joints(0.35, 0), file=FRAME, text="joint1"),
    Damage("joints.jump", joints(0.8, 0), file=FRAME, text="the drive reports at most 10.0 rad/s (in 2 frames)"),
    Damage("pose.rotation", value("banana_pose", entry(0, 0, 1.01)), file=FRAME, text="banana_pose"),
    Damage("pose.rotation", value("plate_pose", entry(2, 2, -1.0)), file=FRAME, text="det R is -1"),
    Damage(
        "pose.rotation", value(f"extrinsics[{CAMERA}]", entry(0, 0, 0.5)), file=FRAME, text="extrinsics[scene_camera]"
    ),
    Damage("pose.row", value("ee_pose", entry(3, 0, 0.5)), file=FRAME, text="0.5 0 0 1"),
    Damage("pose.far", value("ee_pose", entry(0, 3, 450.0)), file=FRAME, text="450 m; valid: within 20 m"),
    Damage("camera.intrinsics", value(f"intrinsics[{CAMERA}]", entry(2, 2, 2.0)), file=FRAME, text="0 0 2"),
    Damage("camera.intrinsics", value(f"intrinsics[{CAMERA}]", entry(0, 0, -50.0)), file=FRAME),
    Damage(
        "camera.fit",
        another_size,
        file="lowdim/000000.pkl",
        text="principal point 63.0, 47.0 in 64x48; valid: near 31.5, 23.5",
    ),
    Damage("camera.fit", value(f"intrinsics[{CAMERA}]", entry(1, 1, 500.0)), file=FRAME, text="focal length"),
    Damage("camera.view", looks_away, file=PX, text="banana_pose, plate_pose, ee_pose"),
]
# Those that need more than one step, or leave other traces too: each has a test of its own.
ELSEWHERE = {
    "episode.unchecked",
    "dataset.empty",
    "dataset.plain",
    "episode.gap",
    "episode.number",
    "file.unhashed",
    "frames.none",
    # See test_truth.py.
    "depth.decode",
    "depth.size",
    "segmentation.decode",
    "segmentation.size",
    "segmentation.label",
    "truth.missing",
    "truth.cloth",
    "truth.damaged",
    "truth.shape",
}


@pytest.mark.parametrize("damage", DAMAGES, ids=str)
def test_exactly_what_was_spoiled_is_told(damage: Damage, sample: Sample, path: Path, survey_of: Any) -> None:
    if damage.before:
        damage.before(sample)
    sample.write(path)
    if damage.after:
        damage.after(path)
    problems = survey_of(path).problems
    assert [(p.code, p.episode, p.file) for p in problems] == [(damage.code, damage.episode, damage.file)], [
        (p.code, p.text) for p in problems
    ]
    assert damage.text in problems[0].text
    assert not Path("pwned").exists()


def test_every_code_is_tested() -> None:
    assert {damage.code for damage in DAMAGES} | ELSEWHERE == set(CODES)


def test_codes_are_told_as_parts_of_a_sentence() -> None:
    for name, code in CODES.items():
        assert name.count(".") == 1
        assert not code.title.endswith(".")
        assert code.advice
        assert code.severity in Severity


def test_a_whole_dataset_has_no_problems(sample: Sample, path: Path, found: Any) -> None:
    assert found(sample.write(path)) == []


def test_two_cameras_and_a_wrist_matrix_are_part_of_the_format(sample: Sample, path: Path, found: Any) -> None:
    for made in sample.episodes:
        made.images["right_wrist_camera"] = [picture(k, 50 + made.number) for k in range(len(made.frames))]
        for frame in made.frames:
            K = frame["intrinsics"][CAMERA]
            frame["intrinsics"] = frame["intrinsics"] | {"right_wrist_camera": K}
            frame["extrinsics"] = frame["extrinsics"] | {"right_wrist_camera": frame["extrinsics"][CAMERA]}
            frame["K_wrist"] = K
    assert found(sample.write(path)) == []


def test_the_same_fault_in_many_frames_is_told_once(sample: Sample, path: Path, survey_of: Any) -> None:
    for frame in one(sample).frames[1:]:
        frame["ctrl"] = frame["ctrl"].astype(float)
    (problem,) = survey_of(sample.write(path)).problems
    assert (problem.code, problem.file, problem.count) == ("lowdim.type", "lowdim/000001.pkl", 5)
    assert problem.plain()["severity"] == "error"


def test_what_is_wrong_in_one_place_hides_nothing_elsewhere(sample: Sample, path: Path, found: Any) -> None:
    sample.write(path)
    remove(f"ep_000000/{IMAGE}")(path)
    write("ep_000000/extra", b"")(path)
    cut(f"ep_000002/{FRAME}", 0)(path)
    remove("manifest.json")(path)
    remove(f"{EP}/episode.json")(path)
    assert sorted(found(path)) == sorted(
        [
            ("manifest.missing", "", "manifest.json"),
            ("file.unexpected", "ep_000000", "extra"),
            ("frames.gap", "ep_000000", IMAGE),
            ("record.missing", EP, "episode.json"),
            ("lowdim.damaged", "ep_000002", FRAME),
        ]
    )


def test_an_episode_under_anothers_number(sample: Sample, path: Path, found: Any) -> None:
    one(sample).over["episode"] = 5
    sample.write(path)
    assert ("episode.number", EP, "episode.json") in found(path)


def test_a_file_without_a_hash(sample: Sample, path: Path, found: Any) -> None:
    made = one(sample)
    made.over["files"] = {name: value for name, value in made.record.files.items() if name != IMAGE}
    assert found(sample.write(path)) == [("file.unhashed", EP, IMAGE)]


def test_an_episode_without_a_frame(sample: Sample, path: Path, found: Any) -> None:
    sample.write(path)
    remove(f"{EP}/rgb")(path)
    remove(f"{EP}/lowdim")(path)
    assert found(path) == [("frames.none", EP, "")]


def test_a_dataset_without_episodes(sample: Sample, path: Path, found: Any) -> None:
    sample.episodes = []
    sample.write(path)
    assert found(path) == [("dataset.empty", "", "")]
    for name in ("attempts.jsonl", "manifest.json"):
        remove(name)(path)
    assert found(path) == [("dataset.empty", "", "")]


def test_looking_changes_nothing(sample: Sample, path: Path, found: Any) -> None:
    sample.write(path)
    before = {p: (p.stat().st_mtime_ns, p.read_bytes() if p.is_file() else b"") for p in path.rglob("*")}
    found(path)
    assert {p: (p.stat().st_mtime_ns, p.read_bytes() if p.is_file() else b"") for p in path.rglob("*")} == before


def test_frames_of_another_pickler_with_the_same_values_are_the_same(sample: Sample, path: Path, found: Any) -> None:
    sample.write(path)
    rehash(FRAME, pickle.dumps(one(sample).frames[2], 5))(path)
    assert found(path) == []
    rehash(FRAME, dump_frame(one(sample).frames[3]))(path)
    assert {code for code, _, _ in found(path)} == {"lowdim.content", "time.order"}


@pytest.mark.parametrize(
    "change",
    [
        {"frames": 0},
        {"frame_period_s": 0.0},
        {"cameras": {CAMERA: (0, HEIGHT)}},
        {"cameras": {CAMERA: (WIDTH, -1)}},
    ],
    ids=str,
)
def test_a_record_with_impossible_numbers_is_damaged(sample: Sample, path: Path, found: Any, change: Any) -> None:
    record = one(sample).record.model_copy(update=change)
    sample.write(path)
    write(f"{EP}/episode.json", to_json(record))(path)
    assert found(path) == [("record.damaged", EP, "episode.json")]


def test_numbers_that_json_does_not_know_are_damage(sample: Sample, path: Path, found: Any) -> None:
    sample.write(path)
    text = (path / EP / "episode.json").read_text().replace('"dz_m": 0.02', '"dz_m": NaN')
    write(f"{EP}/episode.json", text.encode())(path)
    assert found(path) == [("record.damaged", EP, "episode.json")]
