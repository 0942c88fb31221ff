"""MP4 files in a player, and files after a failure."""

from __future__ import annotations

import builtins
import subprocess
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from yamsim_cli.core.errors import ResourceError, UsageError
from yamsim_cli.core.images.image import Image
from yamsim_cli.core.images.video import BT601, BT709, ColorMatrix, VideoWriter

av = pytest.importorskip("av", reason="yamsim[video] is not installed")


def picture(k: int, width: int = 64, height: int = 48) -> Image:
    """A bright column that moves a pixel per frame, over a gradient."""
    image = np.empty((height, width, 3), np.uint8)
    image[...] = np.linspace(20, 200, width, dtype=np.uint8)[None, :, None]
    image[:, k % width] = (250, 60, 30)
    return image


def smooth(k: int) -> Image:
    """Two gradients, and a level that changes abruptly between frames."""
    x, y = np.meshgrid(np.linspace(0, 1, 24), np.linspace(0, 1, 16))
    return np.stack([110 + 30 * x, 60 + 30 * y, np.full_like(x, 20 + 37 * k % 200)], axis=-1).astype(np.uint8)


def film(path: Path, frames: int = 20, period: float | Fraction = 0.064, **options: Any) -> VideoWriter:
    with VideoWriter(path, period, **options) as video:
        for k in range(frames):
            video.write(picture(k))
    return video


@pytest.mark.parametrize(
    ("given", "exact"),
    [(0.064, Fraction(8, 125)), (1 / 30, Fraction(1, 30)), (0.064 / 3, Fraction(8, 375)), (Fraction(1, 7), None)],
)
def test_every_frame_is_there_at_its_exact_time(
    tmp_path: Path, given: float | Fraction, exact: Fraction | None
) -> None:
    video = film(tmp_path / "a.mp4", 20, given)
    assert video.frame_count == 20
    with av.open(str(tmp_path / "a.mp4")) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.pix_fmt, stream.frames) == ("h264", "yuv420p", 20)
        times = [frame.pts * stream.time_base for frame in container.decode(stream)]
        assert times == [k * (exact or given) for k in range(20)]
        assert stream.duration * stream.time_base == 20 * (exact or given)


def as_tagged(frame: Any) -> np.ndarray:
    """A decoded frame in RGB, by its tag: before version 17 PyAV uses the tag only if the matrix is to change."""
    other = BT601.tag if frame.colorspace == BT709.tag else BT709.tag
    found: np.ndarray = frame.reformat(
        format="rgb24", src_colorspace=frame.colorspace, dst_colorspace=other
    ).to_ndarray()
    return found


@pytest.mark.parametrize("matrix", [BT601, BT709])
def test_colours_come_back_and_say_how_they_are_meant(tmp_path: Path, matrix: ColorMatrix) -> None:
    colours = np.array([(200, 30, 30), (30, 180, 40), (40, 50, 210), (235, 235, 235), (10, 10, 10)], np.uint8)
    image = colours.repeat(32, axis=0)[None].repeat(64, axis=0)
    with VideoWriter(tmp_path / "c.mp4", 0.1, matrix=matrix) as video:
        for _ in range(3):
            video.write(image)
    with av.open(str(tmp_path / "c.mp4")) as container:
        frame = list(container.decode(video=0))[2]
        context = container.streams.video[0].codec_context
        tags = (context.colorspace, context.color_primaries, context.color_trc, context.color_range)
        assert tags == (matrix.tag, 1, 1, 1)
    assert frame.colorspace == matrix.tag
    assert np.abs(as_tagged(frame)[32, 16::32].astype(int) - colours).max() <= 4
    if matrix is BT601:
        # With and without the tag.
        assert np.abs(frame.to_ndarray(format="rgb24")[32, 16::32].astype(int) - colours).max() <= 4


def test_odd_sides_are_made_even_without_losing_a_pixel(tmp_path: Path) -> None:
    with VideoWriter(tmp_path / "odd.mp4", 0.1) as video:
        for k in range(3):
            video.write(picture(k, 65, 49))
    with av.open(str(tmp_path / "odd.mp4")) as container:
        frame = next(container.decode(video=0))
        assert (frame.width, frame.height) == (66, 50)


def test_the_index_comes_before_the_pictures(tmp_path: Path) -> None:
    film(tmp_path / "a.mp4")
    data = (tmp_path / "a.mp4").read_bytes()
    assert 0 < data.index(b"moov") < data.index(b"mdat")


def test_the_same_images_give_the_same_bytes(tmp_path: Path) -> None:
    """Uninitialised memory of the encoder has no effect, which small frames would show."""
    images = [smooth(k) for k in range(57)]
    random, digests = np.random.default_rng(0), set()
    for number in range(30):
        left = [np.full(size, 255, np.uint8) for size in random.integers(10, 100_000, 5)]
        path = tmp_path / f"{number}.mp4"
        with VideoWriter(path, 0.064, key_frame_interval=2) as video:
            for image in images:
                video.write(image)
        del left
        digests.add(path.read_bytes())
    assert len(digests) == 1


def test_a_key_frame_at_least_every_second(tmp_path: Path) -> None:
    film(tmp_path / "a.mp4", 40, 0.1)
    with av.open(str(tmp_path / "a.mp4")) as container:
        keys = [float(p.pts * p.time_base) for p in container.demux(video=0) if p.size and p.is_keyframe]
    assert keys[0] == 0
    assert max(np.diff([*keys, 4.0])) < 1.001


def test_nothing_shows_before_the_end_and_nothing_is_left_of_a_failure(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), VideoWriter(tmp_path / "a.mp4", 0.1) as video:
        for k in range(5):
            video.write(picture(k))
        assert [path.name[:7] for path in tmp_path.iterdir()] == [".a.mp4."]
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_an_existing_file_is_moved_aside_only_with_overwrite(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    path.write_bytes(b"precious")
    with pytest.raises(UsageError, match=r"a\.mp4 exists; move it aside with --overwrite"):
        film(path)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {"a.mp4": b"precious"}
    video = film(path, overwrite=True)
    assert video.moved_aside == tmp_path / "a.mp4.old-1"
    assert video.moved_aside.read_bytes() == b"precious"
    assert path.read_bytes()[4:8] == b"ftyp"


def test_a_file_that_appears_meanwhile_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    with pytest.raises(UsageError, match="exists"), VideoWriter(path, 0.1) as video:
        video.write(picture(0))
        path.write_bytes(b"precious")
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == {"a.mp4": b"precious"}


@pytest.mark.parametrize("name", ["a.avi", "a", "nowhere/a.mp4"])
def test_a_name_that_cannot_be_is_refused_before_anything_is_made(tmp_path: Path, name: str) -> None:
    with pytest.raises(UsageError):
        VideoWriter(tmp_path / name, 0.1)


def test_images_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    different = pytest.raises(ValueError, match="frame 1 is 32x48, but earlier ones are 64x48")
    with different, VideoWriter(tmp_path / "a.mp4", 0.1) as video:
        video.write(picture(0))
        video.write(picture(1, 32))
    with pytest.raises(ValueError, match="at least one image"), VideoWriter(tmp_path / "a.mp4", 0.1):
        pass
    with pytest.raises(ValueError, match="uint8"), VideoWriter(tmp_path / "a.mp4", 0.1) as video:
        video.write(picture(0)[..., :2])
    assert list(tmp_path.iterdir()) == []


def test_a_file_that_cannot_be_made_is_told_at_once(tmp_path: Path) -> None:
    """No hidden temporary file fits beside such a long name, even for root."""
    path = tmp_path / f"{'a' * 240}.mp4"
    with pytest.raises(ResourceError, match="cannot be written: File name too long"), VideoWriter(path, 0.1):
        pytest.fail("the block was entered")


def test_a_full_disk_is_told_in_one_line_and_leaves_nothing(tmp_path: Path) -> None:
    """A file size limit stands for a full disk; at each size another call fails first."""
    film(tmp_path / "whole.mp4", 30)
    whole = (tmp_path / "whole.mp4").stat().st_size
    (tmp_path / "whole.mp4").unlink()
    script = (
        "import resource, signal, sys; sys.path.insert(0, sys.argv[3]); signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "from pathlib import Path\n"
        "from tests.core.images.test_video import film\n"
        "from yamsim_cli.core.errors import ResourceError\n"
        "for limit in (1, int(sys.argv[2]) // 2, int(sys.argv[2]) * 9 // 10):\n"
        "    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))\n"
        "    try:\n"
        "        film(Path(sys.argv[1]) / 'a.mp4', 30)\n"
        "    except ResourceError as error:\n"
        "        print(error)\n"
    )
    root = Path(__file__).parents[3]
    done = subprocess.run(
        [sys.executable, "-c", script, str(tmp_path), str(whole), str(root)],
        cwd=root,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    message = f"{tmp_path}/a.mp4 cannot be written: File too large; choose another path"
    assert done.stdout.splitlines() == [message] * 3
    assert list(tmp_path.iterdir()) == []


def test_a_missing_library_is_named_with_its_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def missing(name: str, *rest: Any, **options: Any) -> Any:
        if name == "av":
            raise ModuleNotFoundError("No module named 'av'", name="av")
        return real(name, *rest, **options)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(ResourceError, match=r"pip install 'yamsim\[video\]'"):
        VideoWriter(tmp_path / "a.mp4", 0.1)
