"""H.264 of a camera against another decoder, and against the quantiser's step."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from yamsim_cli.video_compression import VideoCompression

SIZE = (60, 80)  # px, height and width


def moving_images(count: int) -> list[np.ndarray]:
    base = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 256, (*SIZE, 3), np.uint8), (0, 0), 2)
    return [np.roll(base, 2 * k, axis=1) for k in range(count)]


def compressed(images: list[np.ndarray], qp: int, key_frame_interval: int) -> tuple[list[np.ndarray], list[bytes]]:
    video, packets = VideoCompression(qp, key_frame_interval), []
    changed = [image.copy() for image in images]
    for frame, image in enumerate(changed):
        video.apply(image, frame)
        packets.append(video.packet)
    return changed, packets


def test_images_are_those_of_another_decoder(tmp_path: Path) -> None:
    images, packets = compressed(moving_images(5), 36, 3)
    file = tmp_path / "camera.h264"
    file.write_bytes(b"".join(packets))
    video = cv2.VideoCapture(str(file))
    for image in images:
        read, decoded = video.read()
        assert read
        # Conversions to RGB differ in how they interpolate the colours' half resolution, and in their rounding.
        assert (
            np.abs(cv2.cvtColor(decoded, cv2.COLOR_BGR2GRAY) - cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) * 1.0).mean() < 2
        )
    assert not video.read()[0]


@pytest.mark.parametrize("qp", [22, 28, 34])
def test_the_error_is_that_of_the_quantisers_step(qp: int) -> None:
    """A step q gives an error of q squared / 12, or up to q squared / 9 with the encoder's rounding towards zero."""
    noise = np.random.default_rng(2).normal(128, 45, SIZE).clip(1, 254).astype(np.uint8)
    (image,), _ = compressed([np.repeat(noise[..., None], 3, axis=2)], qp, 1)
    step = 0.625 * 2 ** (qp / 6)  # Source: ITU-T H.264, 8.5.9
    luma = 219 / 255  # of the range of grey values
    error = luma * (cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) - noise.astype(float))
    assert 1 / 12 < np.mean(error**2) / step**2 < 1 / 8


def test_frames_between_key_frames_depend_on_earlier_ones() -> None:
    images = moving_images(4)
    (alone,), _ = compressed(images[3:], 36, 1)
    independent, large = compressed(images, 36, 1)
    np.testing.assert_array_equal(independent[3], alone)
    dependent, small = compressed(images, 36, 4)
    np.testing.assert_array_equal(dependent[0], independent[0])
    assert not np.array_equal(dependent[3], alone)
    assert len(small[3]) < 0.5 * len(large[3])


def test_frame_0_begins_another_video_with_the_same_bytes() -> None:
    images, video, seen = moving_images(3), VideoCompression(30, 30), []
    for _ in range(2):
        for frame, image in enumerate(images):
            changed = image.copy()
            video.apply(changed, frame)
            seen.append((changed.tobytes(), video.packet))
    assert seen[:3] == seen[3:]
    with pytest.raises(ValueError, match="frame 4 is compressed after frame 2"):
        video.apply(images[0].copy(), 4)


def test_odd_sizes_keep_their_size() -> None:
    image = np.full((41, 61, 3), 90, np.uint8)
    VideoCompression(20, 30).apply(image, 0)
    assert np.abs(image.astype(int) - 90).max() <= 3
