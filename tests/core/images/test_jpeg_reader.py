"""JPEG headers before decoding, contents, and the decoder's complaints."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from yamsim_cli.core.images.image import ImageHeader
from yamsim_cli.core.images.jpeg import JpegReader, decode_jpeg, encode_jpeg, jpeg_header, thumbnail


def noise(height: int, width: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


@pytest.mark.parametrize(("height", "width"), [(1, 1), (12, 16), (480, 640), (300, 65500)])
def test_the_header_says_the_size_of_what_is_decoded(height: int, width: int) -> None:
    data = encode_jpeg(np.zeros((height, width, 3), np.uint8), 85)
    assert jpeg_header(data) == ImageHeader(width, height, 3)


@pytest.mark.parametrize(
    "options",
    [
        [cv2.IMWRITE_JPEG_PROGRESSIVE, 1],
        [cv2.IMWRITE_JPEG_RST_INTERVAL, 4],
        [cv2.IMWRITE_JPEG_OPTIMIZE, 1],
        [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444],
    ],
    ids=str,
)
def test_headers_of_other_encoders(options: list[int]) -> None:
    _, data = cv2.imencode(".jpg", noise(20, 30), options)
    assert jpeg_header(data.tobytes()) == ImageHeader(30, 20, 3)
    _, data = cv2.imencode(".jpg", noise(20, 30)[..., 0], options[:2] if "SAMPLING" not in str(options) else [])
    assert jpeg_header(data.tobytes()) == ImageHeader(30, 20, 1)


def test_a_header_behind_comments_and_fill_bytes() -> None:
    data = encode_jpeg(noise(20, 30), 85)
    comment = b"\xff\xff\xff\xfe" + (2 + 9).to_bytes(2, "big") + b"\xff\xc0\x00\x11\x08\xff\xff\xff\xff"
    assert jpeg_header(data[:2] + comment + data[2:]) == ImageHeader(30, 20, 3)


def test_zeros_behind_the_end_are_no_damage() -> None:
    data = encode_jpeg(noise(20, 30), 85) + bytes(7)
    assert jpeg_header(data) is not None
    assert JpegReader().compute_stats(data) is not None


@pytest.mark.parametrize("data", [b"", b"\xff\xd8\xff\xd9", b"\x89PNG", b"\xff\xd8" + b"\xff" * 100 + b"\xff\xd9"])
def test_a_file_that_is_not_a_jpeg_has_no_header(data: bytes) -> None:
    assert jpeg_header(data) is None
    assert JpegReader().compute_stats(data + b"x") is None


def test_every_cut_is_seen_before_decoding() -> None:
    data = encode_jpeg(noise(8, 8), 85)
    assert decode_jpeg(data) is not None
    cuts = [data[:length] for length in range(len(data))]
    assert not [cut for cut in cuts if jpeg_header(cut) is not None or decode_jpeg(cut) is not None]


def test_a_jpeg_reads_as_opencv_reads_it() -> None:
    data = encode_jpeg(noise(32, 48), 85)
    expected = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    assert (decode_jpeg(data) == expected).all()


def test_brightness_and_contrast_are_those_of_the_picture() -> None:
    half = np.zeros((64, 64, 3), np.uint8)
    half[:, 32:] = 200
    look = JpegReader().compute_stats(encode_jpeg(half, 95))
    assert look.brightness == pytest.approx(100, abs=2)
    assert look.contrast == pytest.approx(100, abs=4)


def test_noise_alone_is_no_contrast() -> None:
    grey = np.clip(np.random.default_rng(0).normal(90, 4, (480, 640, 3)), 0, 255).astype(np.uint8)
    specks = np.random.default_rng(1).random((480, 640)) < 0.003
    grey[specks] = 255
    look = JpegReader().compute_stats(encode_jpeg(grey, 85))
    assert look.contrast < 2


def test_equal_pictures_have_equal_fingerprints() -> None:
    image, other = noise(48, 64), noise(48, 64)
    other[30, 30] ^= 0xFF
    reader = JpegReader()
    looks = [reader.compute_stats(encode_jpeg(picture, 95)) for picture in (image, image, other)]
    assert looks[0].fingerprint == looks[1].fingerprint != looks[2].fingerprint


def test_what_the_decoder_makes_up_is_heard_and_nothing_reaches_stderr(capfd: pytest.CaptureFixture[str]) -> None:
    whole = encode_jpeg(noise(96, 128), 85)
    cut = whole[:-3000] + whole[-2:]
    assert decode_jpeg(cut) is not None
    assert "Corrupt JPEG data" in capfd.readouterr().err
    with JpegReader() as reader:
        assert "Corrupt JPEG data" in reader.compute_stats(cut).decoder_warning
        assert reader.compute_stats(whole).decoder_warning == ""
        assert "Corrupt JPEG data" in reader.compute_stats(cut).decoder_warning
    os.write(2, b"heard again\n")
    assert capfd.readouterr().err == "heard again\n"


def test_stderr_is_given_back_after_an_error() -> None:
    script = (
        "import os\n"
        "from yamsim_cli.core.images.jpeg import JpegReader\n"
        "try:\n"
        "    with JpegReader(): os.write(2, b'lost'); raise ValueError\n"
        "except ValueError: os.write(2, b'told')\n"
    )
    root = Path(__file__).resolve().parents[3]
    done = subprocess.run([sys.executable, "-c", script], cwd=root, capture_output=True, check=True)
    assert done.stderr == b"told"


def test_a_thumbnail_is_smaller_and_keeps_shape_and_colour() -> None:
    image = np.zeros((480, 640, 3), np.uint8)
    image[..., 0] = 255
    small = decode_jpeg(thumbnail(encode_jpeg(image, 90), 160))
    assert small.shape == (120, 160, 3)
    assert small[60, 80] == pytest.approx((255, 0, 0), abs=6)
    assert thumbnail(b"no picture", 160) is None
