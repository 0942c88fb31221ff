"""Photos of cameras, phones and users, and files that are no photos."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from yamsim_cli.core.errors import ResourceError
from yamsim_cli.core.images.image_files import read_image, read_mask, to_grey
from yamsim_cli.core.images.png import encode_png

HEIGHT, WIDTH = 48, 64


def picture() -> np.ndarray:
    """RGB, with a red top left corner and a blue right edge."""
    image = np.empty((HEIGHT, WIDTH, 3), np.uint8)
    image[...] = np.linspace(60, 200, WIDTH, dtype=np.uint8)[None, :, None]
    image[:16, :16] = (220, 20, 20)
    image[:, -8:] = (20, 30, 230)
    return image


def saved(path: Path, image: np.ndarray) -> Path:
    assert cv2.imwrite(str(path), image)
    return path


def bgr() -> np.ndarray:
    return picture()[..., ::-1].copy()


def turned_jpeg(orientation: int) -> bytes:
    """A JPEG with an EXIF orientation."""
    data = cv2.imencode(".jpg", bgr(), [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
    # TIFF header, and a directory of one entry: Orientation (0x0112), a short.
    tiff = b"II*\0" + struct.pack("<I", 8) + struct.pack("<HHHIHHI", 1, 0x0112, 3, 1, orientation, 0, 0)
    body = b"Exif\0\0" + tiff
    return data[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + data[2:]


def test_a_colour_png_is_read_as_rgb(tmp_path: Path) -> None:
    assert np.array_equal(read_image(saved(tmp_path / "a.png", bgr())), picture())


def test_alpha_is_left_out(tmp_path: Path) -> None:
    with_alpha = np.dstack([bgr(), np.full((HEIGHT, WIDTH), 7, np.uint8)])
    assert np.array_equal(read_image(saved(tmp_path / "a.png", with_alpha)), picture())


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_grey_becomes_three_equal_channels(tmp_path: Path, suffix: str) -> None:
    grey = to_grey(picture())
    image = read_image(saved(tmp_path / f"a{suffix}", grey))
    assert image.shape == (HEIGHT, WIDTH, 3)
    assert np.abs(image.astype(int) - grey[..., None]).max() <= (0 if suffix == ".png" else 12)
    assert np.abs(to_grey(image).astype(int) - image[..., 0]).max() <= 1


@pytest.mark.parametrize("channels", [1, 3])
def test_sixteen_bits_keep_their_upper_eight(tmp_path: Path, channels: int) -> None:
    deep = bgr().astype(np.uint16) * 257
    deep = deep if channels == 3 else deep[..., 0]
    image = read_image(saved(tmp_path / "a.png", deep))
    assert image.dtype == np.uint8
    wanted = picture() if channels == 3 else np.repeat(picture()[..., 2:], 3, axis=2)
    assert np.abs(image.astype(int) - wanted).max() <= 1


@pytest.mark.parametrize(("orientation", "corner"), [(1, (0, 0)), (3, (-1, -1)), (6, (0, -1)), (8, (-1, 0))])
def test_a_phones_photo_is_turned_upright(tmp_path: Path, orientation: int, corner: tuple[int, int]) -> None:
    (tmp_path / "a.jpg").write_bytes(turned_jpeg(orientation))
    image = read_image(tmp_path / "a.jpg")
    assert image.shape[:2] == ((WIDTH, HEIGHT) if orientation in (6, 8) else (HEIGHT, WIDTH))
    red, green, _ = image[corner].astype(int)
    assert red > 150 > 100 > green


@pytest.mark.parametrize("note", [b"", b"\0" * 400, b"MotionPhoto" * 20])
def test_what_a_camera_appends_does_no_harm(tmp_path: Path, note: bytes) -> None:
    for suffix in (".png", ".jpg"):
        path = saved(tmp_path / f"a{suffix}", bgr())
        path.write_bytes(path.read_bytes() + note)
        assert read_image(path).shape == (HEIGHT, WIDTH, 3)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.97])
def test_a_cut_off_file_is_refused(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], suffix: str, share: float
) -> None:
    path = saved(tmp_path / f"a{suffix}", bgr())
    data = path.read_bytes()
    path.write_bytes(data[: round(share * len(data))])
    with pytest.raises(ResourceError, match="is not a valid PNG or JPEG; export it again"):
        read_image(path)
    assert capfd.readouterr() == ("", "")


def test_a_png_with_a_flipped_bit_is_refused_without_a_word_of_the_decoders(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = saved(tmp_path / "a.png", bgr())
    data = bytearray(path.read_bytes())
    for place in (20, len(data) // 2, len(data) - 20):
        damaged = data.copy()
        damaged[place] ^= 4
        path.write_bytes(damaged)
        with pytest.raises(ResourceError, match=r"a\.png"):
            read_image(path)
    assert capfd.readouterr() == ("", "")


def test_a_phones_photo_with_a_preview_inside_is_refused_when_cut_off(tmp_path: Path) -> None:
    """The preview has its own end marker, near the file's beginning."""
    big = cv2.resize(bgr(), (640, 480))
    data = cv2.imencode(".jpg", np.random.default_rng(0).integers(0, 255, big.shape, np.uint8) // 2 + big // 2)[1]
    preview = cv2.imencode(".jpg", bgr())[1].tobytes()
    whole = data.tobytes()
    whole = whole[:2] + b"\xff\xe2" + struct.pack(">H", len(preview) + 2) + preview + whole[2:]
    (tmp_path / "a.jpg").write_bytes(whole)
    assert read_image(tmp_path / "a.jpg").shape == (480, 640, 3)
    (tmp_path / "a.jpg").write_bytes(whole[:-100])
    with pytest.raises(ResourceError, match=r"a\.jpg"):
        read_image(tmp_path / "a.jpg")


@pytest.mark.parametrize(
    "content",
    [b"just text\n", b"\x89PNG\r\n\x1a\n", b"GIF89a", b"\xff\xd8\xff\xd9", b"\xff\xd8" + b"\0" * 50 + b"\xff\xd9"],
)
def test_other_files_named_png_are_refused(tmp_path: Path, capfd: pytest.CaptureFixture[str], content: bytes) -> None:
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(ResourceError, match=r"a\.png"):
        read_image(tmp_path / "a.png")
    assert capfd.readouterr() == ("", "")


def test_an_unreadable_image_is_refused_with_the_reason(tmp_path: Path) -> None:
    with pytest.raises(ResourceError, match=r"b\.png cannot be read: No such file or directory"):
        read_image(tmp_path / "b.png")
    (tmp_path / "c.png").mkdir()
    with pytest.raises(ResourceError, match=r"c\.png cannot be read: Is a directory"):
        read_image(tmp_path / "c.png")


def test_a_file_larger_than_any_photo_is_not_read(tmp_path: Path) -> None:
    with (tmp_path / "a.png").open("wb") as stream:
        stream.truncate(300_000_000)
    with pytest.raises(ResourceError, match="larger than 200 MB"):
        read_image(tmp_path / "a.png")


def test_masks(tmp_path: Path) -> None:
    inside = np.zeros((HEIGHT, WIDTH), bool)
    inside[10:30, 20:50] = True
    assert np.array_equal(read_mask(saved(tmp_path / "labels.png", inside.astype(np.uint8))), inside)
    assert np.array_equal(read_mask(saved(tmp_path / "white.png", inside * np.uint8(255))), inside)
    # JPEG compression brightens pixels beside an edge.
    smeared = saved(tmp_path / "white.jpg", inside * np.uint8(255))
    assert (cv2.imread(str(smeared), 0)[~inside] > 0).any()
    assert np.array_equal(read_mask(smeared), inside)


def test_png_holds_its_scale() -> None:
    image = np.random.default_rng(0).integers(0, 256, (40, 30), dtype=np.uint8)
    plain, scaled = encode_png(image), encode_png(image, 23263.3)
    assert b"pHYs" not in plain
    start = scaled.index(b"pHYs")
    across, down, unit = struct.unpack(">IIB", scaled[start + 4 : start + 13])
    assert (across, down, unit) == (23263, 23263, 1)
    assert scaled[start + 13 : start + 17] == struct.pack(">I", zlib.crc32(scaled[start : start + 13]))
    assert scaled.index(b"IHDR") < start < scaled.index(b"IDAT")
    for data in (plain, scaled):
        assert np.array_equal(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED), image)


def test_png_of_colour_is_rgb() -> None:
    image = np.zeros((2, 3, 3), np.uint8)
    image[..., 0] = 200
    decoded = cv2.imdecode(np.frombuffer(encode_png(image), np.uint8), cv2.IMREAD_COLOR)
    assert (decoded[..., 2] == 200).all()
