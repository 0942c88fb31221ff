"""Each code has its damage: one fault in a whole dataset gives exactly this code."""

from __future__ import annotations

import builtins
import json
import os
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.datasets.checks.sample import CAMERA, HEIGHT, OUTCOME, WIDTH, Episode, SampleDataset, black, encode, picture
from yamsim_cli.core.dataset.checks.problem import PROBLEM_CODES
from yamsim_cli.core.dataset.lowdim import dump_frame
from yamsim_cli.core.dataset.records import to_json
from yamsim_cli.core.files.writing import sha256_bytes

IMAGE = f"rgb/{CAMERA}/000002.jpg"
FRAME = "lowdim/000002.pkl"
EP = "ep_000001"


def value(key: str, change: Callable[[Any], Any], k: int = 2) -> Callable[[SampleDataset], None]:
    """Change a frame's value `key` in episode 1 consistently."""

    def apply(sample: SampleDataset) -> None:
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


def one(sample: SampleDataset) -> Episode:
    return sample.episodes[1]


def joints(amount: float, joint: int, k: int = 2) -> Callable[[SampleDataset], None]:
    """Move a joint of episode 1 in one frame, or set it where `amount` is beyond any limit."""

    def change(q: np.ndarray) -> np.ndarray:
        q = q.copy()
        q[joint] += amount
        return q

    return value("joints", change, k)


def image(data: bytes, k: int = 2) -> Callable[[SampleDataset], None]:
    return lambda sample: one(sample).images[CAMERA].__setitem__(k, data)


def over(**changes: Any) -> Callable[[SampleDataset], None]:
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
    """Replace a file of episode 1 and make every hash fit."""

    def apply(path: Path) -> None:
        (path / EP / name).write_bytes(data)
        record = json.loads((path / EP / "episode.json").read_text())
        record["files"][name] = sha256_bytes(data)
        text = json.dumps(record).encode()
        (path / EP / "episode.json").write_bytes(text)
        manifest(lambda m: m["episodes"][1].update(sha256=sha256_bytes(text)))(path)

    return apply


class Damage:
    def __reduce__(self) -> tuple[Any, ...]:
        return builtins.open, ("pwned", "w")


def copy_of_the_first(sample: SampleDataset) -> None:
    sample.episodes[1].frames = sample.episodes[0].frames


def start_of_the_first(sample: SampleDataset) -> None:
    sample.episodes[1].layout = sample.episodes[0].layout


def frozen(sample: SampleDataset) -> None:
    one(sample).images[CAMERA][1:4] = [picture(1, 1)] * 3


def lists_more(sample: SampleDataset) -> None:
    one(sample).over["files"] = {**one(sample).record.files, "depth/000000.png": "0" * 64}


def looks_away(sample: SampleDataset) -> None:
    for frame in one(sample).frames:
        frame["extrinsics"] = {CAMERA: np.linalg.inv(frame["extrinsics"][CAMERA]).astype(np.float32)}


def another_size(sample: SampleDataset) -> None:
    for frame in one(sample).frames:
        K = frame["intrinsics"][CAMERA].copy()
        K[:2] *= 2
        frame["intrinsics"] = {CAMERA: K}


def fewer(stream: str) -> Callable[[Path], None]:
    return remove(f"{EP}/{stream}/00000{5}.{'pkl' if stream == 'lowdim' else 'jpg'}")


def some_meshes(sample: SampleDataset) -> None:
    """All episodes state their meshes, and one states others."""
    for made in sample.episodes:
        made.over["meshes"] = {"i2rt_yam_crank": "full " + "0" * 64, "ycb": "reduced " + "0123456789" * 6 + "0123"}
    one(sample).over["meshes"]["ycb"] = "primitives"


LEDGER, MANIFEST, RECORD = "attempts.jsonl", "manifest.json", f"{EP}/episode.json"
IN_FRAME, IN_IMAGE, PX = f"{EP}/{FRAME}", f"{EP}/{IMAGE}", f"rgb/{CAMERA}"
# Code, damage to the sample before it is written, place and text of the only problem.
DAMAGED_SAMPLES: list[tuple[str, Callable[[SampleDataset], object], str, str]] = [
    ("dataset.mixed", over(versions={"numpy": "2.1"}), "dataset", "numpy: 2 x 2.0; 1 x 2.1"),
    ("dataset.mixed", over(meshes={"ycb": "primitives"}), "dataset", "meshes ycb: 2 x not recorded; 1 x primitives"),
    ("dataset.mixed", some_meshes, "dataset", "meshes ycb: 2 x reduced 012345678901; 1 x primitives"),
    ("dataset.mixed", over(rig="mine"), "dataset", "rig: 2 x single; 1 x mine"),
    ("episode.duplicate", copy_of_the_first, EP, "every value equals that of ep_000000"),
    ("episode.layout", start_of_the_first, EP, "all objects have the poses of ep_000000"),
    ("episode.failed", over(outcome=OUTCOME.model_copy(update={"success": False, "dxy_m": 0.002})), RECORD, ""),
    (
        "episode.outcome",
        over(outcome=OUTCOME.model_copy(update={"dxy_m": 0.04})),
        RECORD,
        "40.0 mm from the target's centre; valid: 2.0 mm",
    ),
    ("file.missing", lists_more, f"{EP}/depth/000000.png", ""),
    ("image.size", image(picture(2, 1, (32, 24))), IN_IMAGE, "32x24; valid: 64x48"),
    ("image.colour", image(encode(np.tile(np.arange(64, dtype=np.uint8) * 3, (48, 1)))), IN_IMAGE, "1 channel"),
    ("image.black", image(black()), IN_IMAGE, "brightness 0"),
    ("image.black", image(black(noise=4)), IN_IMAGE, ""),
    ("image.uniform", image(black(noise=4, level=120)), IN_IMAGE, "brightness 119"),
    (
        "image.frozen",
        frozen,
        f"{EP}/rgb/scene_camera/000001.jpg",
        "frames 1 to 3 are the same image while a joint moves 0.10",
    ),
    ("lowdim.missing", lambda s: one(s).frames[2].pop("ctrl"), IN_FRAME, "ctrl"),
    ("lowdim.missing", lambda s: one(s).frames[2].update(extrinsics={}), IN_FRAME, f"extrinsics[{CAMERA}]"),
    (
        "lowdim.simulation",
        lambda s: (
            one(s).frames[2].update(sim_qpos=np.zeros(22), sim_ctrl=np.zeros((2, 7)), sim_magnet=np.zeros(1, bool))
        ),
        IN_FRAME,
        "sim_ctrl has 2 ticks and sim_magnet 1",
    ),
    (
        "lowdim.unexpected",
        lambda s: [f.update(wind=1.0) for f in one(s).frames],
        f"{EP}/lowdim/000000.pkl",
        "wind (in 6 frames)",
    ),
    ("lowdim.shape", value("ctrl", lambda q: q[:6]), IN_FRAME, "ctrl is float32 (6,); valid: float32 (7,)"),
    ("lowdim.type", value("ctrl", lambda q: q.astype(float)), IN_FRAME, "ctrl is float64 (7,); valid: float32"),
    ("lowdim.type", value("magnet", int), IN_FRAME, "magnet is int; valid: bool"),
    ("lowdim.finite", value("ctrl", lambda q: q * np.float32(np.nan)), IN_FRAME, "ctrl is [nan"),
    ("lowdim.finite", value("timestamp", lambda t: float("inf")), IN_FRAME, "timestamp is [inf]"),
    ("lowdim.content", over(content_sha256="0" * 64), RECORD, "content_sha256"),
    ("time.order", value("timestamp", lambda t: 0.064), IN_FRAME, "0.064 s after 0.064 s"),
    (
        "time.spacing",
        value("timestamp", lambda t: t + 0.001),
        IN_FRAME,
        "65.0 ms after the frame before; valid: 64.0 ms",
    ),
    (
        "joints.limit",
        value("joints", lambda q: np.array([*q[:3], -1.65, *q[4:]], np.float32)),
        IN_FRAME,
        "joint4 at -1.650 rad",
    ),
    (
        "joints.limit",
        value("joints", lambda q: np.array([*q[:6], 0.06], np.float32)),
        IN_FRAME,
        "finger opened 60.0 mm",
    ),
    ("joints.fast", joints(0.35, 0), IN_FRAME, "joint1"),
    ("joints.jump", joints(0.8, 0), IN_FRAME, "the drive reports at most 10.0 rad/s (in 2 frames)"),
    ("pose.rotation", value("banana_pose", entry(0, 0, 1.01)), IN_FRAME, "banana_pose"),
    ("pose.rotation", value("plate_pose", entry(2, 2, -1.0)), IN_FRAME, "det R is -1"),
    ("pose.rotation", value(f"extrinsics[{CAMERA}]", entry(0, 0, 0.5)), IN_FRAME, "extrinsics[scene_camera]"),
    ("pose.row", value("ee_pose", entry(3, 0, 0.5)), IN_FRAME, "0.5 0 0 1"),
    ("pose.far", value("ee_pose", entry(0, 3, 450.0)), IN_FRAME, "450 m; valid: within 20 m"),
    ("camera.intrinsics", value(f"intrinsics[{CAMERA}]", entry(2, 2, 2.0)), IN_FRAME, "0 0 2"),
    ("camera.intrinsics", value(f"intrinsics[{CAMERA}]", entry(0, 0, -50.0)), IN_FRAME, ""),
    (
        "camera.fit",
        another_size,
        f"{EP}/lowdim/000000.pkl",
        "principal point 63.0, 47.0 in 64x48; valid: near 31.5, 23.5",
    ),
    ("camera.fit", value(f"intrinsics[{CAMERA}]", entry(1, 1, 500.0)), IN_FRAME, "focal length"),
    ("camera.view", looks_away, f"{EP}/{PX}", "banana_pose, plate_pose, ee_pose"),
]
# Code, damage to the written dataset, place and text of the only problem.
DAMAGED_FILES: list[tuple[str, Callable[[Path], object], str, str]] = [
    ("config.missing", remove("config.yaml"), "dataset", ""),
    ("config.damaged", write("config.yaml", b"rig: ["), "config.yaml", ""),
    ("config.damaged", write("config.yaml", b"rig: single\n"), "config.yaml", "missing"),
    ("manifest.missing", remove("manifest.json"), MANIFEST, ""),
    ("manifest.damaged", write("manifest.json", b'{"format":'), MANIFEST, ""),
    ("manifest.damaged", write("manifest.json", b"[]"), MANIFEST, ""),
    ("manifest.differs", manifest(lambda m: m["episodes"][1].update(sha256="0" * 64)), RECORD, "sha256"),
    (
        "manifest.differs",
        manifest(lambda m: m["episodes"][1].update(attempt=9)),
        RECORD,
        "attempt 1; valid: 9, as in manifest.json",
    ),
    ("manifest.differs", manifest(lambda m: m.update(frames=99)), MANIFEST, "99"),
    (
        "manifest.stale",
        manifest(lambda m: (m["episodes"].pop(), m.update(frames=12, bytes=sum(e["bytes"] for e in m["episodes"])))),
        MANIFEST,
        "1, first ep_000002",
    ),
    ("ledger.missing", remove("attempts.jsonl"), LEDGER, ""),
    ("ledger.damaged", lines(lambda x: [x[0], b"{\n", x[2]]), LEDGER, "line 2"),
    ("ledger.damaged", lines(lambda x: [*x[:2], b"\xff\n"]), LEDGER, "line 3"),
    ("ledger.cut", lines(lambda x: [*x[:2], x[2][:40]]), LEDGER, "line 3"),
    ("ledger.gap", lines(lambda x: [x[0], x[2]]), LEDGER, "line 2 is attempt 2; valid: 1"),
    ("ledger.unlogged", lines(lambda x: x[:2]), LEDGER, "ep_000002"),
    (
        "ledger.differs",
        lines(lambda x: [x[0], x[1].replace(b'"seed": 7', b'"seed": 8'), x[2]]),
        RECORD,
        "seed 7; valid: 8, as in attempts.jsonl",
    ),
    (
        "ledger.differs",
        lines(lambda x: [x[0], x[1].replace(b'"dz_m": 0.02', b'"dz_m": 0.03'), x[2]]),
        RECORD,
        "outcome dz_m 0.02; valid: dz_m 0.03",
    ),
    ("leftover.staging", write(".staging/ep_000003.ab/x", b""), ".staging/ep_000003.ab", ""),
    ("leftover.staging", write(".manifest.json.1f.part", b""), ".manifest.json.1f.part", ""),
    ("leftover.directory", write("ep_0000003/x", b""), "ep_0000003", ""),
    ("leftover.directory", write("new/lowdim/000000.pkl", b""), "new", ""),
    ("episode.missing", remove(EP), EP, "the episode is missing"),
    ("episode.missing", remove("ep_000002"), "ep_000002", ""),
    ("episode.missing", lambda p: (remove("ep_000000")(p), remove(EP)(p)), "ep_000000", "2 episodes"),
    ("record.missing", remove(f"{EP}/episode.json"), RECORD, ""),
    ("record.damaged", write(f"{EP}/episode.json", b"{"), RECORD, "Invalid JSON"),
    ("record.damaged", write(f"{EP}/episode.json", b"{}"), RECORD, "episode: Field required"),
    ("frames.count", fewer("lowdim"), f"{EP}/lowdim", "5 in lowdim; valid: 6, as in episode.json"),
    ("frames.count", fewer(PX), f"{EP}/{PX}", f"5 in {PX}; valid: 6"),
    ("frames.count", remove(f"{EP}/rgb"), f"{EP}/{PX}", "0 in"),
    ("frames.count", remove(f"{EP}/lowdim"), f"{EP}/lowdim", "0 in"),
    ("frames.gap", remove(f"{EP}/{FRAME}"), IN_FRAME, ": 2; valid: 0 to 5"),
    ("frames.gap", remove(f"{EP}/{IMAGE}"), IN_IMAGE, ""),
    (
        "frames.gap",
        lambda p: [remove(f"{EP}/lowdim/00000{k}.pkl")(p) for k in (0, 1)],
        f"{EP}/lowdim/000000.pkl",
        "0 to 1",
    ),
    ("file.unreadable", lambda p: os.truncate(p / EP / FRAME, 2**21), IN_FRAME, "at most"),
    ("file.hash", flip(f"{EP}/{IMAGE}", 40), IN_IMAGE, "sha256"),
    ("file.unexpected", write(f"{EP}/notes.txt", b"hello"), f"{EP}/notes.txt", ""),
    ("file.unexpected", write(f"{EP}/rgb/other/000000.jpg", b""), f"{EP}/rgb/other", "valid: scene_camera"),
    ("file.unexpected", write(f"{EP}/lowdim/2.pkl", b""), f"{EP}/lowdim/2.pkl", ""),
    ("image.decode", cut(f"{EP}/{IMAGE}", 100), IN_IMAGE, "100 bytes"),
    ("image.decode", cut(f"{EP}/{IMAGE}", 0), IN_IMAGE, ""),
    ("image.decode", cut(f"{EP}/{IMAGE}", -1), IN_IMAGE, ""),
    ("lowdim.damaged", cut(f"{EP}/{FRAME}", 100), IN_FRAME, "not a valid frame"),
    ("lowdim.damaged", rehash(FRAME, pickle.dumps([1])), IN_FRAME, "must be a dictionary, not list"),
    ("lowdim.forbidden", rehash(FRAME, pickle.dumps({"joints": Damage()})), IN_FRAME, "io.open, which is not allowed"),
]
# Codes with their own test: they need several steps, or leave further traces.
TESTED_BELOW = {"episode.number", "file.unhashed", "frames.none", "dataset.empty"}
# Codes that are tested in test_truth.py, test_plain.py and test_surveying.py.
TESTED_ELSEWHERE = {"dataset.plain", "episode.gap", "episode.unchecked"} | {
    code for code in PROBLEM_CODES if code.startswith(("depth.", "segmentation.", "truth."))
}


def check(path: Path, survey_of: Any, code: str, place: str, text: str) -> None:
    problems = survey_of(path).problems
    found = [(p.code, "/".join(part for part in (p.episode, p.file) if part) or "dataset") for p in problems]
    assert found == [(code, place)], [(p.code, p.text) for p in problems]
    assert text in problems[0].text
    assert not Path("pwned").exists()


@pytest.mark.parametrize(("code", "damage", "place", "text"), DAMAGED_SAMPLES)
def test_exactly_what_is_wrong_in_a_sample_is_reported(
    code: str, damage: Any, place: str, text: str, sample: SampleDataset, path: Path, survey_of: Any
) -> None:
    damage(sample)
    check(sample.write(path), survey_of, code, place, text)


@pytest.mark.parametrize(("code", "damage", "place", "text"), DAMAGED_FILES)
def test_exactly_the_damage_to_files_is_reported(
    code: str, damage: Any, place: str, text: str, sample: SampleDataset, path: Path, survey_of: Any
) -> None:
    damage(sample.write(path))
    check(path, survey_of, code, place, text)


def test_every_code_is_tested() -> None:
    assert {code for code, *_ in [*DAMAGED_SAMPLES, *DAMAGED_FILES]} | TESTED_BELOW | TESTED_ELSEWHERE == set(
        PROBLEM_CODES
    )


def test_a_whole_dataset_has_no_problems(sample: SampleDataset, path: Path, found: Any) -> None:
    assert found(sample.write(path)) == []


def test_two_cameras_and_a_wrist_matrix_are_part_of_the_format(sample: SampleDataset, path: Path, found: Any) -> None:
    for made in sample.episodes:
        made.images["right_wrist_camera"] = [picture(k, 50 + made.number) for k in range(len(made.frames))]
        for frame in made.frames:
            K = frame["intrinsics"][CAMERA]
            frame["intrinsics"] = frame["intrinsics"] | {"right_wrist_camera": K}
            frame["extrinsics"] = frame["extrinsics"] | {"right_wrist_camera": frame["extrinsics"][CAMERA]}
            frame["K_wrist"] = K
    assert found(sample.write(path)) == []


def test_the_same_fault_in_many_frames_is_told_once(sample: SampleDataset, path: Path, survey_of: Any) -> None:
    for frame in one(sample).frames[1:]:
        frame["ctrl"] = frame["ctrl"].astype(float)
    (problem,) = survey_of(sample.write(path)).problems
    assert (problem.code, problem.file, problem.count) == ("lowdim.type", "lowdim/000001.pkl", 5)
    assert problem.to_json_data()["severity"] == "error"


def test_what_is_wrong_in_one_place_hides_nothing_elsewhere(sample: SampleDataset, path: Path, found: Any) -> None:
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


def test_an_episode_under_anothers_number(sample: SampleDataset, path: Path, found: Any) -> None:
    one(sample).over["episode"] = 5
    sample.write(path)
    assert ("episode.number", EP, "episode.json") in found(path)


def test_a_file_without_a_hash(sample: SampleDataset, path: Path, found: Any) -> None:
    made = one(sample)
    made.over["files"] = {name: value for name, value in made.record.files.items() if name != IMAGE}
    assert found(sample.write(path)) == [("file.unhashed", EP, IMAGE)]


def test_an_episode_without_a_frame(sample: SampleDataset, path: Path, found: Any) -> None:
    sample.write(path)
    remove(f"{EP}/rgb")(path)
    remove(f"{EP}/lowdim")(path)
    assert found(path) == [("frames.none", EP, "")]


def test_a_dataset_without_episodes(sample: SampleDataset, path: Path, found: Any) -> None:
    sample.episodes = []
    sample.write(path)
    assert found(path) == [("dataset.empty", "", "")]
    for name in ("attempts.jsonl", "manifest.json"):
        remove(name)(path)
    assert found(path) == [("dataset.empty", "", "")]


def test_looking_changes_nothing(sample: SampleDataset, path: Path, found: Any) -> None:
    sample.write(path)
    before = {p: (p.stat().st_mtime_ns, p.read_bytes() if p.is_file() else b"") for p in path.rglob("*")}
    found(path)
    assert {p: (p.stat().st_mtime_ns, p.read_bytes() if p.is_file() else b"") for p in path.rglob("*")} == before


def test_frames_of_another_pickler_with_the_same_values_are_the_same(
    sample: SampleDataset, path: Path, found: Any
) -> None:
    sample.write(path)
    rehash(FRAME, pickle.dumps(one(sample).frames[2], 5))(path)
    assert found(path) == []
    rehash(FRAME, dump_frame(one(sample).frames[3]))(path)
    assert {code for code, _, _ in found(path)} == {"lowdim.content", "time.order"}


@pytest.mark.parametrize(
    "change",
    [{"frames": 0}, {"frame_period_s": 0.0}, {"cameras": {CAMERA: (0, HEIGHT)}}, {"cameras": {CAMERA: (WIDTH, -1)}}],
    ids=str,
)
def test_a_record_with_impossible_numbers_is_damaged(
    sample: SampleDataset, path: Path, found: Any, change: Any
) -> None:
    record = one(sample).record.model_copy(update=change)
    sample.write(path)
    write(f"{EP}/episode.json", to_json(record))(path)
    assert found(path) == [("record.damaged", EP, "episode.json")]


def test_numbers_that_json_does_not_know_are_damage(sample: SampleDataset, path: Path, found: Any) -> None:
    sample.write(path)
    text = (path / EP / "episode.json").read_text().replace('"dz_m": 0.02', '"dz_m": NaN')
    write(f"{EP}/episode.json", text.encode())(path)
    assert found(path) == [("record.damaged", EP, "episode.json")]
