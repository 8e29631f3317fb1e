"""Serialised images are those of rclpy, and what arrives is what was packed; damaged ones are refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Image

from icu_common.nodes.images import image_bytes, image_of_bytes
from icu_common.nodes.messages.cameras import image_array, image_message
from icu_common.nodes.messages.heads import header, stamp_ns

pytestmark = pytest.mark.slow

SEED = 3
STAMP = 1_700_000_000_123_456_789
KINDS = [
    ((72, 128, 3), "bgr8", np.uint8),
    ((5, 7), "mono8", np.uint8),
    ((1, 1), "mono8", np.uint8),
    ((0, 7), "mono8", np.uint8),
    ((3, 2), "mono16", np.uint16),
    ((3, 5), "32FC1", np.float32),
]


def picture(shape: tuple[int, ...], kind: Any) -> Any:
    return (np.random.default_rng(SEED).random(shape) * 250).astype(kind)


@pytest.mark.parametrize(("shape", "encoding", "kind"), KINDS)
@pytest.mark.parametrize("frame", ["", "a", "camera_left_optical_frame"])
def test_it_is_the_message_that_rclpy_reads(shape: Any, encoding: str, kind: Any, frame: str) -> None:
    shown, head = picture(shape, kind), header(STAMP, frame)
    assert deserialize_message(image_bytes(shown, encoding, head), Image) == image_message(shown, encoding, head)


@pytest.mark.parametrize(("shape", "encoding", "kind"), KINDS)
@pytest.mark.parametrize("frame", ["", "ab", "camera_left_optical_frame"])
def test_what_rclpy_wrote_is_read_without_a_copy(shape: Any, encoding: str, kind: Any, frame: str) -> None:
    shown = picture(shape, kind)
    data = serialize_message(image_message(shown, encoding, header(STAMP, frame)))
    received = image_of_bytes(data)
    assert (stamp_ns(received.header.stamp), received.header.frame_id) == (STAMP, frame)
    assert (received.height, received.width, received.encoding) == (*shown.shape[:2], encoding)
    assert np.array_equal(image_array(received), shown) and received.data.obj is data


def test_every_other_row_or_channel_is_packed_as_it_looks() -> None:
    shown = picture((20, 30, 3), np.uint8)[::2, :, ::-1]
    assert np.array_equal(image_array(image_of_bytes(image_bytes(shown, "rgb8", header(1, "")))), shown)


def test_big_endian_numbers_are_read() -> None:
    little = image_bytes(picture((2, 4), np.uint8), "mono8", header(STAMP, "abc"))
    numbers = np.frombuffer(little, np.uint8).copy()
    numbers[1] = 0
    for at in (4, 8, 12, 20, 24, 28, 40, 44):  # stamp, length of the frame, size, length of the encoding, step, data
        numbers[at : at + 4] = numbers[at : at + 4][::-1].copy()
    received, expected = image_of_bytes(numbers.tobytes()), image_of_bytes(little)
    assert (received.header, received.height, received.width) == (expected.header, 2, 4)
    assert received.encoding == "mono8" and np.array_equal(image_array(received), image_array(expected))


def test_damaged_bytes_are_refused() -> None:
    whole = image_bytes(picture((4, 4), np.uint8), "mono8", header(STAMP, "abc"))
    for end in (0, 3, 5, 20, 40, len(whole) - 1):
        with pytest.raises(ValueError, match=r"encapsulation|ends"):
            image_of_bytes(whole[:end])
    with pytest.raises(ValueError, match="encapsulation ffff0000"):
        image_of_bytes(b"\xff\xff" + whole[2:])
