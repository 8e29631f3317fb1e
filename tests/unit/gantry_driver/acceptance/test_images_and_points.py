"""Focus and coverage of the cameras, and the points that are touched."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from gantry_driver.acceptance.coverage import along_outline, mask_of, view_of
from gantry_driver.acceptance.sharpness import edge_blur_px
from gantry_driver.acceptance.touch_points import EDGE_M, TALL_EDGE_M, choose_points
from icu_common.core.panel.panel_layout import load_layout

ROOT = Path(__file__).resolve().parents[4]


def blurred(sigma_px: float, noise: float = 1.5) -> np.ndarray:
    """Return a picture of rectangles whose edges have a known blur, drawn at eight times the size."""
    big = np.full((1600, 2400), 60.0, np.float32)
    for number in range(12):
        x, y = 150 + 190 * number, 150 + 97 * (number % 5)
        cv2.rectangle(big, (x, y), (x + 90 + 3 * number, y + 700), 190.0, -1)
    big = cv2.GaussianBlur(big, (0, 0), 8 * sigma_px)
    small = cv2.resize(big, (300, 200), interpolation=cv2.INTER_AREA)
    small += np.random.default_rng(2).normal(0.0, noise, small.shape)
    return np.clip(small, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("sigma_px", [0.8, 1.5, 2.5])
def test_blur_of_edges_is_measured(sigma_px: float) -> None:
    picture = blurred(sigma_px)
    measured = edge_blur_px(picture, np.ones(picture.shape, bool))
    assert measured == pytest.approx(math.hypot(sigma_px, 0.29), rel=0.2)  # a pixel's own area blurs by 0.29 px


def test_blur_does_not_depend_on_contrast_and_needs_edges() -> None:
    picture = blurred(1.2, noise=0.0)
    faint = (picture // 2 + 40).astype(np.uint8)
    whole = np.ones(picture.shape, bool)
    assert edge_blur_px(faint, whole) == pytest.approx(edge_blur_px(picture, whole), rel=0.05)
    assert math.isnan(edge_blur_px(np.full((200, 300), 90, np.uint8), whole))
    assert math.isnan(edge_blur_px(picture, ~whole)), "nothing of the panel is in the image"


def test_lines_do_not_count_as_sharp_edges() -> None:
    """A printed line is narrower than its blur; its fall follows at once and would look like a sharper edge."""
    lines = np.full((200, 300), 60.0, np.float32)
    lines[20:180, 10:290:12] = 190.0
    lines = cv2.GaussianBlur(lines, (0, 0), 1.2)
    picture = np.vstack([blurred(1.2, noise=0.0), lines.astype(np.uint8)])
    measured = edge_blur_px(picture, np.ones(picture.shape, bool))
    assert measured == pytest.approx(edge_blur_px(blurred(1.2, noise=0.0), np.ones((200, 300), bool)), rel=0.02)
    assert math.isnan(edge_blur_px(lines.astype(np.uint8)[30:170], np.ones((140, 300), bool)))


def test_view_of_a_panel_has_the_share_inside_and_the_margin() -> None:
    corners = np.array([(10.0, 20.0), (90.0, 20.0), (90.0, 60.0), (10.0, 60.0)])
    outline = along_outline(corners)
    assert len(outline) == 200
    whole = view_of(outline, 100, 80)
    assert (whole.share, whole.margin_px) == (1.0, 9.0)
    half = view_of(outline - (50.0, 0.0), 100, 80)
    assert half.share == pytest.approx(0.5, abs=0.03) and half.margin_px == -40.0
    outline[3] = np.nan
    assert view_of(outline, 100, 80).share == pytest.approx(199 / 200)
    mask = mask_of(whole, 100, 80)
    assert mask[40, 50] and not mask[10, 50] and mask.sum() == 81 * 41


def test_points_are_away_from_controls_and_from_each_other() -> None:
    layout = load_layout(ROOT / "config" / "scopes" / "dso_bench_4.yaml")
    width, height = (v * 1e-3 for v in layout.size_mm)
    outline = np.array([(0, 0), (width, 0), (width, height), (0, height)])
    inside = np.array([(-0.02, -0.03), (0.25, -0.03), (0.25, 0.2), (-0.02, 0.2)])
    points = choose_points(outline, layout.controls, 20, inside)
    assert points.shape == (20, 2)
    assert points[:, 0].max() < 0.25, "in reach"
    for control in layout.controls:
        off = np.abs(points - np.array(control.position_mm) * 1e-3) - np.array(control.size_mm) * 0.5e-3
        room = TALL_EDGE_M if control.height_mm > 5 else EDGE_M
        assert np.hypot(*np.maximum(off, 0.0).T).min() >= room - 1e-9, control.name
    between = np.hypot(*(points[:, np.newaxis] - points).transpose(2, 0, 1)) + np.eye(20)
    assert between.min() > 0.01
    assert (np.ptp(points, axis=0) > (0.2, 0.12)).all(), "all over the face"


def test_a_panel_without_room_gives_fewer_points() -> None:
    outline = np.array([(0, 0), (0.02, 0), (0.02, 0.02), (0, 0.02)])
    everywhere = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])
    assert 0 < len(choose_points(outline, (), 20, everywhere)) < 20
    assert choose_points(outline, (), 20, everywhere + 5.0).shape == (0, 2)
