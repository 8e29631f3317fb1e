"""The rendered image against the projection: printed edges, heights, the ball's outline."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from icu_common.core.panel.panel_layout import parse_layout
from icu_simulator.core import view as view_module
from icu_simulator.core.configuration import BenchCameraConfig, BenchConfig, BenchStylusConfig, LightConfig
from icu_simulator.core.optics import Camera, Rays, stereo_rig
from icu_simulator.core.renderer import base_from_panel
from icu_simulator.core.solids import ControlState, cast
from icu_simulator.core.stylus_picture import StylusPainter
from icu_simulator.core.surfaces import Surfaces
from icu_simulator.core.view import BenchView

CLEAR = LightConfig(unevenness=0.0, vignetting=0.0, glare=0.0, blur_px=0.0, noise=0.0)
CAMERA = BenchCameraConfig()
LAYOUT = parse_layout(
    """
model: m
size_mm: [320, 150]
colour: "#ffffff"
controls:
- {name: K, kind: knob, shape: circle, position_mm: [280, 80], size_mm: [18, 18], height_mm: 15, colour: "#000000"}
- {name: B, kind: button, position_mm: [230, 40], size_mm: [16, 9], height_mm: 3, colour: "#ff0000"}
artwork:
- {rectangle_mm: [20, 20, 30, 40], fill: "#000000"}
- {rectangle_mm: [90, 90, 35, 30], fill: "#000000"}
- {rectangle_mm: [160, 25, 25, 100], fill: "#000000"}
- {rectangle_mm: [60.33, 30.77, 21.5, 17.25], fill: "#000000"}
"""
)
PANEL = base_from_panel(BenchConfig().panel)
SURFACES = Surfaces.of(LAYOUT)


@pytest.fixture(scope="module", params=["left", "right"])
def view(request: pytest.FixtureRequest) -> BenchView:
    camera: Camera = getattr(stereo_rig(CAMERA), request.param)
    return BenchView(Rays(camera), PANEL, LAYOUT, SURFACES, CLEAR, 0.0)


def crossing(view: BenchView, fixed: float, low: float, high: float, row: int, axis: int) -> float:
    """Column (axis 0: edge x = fixed) or row (axis 1) where the printed edge crosses a row or column, by bisection."""

    def pixel(free: float) -> np.ndarray:
        return view.pixel_of_panel((fixed, free, 0.0) if axis == 0 else (free, fixed, 0.0))[0]

    across = 1 if axis == 0 else 0
    falling = pixel(low)[across] > pixel(high)[across]
    for _ in range(60):
        middle = (low + high) / 2
        if (pixel(middle)[across] > row) == falling:
            low = middle
        else:
            high = middle
    return float(pixel((low + high) / 2)[1 - across])


def edge_errors(view: BenchView) -> np.ndarray:
    """Differences in pixels between where edges are rendered and where the projection has them."""
    grey = view.picture[..., 1].astype(float) / 255
    errors = []
    for x, y, width, height in ((20, 20, 30, 40), (90, 90, 35, 30), (160, 25, 25, 100), (60.33, 30.77, 21.5, 17.25)):
        for axis in (0, 1):
            start, length, other, extent = (x, width, y, height) if axis == 0 else (y, height, x, width)
            for share in (0.3, 0.5, 0.7):
                along = other + extent * share
                middle = view.pixel_of_panel((start, along, 0.0) if axis == 0 else (along, start, 0.0))[0]
                line = round(float(middle[1 - axis]))
                profile = grey[line] if axis == 0 else grey[:, line]
                for edge, sign in ((start, 1), (start + length, -1)):
                    true = crossing(view, edge, other + 1, other + extent - 1, line, axis)
                    # y points up in the panel and down in the picture.
                    dark_after = sign if axis == 0 else -sign
                    first, last = round(true) - 4, round(true) + 5
                    white = float(profile[first:last].max())
                    bright = float(profile[first:last].sum()) / white
                    measured = first - 0.5 + bright if dark_after > 0 else last - 0.5 - bright
                    errors.append(measured - true)
    return np.array(errors)


def test_printed_edges_are_where_the_projection_puts_them(view: BenchView) -> None:
    errors = edge_errors(view)
    print("edges", len(errors), "mean", errors.mean(), "worst", np.abs(errors).max())
    assert len(errors) == 48
    assert np.abs(errors).max() < 0.05
    assert abs(errors.mean()) < 0.01


def test_blur_does_not_move_edges() -> None:
    camera = stereo_rig(CAMERA).left
    blurred = BenchView(Rays(camera), PANEL, LAYOUT, SURFACES, dataclasses.replace(CLEAR, blur_px=0.8), 0.0)
    errors = edge_errors(blurred)
    assert np.abs(errors).max() < 0.08
    assert abs(errors.mean()) < 0.01


def centroid_of_red(picture: np.ndarray) -> np.ndarray:
    blue, green, red = (picture[..., i].astype(float) for i in range(3))
    share = np.clip(red - np.maximum(blue, green), 0, None)
    share[share < 0.5 * share.max()] = 0
    rows, columns = np.mgrid[0 : share.shape[0], 0 : share.shape[1]]
    return np.array([(share * columns).sum(), (share * rows).sum()]) / share.sum()


def test_a_cap_is_seen_at_its_height(view: BenchView) -> None:
    # Red shows on the cap (bright) and on the wall (darker); the cap decides.
    at = centroid_of_red(view.picture)
    on_cap, on_face = view.pixel_of_panel([(230, 40, 3.0), (230, 40, 0.0)])
    assert np.linalg.norm(at - on_cap) < 0.8
    assert np.linalg.norm(at - on_cap) < np.linalg.norm(at - on_face)


def test_a_lamp_and_a_pressed_button_change_only_their_surroundings(view: BenchView) -> None:
    before = view.picture.copy()
    view.show({"B": ControlState(lamp="#00ff00", sunk_mm=1.0)})
    changed = np.abs(view.picture.astype(int) - before).max(axis=2) > 2
    rows, columns = np.nonzero(changed)
    corners = view.pixel_of_panel([(x, y, z) for x in (222, 238) for y in (35.5, 44.5) for z in (0, 3)])
    assert rows.min() >= corners[:, 1].min() - 2
    assert rows.max() <= corners[:, 1].max() + 2
    assert columns.min() >= corners[:, 0].min() - 2
    assert columns.max() <= corners[:, 0].max() + 2
    u, v = np.round(view.pixel_of_panel((230, 40, 2.0))[0]).astype(int)
    blue, green, red = view.picture[v, u].astype(int)
    assert green > 200 > 120 > max(blue, red) - 60
    view.show({"B": ControlState()})
    assert np.array_equal(view.picture, before), "and back again leaves no trace"


def test_a_turned_knob_shows_its_pointer(view: BenchView) -> None:
    def pointer() -> np.ndarray:
        centre, rim = view.pixel_of_panel([(280, 80, 15.0), (280, 87, 15.0)])
        reach = int(np.linalg.norm(rim - centre))
        u, v = np.round(centre).astype(int)
        part = view.picture[v - reach : v + reach + 1, u - reach : u + reach + 1, 1].astype(float)
        rows, columns = np.mgrid[-reach : reach + 1, -reach : reach + 1]
        bright = (part > 150) & (np.hypot(rows, columns) <= reach)
        return np.array([columns[bright].mean(), rows[bright].mean()])

    view.show({"K": ControlState(angle_deg=0.0)})
    assert pointer()[1] < -6, "up"
    view.show({"K": ControlState(angle_deg=90.0)})
    assert pointer()[0] < -6, "counter-clockwise to the left"
    view.show({"K": ControlState(angle_deg=-90.0)})
    assert pointer()[0] > 6


def test_rays_meet_prisms_where_geometry_says() -> None:
    knob, button = LAYOUT.control("K"), LAYOUT.control("B")
    one = np.ones(1)
    # A ray that comes from larger y with height meets the top first if it is inside there.
    hit = cast(knob, 15.0, 0.0, (280 * one, (80 - 9 - 0.5 * 15 + 1) * one), (0 * one, 0.5 * one))
    assert hit.top[0]
    assert hit.y[0] == pytest.approx(-8.0)
    # A camera at smaller y: lean is negative, the wall that looks at it is met on the way down.
    hit = cast(knob, 15.0, 0.0, (280 * one, (80 - 9 + 0.5 * 7) * one), (0 * one, -0.5 * one))
    assert hit.wall[0]
    assert hit.height[0] == pytest.approx(7.0)
    assert (hit.normal_x[0], hit.normal_y[0]) == pytest.approx((0.0, -1.0))
    hit = cast(button, 3.0, 0.0, ((230 - 8 + 0.4) * one, 40 * one), (-0.4 * one, 0 * one))
    assert hit.wall[0]
    assert hit.height[0] == pytest.approx(1.0)
    assert (hit.normal_x[0], hit.normal_y[0]) == (-1.0, 0.0)
    assert not cast(button, 3.0, 0.0, (250 * one, 40 * one), (0 * one, 0 * one)).wall[0]


@pytest.mark.parametrize("tip", [(0.05, 0.05, -0.01), (0.18, 0.11, -0.033), (0.33, 0.20, 0.0)])
def test_the_ball_is_drawn_where_its_outline_projects(view: BenchView, tip: tuple[float, float, float]) -> None:
    painter = StylusPainter(view, BenchStylusConfig(stem_diameter_mm=0.1, stem_mm=30.0))
    black, white = np.zeros((720, 1280, 3), np.uint8), np.full((720, 1280, 3), 255, np.uint8)
    painter.draw(black, np.array(tip))
    painter.draw(white, np.array(tip))
    share = 1 - (white.astype(float) - black)[..., 1] / 255
    # The outline: the circle in which the cone from the eye touches the sphere.
    eye = view.camera.position - tip
    distance, radius = float(np.linalg.norm(eye)), 0.002
    axis = eye / distance
    side = np.cross(axis, [1.0, 0, 0])
    side /= np.linalg.norm(side)
    turn = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    rim_radius = radius * np.sqrt(1 - (radius / distance) ** 2)
    ring = axis * radius**2 / distance + rim_radius * (
        np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(axis, side)
    )
    u, v = view.camera.project(ring + tip).T
    cross = u * np.roll(v, -1) - np.roll(u, -1) * v
    area = cross.sum() / 2
    centre = np.array([((u + np.roll(u, -1)) * cross).sum(), ((v + np.roll(v, -1)) * cross).sum()]) / (6 * area)
    rows, columns = np.mgrid[0:720, 0:1280]
    near = np.hypot(columns - centre[0], rows - centre[1]) < np.sqrt(abs(area) / np.pi) + 1.2
    share = np.where(near, share, 0)
    seen = np.array([(share * columns).sum(), (share * rows).sum()]) / share.sum()
    print("ball", tip, "area", share.sum(), abs(area), "centre off by", seen - centre)
    # A stem of 0.1 mm, 0.27 px, adds a hair above.
    assert share.sum() == pytest.approx(abs(area), rel=0.03)
    assert np.abs(seen - centre).max() < 0.06


def test_shaft_and_arm_leave_the_ball_free(view: BenchView) -> None:
    painter = StylusPainter(view, BenchStylusConfig())
    for x in (0.02, 0.18, 0.34):
        for y in (0.03, 0.11, 0.20):
            for z in (0.0, -0.033):
                picture = np.zeros((720, 1280, 3), np.uint8)
                painter.draw(picture, np.array([x, y, z]))
                blue, green, red = (picture[..., i].astype(int) for i in range(3))
                magenta = (red - green > 60) & (blue - green > 40)
                pixel_mm = 1000 * np.linalg.norm(view.camera.position - (x, y, z)) / 1700.0
                area = magenta.sum() * pixel_mm**2
                assert area > 0.8 * np.pi * 2.0**2, f"ball at {(x, y, z)}: {area:.1f} of {np.pi * 4:.1f} mm2 are seen"


def test_what_was_kept_of_the_stylus_is_not_shown_elsewhere_or_in_other_light() -> None:
    camera = stereo_rig(CAMERA).left
    lights = CLEAR, dataclasses.replace(CLEAR, level=0.5, blur_px=1.0, vignetting=0.4)
    tips = [np.array(tip) for tip in ((0.05, 0.05, -0.01), (0.18, 0.11, -0.033), (0.05, 0.05, -0.01))]
    seen = BenchView(Rays(camera), PANEL, LAYOUT, SURFACES, CLEAR, 0.0)
    painter = StylusPainter(seen, BenchStylusConfig())

    def drawn(painter: StylusPainter, tip: np.ndarray) -> np.ndarray:
        picture = np.full((720, 1280, 3), 128, np.uint8)
        painter.cast_shadow(picture, tip)
        painter.draw(picture, tip)
        return picture

    for light in (*lights, lights[0]):
        seen.relight(light)
        for tip in tips:
            fresh = drawn(StylusPainter(seen, BenchStylusConfig()), tip)
            travelling = drawn(painter, tip)
            for _ in range(2):  # cast, then kept
                assert np.array_equal(drawn(painter, tip), fresh)
            assert np.abs(travelling.astype(int) - fresh).mean() < 0.05, "fewer samples, the same picture"
            assert (fresh < 100).any()


@pytest.mark.parametrize("bend", [-0.8, 0.8])
def test_a_bent_lens_shows_the_case_whole(bend: float, monkeypatch: pytest.MonkeyPatch) -> None:
    camera = dataclasses.replace(stereo_rig(CAMERA).left, distortion=(bend, 0.0, 0.0, 0.0, 0.0))
    seen = BenchView(Rays(camera), PANEL, LAYOUT, SURFACES, CLEAR, 0.0)
    corners = seen.xy0[:, [0, 0, -1, -1], [0, -1, 0, -1]]
    monkeypatch.setattr(view_module, "_case_points", lambda size_mm: np.column_stack([*corners, np.zeros(4)]))
    everywhere = BenchView(Rays(camera), PANEL, LAYOUT, SURFACES, CLEAR, 0.0)
    assert np.array_equal(seen.picture, everywhere.picture)
