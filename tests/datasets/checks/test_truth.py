"""Ground truth in a dataset: each fault gives exactly its code."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.datasets.checks.sample import CAMERA, FRAMES, HEIGHT, WIDTH, SampleDataset
from tests.datasets.checks.test_codes import EP, cut, remove, write
from yamsim_cli.core.dataset.dataset_paths import TRUTH_LABELS_FILE, depth_path, segmentation_path, truth_path
from yamsim_cli.core.dataset.ground_truth_files import (
    KeypointRecord,
    LabelRecord,
    TruthLabels,
    array_specs,
    dump_arrays,
    dump_depth,
    load_truth,
)
from yamsim_cli.core.dataset.records import to_json
from yamsim_cli.core.images.png import encode_labels

LABELS = TruthLabels(
    labels=[LabelRecord(id=k, name=name, instance=name) for k, name in enumerate(("background", "table", "banana"))],
    instances=["table", "banana"],
    links=["arm", "link_1"],
    objects=["banana"],
    keypoints=[KeypointRecord(name="joint1", body="link_1", kind="joint")],
)
DEPTH, SEGMENTATION = depth_path(CAMERA, 2), segmentation_path(CAMERA, 2)


def truth_files() -> dict[str, bytes]:
    """Ground truth files of one episode, in the right shapes; every frame differs a little."""
    files = {TRUTH_LABELS_FILE: to_json(LABELS)}
    for k in range(FRAMES):
        image = np.zeros((HEIGHT, WIDTH), np.uint8)
        image[10:30, 5 + k : 40] = 1
        files[depth_path(CAMERA, k)] = dump_depth(image.astype(np.uint16) * 1000)
        files[segmentation_path(CAMERA, k)] = encode_labels(image)
    arrays = {key: np.zeros(shape, dtype) for key, (dtype, shape) in array_specs(LABELS, FRAMES).items()}
    return files | {truth_path(CAMERA): dump_arrays(arrays)}


@pytest.fixture
def truthful(sample: SampleDataset) -> SampleDataset:
    """The sample with ground truth in all its episodes."""
    for episode in sample.episodes:
        episode.others = truth_files()
        episode.over["truth"] = True
    return sample


def put(name: str, data: bytes) -> Callable[[SampleDataset], None]:
    return lambda sample: sample.episodes[1].others.__setitem__(name, data)


def changed_arrays(**changes: Any) -> bytes:
    arrays = load_truth(truth_files()[truth_path(CAMERA)])
    return dump_arrays({key: array for key, array in (arrays | changes).items() if array is not None})


def labels_of(height: int, width: int, number: int = 1) -> bytes:
    return encode_labels(np.full((height, width), number, np.uint8))


BEFORE = [
    ("depth.decode", DEPTH, b"PK\x03\x04", "not a valid npz"),
    ("depth.decode", DEPTH, dump_arrays({"z": np.zeros((HEIGHT, WIDTH), np.uint16)}), "no array `depth`"),
    ("depth.decode", DEPTH, dump_arrays({"depth": np.zeros((HEIGHT, WIDTH))}), "float64 (48, 64), not uint16"),
    ("depth.size", DEPTH, dump_depth(np.zeros((WIDTH, HEIGHT), np.uint16)), "48x64; valid: 64x48"),
    ("segmentation.decode", SEGMENTATION, b"\x89PNG", "4 bytes"),
    ("segmentation.decode", SEGMENTATION, cv2.imencode(".png", np.zeros((48, 64, 3), np.uint8))[1].tobytes(), ""),
    ("segmentation.size", SEGMENTATION, labels_of(10, 20), "20x10; valid: 64x48"),
    ("segmentation.label", SEGMENTATION, labels_of(HEIGHT, WIDTH, 9), "9; valid: 0 to 2"),
    ("truth.damaged", TRUTH_LABELS_FILE, b"{}", "labels: Field required"),
    ("truth.damaged", truth_path(CAMERA), b"no zip", "not a valid npz"),
    ("truth.shape", truth_path(CAMERA), changed_arrays(boxes=None), "boxes is missing"),
    ("truth.shape", truth_path(CAMERA), changed_arrays(boxes=np.zeros((5, 2, 4), np.int32)), "not int32 (6, 2, 4)"),
    ("truth.shape", truth_path(CAMERA), changed_arrays(visibility=np.zeros((6, 1))), "visibility is float64"),
    ("truth.shape", truth_path(CAMERA), changed_arrays(intrinsics=np.full((3, 3), np.nan)), "not finite"),
]


@pytest.mark.parametrize(("code", "file", "data", "text"), BEFORE, ids=[f"{b[0]}-{b[3]}" for b in BEFORE])
def test_exactly_what_was_spoiled_is_told(
    code: str, file: str, data: bytes, text: str, truthful: SampleDataset, path: Path, survey_of: Any
) -> None:
    put(file, data)(truthful)
    truthful.write(path)
    problems = survey_of(path).problems
    assert [(p.code, p.episode, p.file) for p in problems] == [(code, EP, file)], [p.text for p in problems]
    assert text in problems[0].text


@pytest.mark.parametrize(
    ("damage", "code", "file"),
    [
        (remove(f"{EP}/{DEPTH}"), "frames.gap", DEPTH),
        (remove(f"{EP}/{SEGMENTATION}"), "frames.gap", SEGMENTATION),
        (remove(f"{EP}/{depth_path(CAMERA, 5)}"), "frames.count", f"depth/{CAMERA}"),
        (remove(f"{EP}/segmentation"), "frames.count", f"segmentation/{CAMERA}"),
        (remove(f"{EP}/{TRUTH_LABELS_FILE}"), "file.missing", TRUTH_LABELS_FILE),
        (remove(f"{EP}/{truth_path(CAMERA)}"), "file.missing", truth_path(CAMERA)),
        (cut(f"{EP}/{DEPTH}", 100), "depth.decode", DEPTH),
        (cut(f"{EP}/{SEGMENTATION}", -4), "segmentation.decode", SEGMENTATION),
        (write(f"{EP}/{SEGMENTATION}", labels_of(HEIGHT, WIDTH)), "file.hash", SEGMENTATION),
        (write(f"{EP}/depth/other/000000.npz", b""), "file.unexpected", "depth/other/000000.npz"),
    ],
)
def test_what_was_lost_or_changed_is_told(
    damage: Callable[[Path], None], code: str, file: str, truthful: SampleDataset, path: Path, found: Any
) -> None:
    truthful.write(path)
    damage(path)
    assert found(path) == [(code, EP, file)]


def test_whole_truth_has_no_problems(truthful: SampleDataset, path: Path, found: Any) -> None:
    assert found(truthful.write(path)) == []


def test_cloth_that_labels_do_not_name_is_told(truthful: SampleDataset, path: Path, survey_of: Any) -> None:
    truthful.episodes[1].over["cloths"] = {"napkin": (9, 8)}
    problems = [p for p in survey_of(truthful.write(path)).problems if p.code.startswith("truth")]
    assert [(p.code, p.episode, p.file) for p in problems] == [("truth.cloth", EP, TRUTH_LABELS_FILE)]
    assert "no cloth; valid: napkin of 9 x 8 points" in problems[0].text


def test_truth_that_was_never_written_is_missing(truthful: SampleDataset, path: Path, found: Any) -> None:
    del truthful.episodes[1].others[TRUTH_LABELS_FILE]
    assert found(truthful.write(path)) == [("truth.missing", EP, TRUTH_LABELS_FILE)]


def test_truth_that_the_record_does_not_speak_of_is_unexpected(sample: SampleDataset, path: Path, found: Any) -> None:
    sample.write(path)
    write(f"{EP}/{DEPTH}", truth_files()[DEPTH])(path)
    assert found(path) == [("file.unexpected", EP, DEPTH)]
