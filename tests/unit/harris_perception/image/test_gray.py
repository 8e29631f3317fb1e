"""Pictures in color of every encoding, by what they show."""

from __future__ import annotations

import numpy as np
import pytest

from harris_perception.core.image.gray import GreyLevels, bgr_of, eight_bits, gray_of, grey_level_of, has_color

BGR = np.array([(200, 30, 60), (10, 255, 90)], np.uint8)
"""Two pixels; the largest value is that of 8 bits, so that deep pictures are the same."""


@pytest.mark.parametrize(
    ("encoding", "order"), [("bgr8", (0, 1, 2)), ("rgb8", (2, 1, 0)), ("bgra8", (0, 1, 2, 1)), ("rgba8", (2, 1, 0, 1))]
)
@pytest.mark.parametrize("deep", [False, True])
@pytest.mark.parametrize("order_of_bytes", ["<", ">"])
def test_colors_are_the_same_of_8_and_of_16_bits(
    encoding: str, order: tuple[int, ...], deep: bool, order_of_bytes: str
) -> None:
    seen = np.tile(BGR[:, list(order)], (4, 3, 1))
    if deep:
        seen, encoding = (seen.astype(np.uint16) * 16).astype(f"{order_of_bytes}u2"), encoding.replace("8", "16")
    found = bgr_of(seen, encoding)
    assert has_color(encoding) and found.dtype == np.uint8
    np.testing.assert_array_equal(found, np.tile(BGR, (4, 3, 1)))
    assert bgr_of(seen[:0], encoding).shape == (0, 6, 3)


@pytest.mark.parametrize("encoding", ["bayer_rggb8", "bayer_rggb16"])
def test_a_bayer_pattern_of_one_color_is_that_color(encoding: str) -> None:
    mosaic = np.tile(np.array([[255, 90], [90, 10]]), (5, 6)).astype(np.uint8 if encoding.endswith("8") else np.uint16)
    np.testing.assert_array_equal(bgr_of(mosaic, encoding)[2:-2, 2:-2], np.full((6, 8, 3), (10, 90, 255)))


def test_deep_grey_becomes_8_bits_whatever_part_of_16_the_camera_fills() -> None:
    seen = np.array([[0, 51], [102, 255]], np.uint8)
    for factor in (4, 16, 257):
        np.testing.assert_array_equal(eight_bits(seen.astype(np.uint16) * np.uint16(factor)), seen)
    assert eight_bits(seen) is seen


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
def test_a_hot_pixel_leaves_the_rest_of_a_deep_picture_as_bright_as_it_was(bits: int) -> None:
    seen = np.array([[0, 51], [77, 80]], np.uint16) * np.uint16(2 ** (bits - 8))
    hot = seen.copy()
    hot[0, 0] = 2**bits - 1
    np.testing.assert_array_equal(eight_bits(hot), [[255, 51], [77, 80]])
    np.testing.assert_array_equal(eight_bits(seen), [[0, 51], [77, 80]])
    assert grey_level_of(seen) == grey_level_of(hot) == 2 ** (bits - 8)


def test_pictures_that_are_compared_have_one_grey_level() -> None:
    levels, dark = GreyLevels(), np.array([[300, 1000]], np.uint16)
    glint, damaged = np.array([[300, 1100]], np.uint16), np.array([[300, 65535]], np.uint16)
    assert levels.of(dark) == 4 and levels.of(dark, glint) == levels.of(glint, dark) == levels.of(dark) == 16
    assert GreyLevels().of(damaged) == 256, "of the first picture nothing else is known"
    np.testing.assert_array_equal(eight_bits(dark, 16), [[18, 62]])
    np.testing.assert_array_equal(bgr_of(dark, "mono16", levels)[:, :, 0], [[18, 62]])
    assert levels.of(damaged) == 256 and {levels.of(glint) for _ in range(60)} == {16}, "one moment tells nothing"
    assert levels.of(damaged, damaged) == levels.of(damaged) == 256, "what lasts counts"
    assert [levels.of(glint) for _ in range(50)] == [256] * 48 + [16] * 2, "and is forgotten"
    assert levels.of(dark.astype(np.uint8)) == 16 and GreyLevels().of(dark.astype(np.uint8)) == 1
    assert eight_bits(BGR, 16) is BGR, "what has 8 bits stays as it is"


def test_what_is_grey_is_repeated_and_what_is_unknown_refused() -> None:
    deep = np.array([[0, 50], [100, 200]], np.uint16)
    np.testing.assert_array_equal(bgr_of(deep, "mono16")[:, :, 1], [[0, 50], [100, 200]])
    assert not has_color("mono16") and not has_color("yuv422")
    with pytest.raises(ValueError, match="yuv422"):
        bgr_of(deep, "yuv422")


@pytest.mark.parametrize("shape", [(0, 0), (0, 5), (4, 0), (1, 1), (2, 2), (1, 7)])
@pytest.mark.parametrize("bits", [8, 16])
def test_pictures_of_every_size_become_grey_and_color(shape: tuple[int, int], bits: int) -> None:
    for name, count in {"mono": 1, "bgr": 3, "rgb": 3, "bgra": 4, "rgba": 4, "bayer_rggb": 1, "bayer_gbrg": 1}.items():
        values = np.full((*shape, count) if count > 1 else shape, 7, f"uint{bits}")
        gray, color = gray_of(values, f"{name}{bits}"), bgr_of(values, f"{name}{bits}")
        assert (gray.shape, gray.dtype, color.shape, color.dtype) == (shape, values.dtype, (*shape, 3), np.uint8)
